"""Laws of real-time SQP: on linear rows one step is the lexicographic optimum, whichever QP solver
takes it.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.solvers.nlp.lexicographic_nlp import LexicographicNlp
from uvms_ocp.solvers.nlp.options import NlpOptions, SqpOptions
from uvms_ocp.solvers.nlp.program import (
    LexicographicProgram,
    NlpLevel,
    NlpStatus,
    lexicographic_program,
)
from uvms_ocp.solvers.nlp.real_time_sqp import RealTimeSqp


def with_derivatives(program: LexicographicProgram) -> LexicographicProgram:
    """The same with derivative functions; the costs are squares of linear rows, so the exact
    Hessian will do.
    """
    nlps = []
    for level in program.nlps:
        x, p, f, g = (level.nlp[key] for key in ("x", "p", "f", "g"))
        lam_f = ca.SX.sym("lam_f")
        lam_g = ca.SX.sym("lam_g", g.numel())
        H = ca.triu(ca.hessian(lam_f * f, x)[0])
        functions = {
            "nlp_g": ca.Function("nlp_g", [x, p], [g]),
            "nlp_grad_f": ca.Function("nlp_grad_f", [x, p], [f, ca.densify(ca.gradient(f, x))]),
            "nlp_jac_g": ca.Function("nlp_jac_g", [x, p], [g, ca.jacobian(g, x)]),
            "nlp_hess_l": ca.Function("nlp_hess_l", [x, p, lam_f, lam_g], [H]),
        }
        nlps.append(replace(level, functions=functions))
    return replace(program, nlps=tuple(nlps))


def linear_program(seed: int) -> LexicographicProgram:
    rng = np.random.default_rng(seed)
    x = ca.SX.sym("x", 6)
    levels = [
        NlpLevel(y=ca.DM(rng.standard_normal((2, 6))) @ x - rng.standard_normal()) for _ in range(4)
    ]
    return with_derivatives(
        lexicographic_program(x, levels, g=ca.sum1(x), g_lower=-1.0, g_upper=1.0)
    )


@pytest.mark.parametrize("plugin", ["proxqp", "piqp"])
@pytest.mark.parametrize("seed", range(5))
def test_one_step_reaches_the_lexicographic_optimum_of_linear_rows(plugin: str, seed: int) -> None:
    program = linear_program(seed)
    exact = LexicographicNlp(linear_program(seed), NlpOptions(anticipate=False)).solve(np.zeros(6))
    result = RealTimeSqp(
        program, SqpOptions(plugin=plugin, damping=1e-9, proximal=1e-9, tolerance=1e-4)
    ).solve(np.ones(6), p=np.zeros(0))
    assert result.status is NlpStatus.SOLVED
    assert result.steps == 1
    residuals = [np.linalg.norm(np.array(y)) for y in program.values.call([result.x, np.zeros(0)])]
    np.testing.assert_allclose(residuals, exact.level_residuals, atol=2e-3)


def test_a_horizon_without_bounds_is_solved_by_hpipm() -> None:
    rng = np.random.default_rng(0)
    N = 5
    states = [ca.SX.sym(f"x{k}", 4) for k in range(N + 1)]
    controls = [ca.SX.sym(f"u{k}", 2) for k in range(N)]
    steps = [
        ca.DM(rng.standard_normal((4, 4))) @ x + ca.DM(rng.standard_normal((4, 2))) @ u - after
        for x, u, after in zip(states, controls, states[1:], strict=False)
    ]
    z = ca.vertcat(
        *(part for pair in zip(states, controls, strict=False) for part in pair), states[-1]
    )
    level = NlpLevel(y=ca.vertcat(z - 1.0, states[-1] + 1.0))
    program = with_derivatives(
        lexicographic_program(z, [level], g=ca.vertcat(*steps), g_lower=0.0, g_upper=0.0)
    )
    result = RealTimeSqp(program, SqpOptions(plugin="hpipm")).solve(
        np.zeros(z.numel()), p=np.zeros(0)
    )
    assert result.status is NlpStatus.SOLVED
    by_piqp = RealTimeSqp(program, SqpOptions(plugin="piqp")).solve(
        np.zeros(z.numel()), p=np.zeros(0)
    )
    np.testing.assert_allclose(result.x, by_piqp.x, atol=1e-5)


def test_a_step_along_rows_that_are_curved_is_mended_instead_of_cut() -> None:
    x = ca.SX.sym("x", 2)
    levels = [NlpLevel(y=ca.sumsqr(x) - 1.0), NlpLevel(y=x - ca.DM([1.0, 0.3]))]
    program = with_derivatives(lexicographic_program(x, levels))
    options = SqpOptions(plugin="piqp", tolerance=1e-2)
    result = RealTimeSqp(program, options).solve(np.array([1.0, 0.0]), p=np.zeros(0))
    assert result.steps == 1
    assert abs(result.x @ result.x - 1.0) <= 1.1e-2
    # A quarter of the step is all that costs the circle no more than the tolerance.
    assert result.x[1] > 0.25


def test_steps_go_on_until_the_constraints_are_kept() -> None:
    x = ca.SX.sym("x", 2)
    circle = with_derivatives(
        lexicographic_program(x, [NlpLevel(y=x - 0.8)], g=ca.sumsqr(x), g_lower=1.0, g_upper=1.0)
    )
    options = SqpOptions(plugin="piqp", max_steps=20, accuracy=1e-8)
    result = RealTimeSqp(circle, options).solve(np.array([1.5, 0.5]), p=np.zeros(0))
    assert result.status is NlpStatus.SOLVED
    assert result.steps > 2
    np.testing.assert_allclose(result.x @ result.x, 1.0, atol=1e-7)


def test_no_step_begins_that_would_end_after_the_time_limit() -> None:
    x = ca.SX.sym("x", 2)
    circle = with_derivatives(
        lexicographic_program(x, [NlpLevel(y=x - 0.8)], g=ca.sumsqr(x), g_lower=1.0, g_upper=1.0)
    )
    readings = iter(np.arange(100.0))
    sqp = RealTimeSqp(circle, SqpOptions(plugin="piqp", max_steps=20, accuracy=1e-8))
    result = sqp.solve(
        np.array([1.5, 0.5]), p=np.zeros(0), time_limit=1.5, clock=lambda: float(next(readings))
    )
    assert result.status is NlpStatus.TIME_LIMIT
    assert result.steps == 1
    assert np.isfinite(result.x).all()


def test_a_program_that_is_not_a_number_leaves_the_start_as_it_is() -> None:
    x = ca.SX.sym("x", 1)
    program = with_derivatives(lexicographic_program(x, [NlpLevel(y=ca.log(x))]))
    result = RealTimeSqp(program, SqpOptions(plugin="piqp")).solve(np.array([-1.0]), p=np.zeros(0))
    assert result.status is NlpStatus.NOT_A_NUMBER
    assert result.x == [-1.0]


def test_a_program_without_derivatives_is_refused() -> None:
    x = ca.SX.sym("x", 1)
    with pytest.raises(InvalidInput, match="nlp_jac_g"):
        RealTimeSqp(lexicographic_program(x, [NlpLevel(y=x)]), SqpOptions(plugin="piqp"))
