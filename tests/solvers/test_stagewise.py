"""Laws of QPs of stages: their optimality conditions, which others confirm, in C and NumPy alike."""

from __future__ import annotations

import numpy as np
import pytest
from stage_qps import conic_optimum, flat, kkt_failure, random_qp

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.solvers.stagewise import StageQp, StageQpOptions, StageQpSolver, StageQpStatus, StageShape

NUMPY = StageQpOptions(compiled=False)


@pytest.mark.parametrize("equalities", [False, True])
def test_random_qps_end_where_the_optimality_conditions_hold(equalities: bool) -> None:
    for seed in range(60):
        qp = random_qp(seed, equalities=equalities)
        found = StageQpSolver(qp.shape).solve(qp)
        assert found.status is StageQpStatus.SOLVED, seed
        assert kkt_failure(qp, found) < 1e-5, seed


@pytest.mark.parametrize("seed", range(7))
def test_the_optimum_is_the_one_that_an_active_set_method_finds(seed: int) -> None:
    qp = random_qp(seed)
    found = StageQpSolver(qp.shape).solve(qp)
    np.testing.assert_allclose(flat(found.z), conic_optimum(qp, "daqp"), atol=1e-7)


@pytest.mark.parametrize("seed", range(20))
def test_c_and_numpy_find_the_same(seed: int) -> None:
    qp = random_qp(seed, equalities=seed % 2 > 0)
    ours, twin = StageQpSolver(qp.shape).solve(qp), StageQpSolver(qp.shape, NUMPY).solve(qp)
    assert ours.status is twin.status
    assert ours.iterations == twin.iterations
    for name in ("z", "y", "y_z", "costate"):
        np.testing.assert_allclose(flat(getattr(ours, name)), flat(getattr(twin, name)), atol=1e-6, rtol=1e-6)


def test_a_qp_whose_bounds_are_not_reached_takes_one_factor() -> None:
    qp = random_qp(3, inequalities=False)
    qp.flat["z_upper"][np.isinf(qp.flat["z_upper"])] = 1e3
    assert StageQpSolver(qp.shape).solve(qp).iterations == 1


@pytest.mark.parametrize("seed", range(20))
def test_a_qp_without_a_point_is_named_infeasible(seed: int) -> None:
    qp = random_qp(seed)
    n = qp.shape.n_x[-1]
    qp.z_lower[-1][:n], qp.z_upper[-1][:n] = 3.0, 4.0
    qp.dynamics[-1][:], qp.b[-1][:] = 0.0, 0.0
    assert StageQpSolver(qp.shape).solve(qp).status is StageQpStatus.INFEASIBLE


def test_numbers_that_are_none_are_a_status() -> None:
    qp = random_qp(0)
    qp.A[0][0, 0] = np.nan
    assert StageQpSolver(qp.shape).solve(qp).status is StageQpStatus.NOT_A_NUMBER


def test_a_qp_of_another_shape_is_refused() -> None:
    other = StageQp(StageShape(n_x=(1, 1), n_u=(1,), n_r=(0, 0), n_c=(0, 0)))
    with pytest.raises(InvalidInput, match="another shape"):
        StageQpSolver(random_qp(0).shape).solve(other)
