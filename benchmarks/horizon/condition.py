"""How well conditioned Newton's step is."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, onenormest, splu

from horizon.ours import sparse_program
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.ocp.planner import Planner


def condition(planner: Planner, plan: Plan) -> float:
    """Estimate, in the 1-norm, for the matrix of Newton's step at the plan: Hessian and Jacobian of
    the constraints.
    """
    assert plan.result is not None
    (point,) = plan.result.points
    (nlp,) = sparse_program(planner).program.nlps
    if point.row_multipliers is None:
        return float("nan")
    p = planner.transcription.parameters()
    J = nlp.functions["nlp_jac_g"](point.x, p)[1].sparse()
    H = nlp.functions["nlp_hess_l"](point.x, p, 1.0, point.row_multipliers[nlp.rows]).sparse()
    H = H + sparse.triu(H, 1).T
    K = sparse.bmat([[H, J.T], [J, None]], format="csc")
    try:
        factors = splu(K)
    except RuntimeError:
        return float("inf")

    def transposed(b: np.ndarray) -> np.ndarray:
        solution: np.ndarray = factors.solve(b, trans="T")
        return solution

    inverse = LinearOperator(K.shape, matvec=factors.solve, rmatvec=transposed)
    return float(onenormest(K) * onenormest(inverse))
