"""Laws of QPs of stages: their optimality conditions, which others confirm, in C and by PIQP
alike.
"""

from __future__ import annotations

import numpy as np
import pytest
from compiler import IN_C_AND_PYTHON, needs_compiler
from stage_qps import conic_optimum, dense, flat, kkt_failure, random_qp, reach_qp, softened

from uvms_ocp.errors import InvalidInput
from uvms_ocp.solvers.stage_qp import (
    StageQp,
    StageQpOptions,
    StageQpSolution,
    StageQpSolver,
    StageQpStatus,
    StageShape,
)
from uvms_ocp.solvers.stage_qp.solver import (
    is_recession_direction,
    may_be_unbounded,
    recession_problem,
)

PIQP = StageQpOptions(compiled=False)


def solved(qp: StageQp, warm: StageQpSolution | None = None) -> StageQpSolution:
    solution = StageQpSolver(qp.shape).solve(qp, warm=warm)
    assert solution.status is StageQpStatus.SOLVED
    return solution


@pytest.mark.parametrize("equalities", [False, True])
@pytest.mark.parametrize("block", range(5))
def test_every_random_qp_ends_where_the_optimality_conditions_hold(
    block: int, equalities: bool
) -> None:
    for seed in range(50 * block, 50 * (block + 1)):
        qp = random_qp(seed, equalities=equalities)
        solution = StageQpSolver(qp.shape).solve(qp)
        assert solution.status is StageQpStatus.SOLVED, seed
        # The smaller of a multiplier and what is left to its bound is the root of complementarity
        # where both vanish.
        assert kkt_failure(qp, solution) < 1e-5, seed
        assert solution.kkt.stationarity < 1e-8 * (
            1.0 + np.abs(dense(qp)[1]).max() + np.abs(flat(solution.y_z)).max()
        ), seed


@pytest.mark.parametrize("seed", [seed for seed in range(20) if seed not in (7, 13)])
def test_the_optimum_is_the_one_that_an_active_set_method_finds(seed: int) -> None:
    qp = random_qp(seed)
    np.testing.assert_allclose(flat(solved(qp).z), conic_optimum(qp, "daqp"), atol=1e-8)


@pytest.mark.parametrize("seed", range(10))
def test_without_inequalities_the_optimum_solves_the_dense_kkt_system_with_one_factor(
    seed: int,
) -> None:
    qp = random_qp(seed, inequalities=False)
    H, g, A, lower, _ = dense(qp)
    fixed = np.flatnonzero(qp.flat["z_lower"] == qp.flat["z_upper"])
    rows = np.vstack([A[np.isfinite(lower)], np.eye(len(g))[fixed]])
    right = np.concatenate([lower[np.isfinite(lower)], qp.flat["z_lower"][fixed]])
    kkt = np.block([[H, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
    solution = solved(qp)
    np.testing.assert_allclose(
        flat(solution.z), np.linalg.solve(kkt, np.concatenate([-g, right]))[: len(g)], atol=1e-8
    )
    assert solution.iterations == 1


def test_bounds_that_are_not_reached_cost_no_further_factor() -> None:
    qp = random_qp(3, inequalities=False)
    free = solved(qp)
    qp.flat["z_upper"][np.isinf(qp.flat["z_upper"])] = 1e3
    bounded = solved(qp)
    assert bounded.iterations == 1
    np.testing.assert_allclose(flat(bounded.z), flat(free.z), rtol=1e-9, atol=1e-9)


@needs_compiler
@pytest.mark.parametrize("seed", range(30))
def test_c_and_piqp_find_the_same(seed: int) -> None:
    qp = random_qp(seed, equalities=seed % 2 > 0)
    ours = solved(qp)
    twin = StageQpSolver(qp.shape, PIQP).solve(qp)
    assert ours.status is twin.status
    # How many factors that takes is theirs: bounds that only just bind hold or not by rounding.
    assert max(kkt_failure(qp, ours), kkt_failure(qp, twin)) < 1e-5
    np.testing.assert_allclose(flat(ours.z), flat(twin.z), atol=1e-8)
    assert ours.cost == pytest.approx(twin.cost, rel=1e-9, abs=1e-9)


@needs_compiler
@pytest.mark.parametrize("seed", range(5))
def test_c_and_piqp_find_the_same_multipliers_where_there_is_one_choice(seed: int) -> None:
    qp = random_qp(seed, inequalities=False)
    free = flat(solved(qp).u)
    for k, n_x in enumerate(qp.shape.n_x[:-1]):
        qp.z_upper[k][n_x:] = np.median(free)
    ours = solved(qp)
    twin = StageQpSolver(qp.shape, PIQP).solve(qp)
    for name in ("z", "y", "y_z", "costate"):
        np.testing.assert_allclose(
            flat(getattr(ours, name)), flat(getattr(twin, name)), atol=1e-9, rtol=1e-9
        )


def test_the_same_qp_gives_the_same_bits() -> None:
    qp = random_qp(5)
    solver = StageQpSolver(qp.shape)
    first = solver.solve(qp)
    solver.solve(random_like(qp))
    np.testing.assert_array_equal(flat(solver.solve(qp).z), flat(first.z))


def random_like(qp: StageQp) -> StageQp:
    permuted = StageQp(qp.shape)
    rng = np.random.default_rng(0)
    for name in ("dynamics", "b", "J", "r"):
        permuted.flat[name][:] = rng.standard_normal(len(permuted.flat[name]))
    permuted.flat["damping"][:] = 1.0
    return permuted


@pytest.mark.parametrize("seed", range(20))
def test_rows_that_depend_on_each_other_change_nothing(seed: int) -> None:
    qp = random_qp(seed, equalities=True)
    shape = StageShape(
        n_x=qp.shape.n_x,
        n_u=qp.shape.n_u,
        n_r=qp.shape.n_r,
        n_c=tuple(2 * n + 1 for n in qp.shape.n_c),
    )
    twice = StageQp(shape)
    for name in ("dynamics", "b", "J", "r", "g", "damping", "z_lower", "z_upper"):
        twice.flat[name][:] = qp.flat[name]
    for k, n in enumerate(qp.shape.n_c):
        twice.C[k][: 2 * n] = np.vstack([qp.C[k], 3.0 * qp.C[k]])
        twice.lower[k][: 2 * n] = np.concatenate([qp.lower[k], 3.0 * qp.lower[k]])
        twice.upper[k][: 2 * n] = np.concatenate([qp.upper[k], 3.0 * qp.upper[k]])
        twice.lower[k][-1] = twice.upper[k][-1] = 0.0  # of an empty row
    np.testing.assert_allclose(flat(solved(twice).z), flat(solved(qp).z), atol=1e-6)


def test_rows_with_endless_limits_cost_no_iteration() -> None:
    qp = random_qp(2)
    before = solved(qp)
    for k in range(qp.shape.N + 1):
        endless = np.isinf(qp.lower[k]) & np.isinf(qp.upper[k])
        qp.C[k][endless] *= 10.0
    after = solved(qp)
    assert after.iterations == before.iterations
    np.testing.assert_allclose(flat(after.z), flat(before.z), atol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_a_qp_without_a_point_is_named_infeasible(seed: int) -> None:
    options = StageQpOptions(compiled=seed > 4)
    qp = random_qp(seed)
    n = qp.shape.n_x[-1]
    qp.z_lower[-1][:n] = 3.0
    qp.z_upper[-1][:n] = 4.0
    qp.dynamics[-1][:] = 0.0
    qp.b[-1][:] = 0.0
    assert StageQpSolver(qp.shape, options).solve(qp).status is StageQpStatus.INFEASIBLE


def test_equalities_that_contradict_each_other_are_infeasible_and_missed_least() -> None:
    qp = StageQp(StageShape(n_x=(1, 1), n_u=(1,), n_r=(0, 0), n_c=(0, 3)))
    qp.A[0][:] = 1.0
    qp.B[0][:] = 1.0
    qp.C[1][:] = 1.0
    qp.flat["damping"][:] = 1.0
    qp.fix_initial_state(np.zeros(1))
    for bound in (qp.lower[1], qp.upper[1]):
        bound[:] = 1.0, 2.0, 5.0
    solution = StageQpSolver(qp.shape).solve(qp)
    assert solution.status is StageQpStatus.INFEASIBLE
    # The least sum of distances to three points is at the one in the middle.
    np.testing.assert_allclose(solution.x[1], 2.0, atol=1e-3)
    np.testing.assert_allclose(solution.excess[1], [1.0, 0.0, -3.0], atol=1e-3)


@pytest.mark.parametrize("compiled", IN_C_AND_PYTHON)
@pytest.mark.parametrize(("l1", "l2"), [(0.3, 0.0), (0.3, 2.0), (0.0, 2.0)])
@pytest.mark.parametrize("seed", [0, 2, 5])
def test_soft_rows_are_those_of_a_qp_with_slacks(
    seed: int, l1: float, l2: float, compiled: bool
) -> None:
    qp = random_qp(seed, equalities=seed > 0)
    expected = softened(qp, l1, l2)
    qp.flat["l1"][:] = l1
    qp.flat["l2"][:] = l2
    solution = StageQpSolver(qp.shape, StageQpOptions(compiled=compiled)).solve(qp)
    assert solution.status is StageQpStatus.SOLVED
    np.testing.assert_allclose(flat(solution.z), expected, atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_a_penalty_above_the_multipliers_is_exact(seed: int) -> None:
    qp = random_qp(seed)
    hard = solved(qp)
    qp.flat["l1"][:] = 2.0 * np.abs(flat(hard.y)).max(initial=1.0)
    np.testing.assert_allclose(flat(solved(qp).z), flat(hard.z), atol=1e-6)


def test_soft_bounds_are_missed_where_the_dynamics_leave_no_choice() -> None:
    qp = StageQp(StageShape(n_x=(1, 1), n_u=(0,), n_r=(0, 0), n_c=(0, 0)))
    qp.A[0][:] = 1.0
    qp.z_upper[1][:] = 1.0
    qp.z_l1[1][:] = 7.0
    qp.flat["damping"][:] = 1.0
    qp.fix_initial_state(np.array([3.0]))
    solution = solved(qp)
    np.testing.assert_allclose(solution.x[1], 3.0, atol=1e-8)
    np.testing.assert_allclose(solution.y_z[1], 7.0, atol=1e-6)


@pytest.mark.parametrize("goal", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_a_reach_with_bounds_on_velocities_and_forces_takes_few_factors(
    seed: int, goal: bool
) -> None:
    qp = reach_qp(seed, goal=goal)
    cold = solved(qp)
    assert cold.iterations <= 20
    assert kkt_failure(qp, cold) < 1e-5
    qp.flat["r"][:] *= 1.01
    assert solved(qp, warm=cold).iterations <= 12


@pytest.mark.parametrize("seed", range(10))
def test_a_warm_start_leads_to_the_same_optimum_sooner(seed: int) -> None:
    qp = random_qp(seed)
    before = solved(qp)
    qp.flat["r"][:] += 1e-4
    cold = solved(qp)
    warm = solved(qp, warm=before)
    assert warm.iterations <= max(7, cold.iterations)
    np.testing.assert_allclose(flat(warm.z), flat(cold.z), atol=1e-6)
    assert (
        solved(qp, warm=cold).iterations <= 2
    )  # bounds that only just bind may be guessed wrong once


@needs_compiler
@pytest.mark.parametrize("seed", [3, 55, 66, 84, 124, 130, 153, 154])
def test_a_cold_solve_knows_which_bounds_are_not_reached(seed: int) -> None:
    qp = random_qp(seed)
    lower, upper = (
        np.concatenate([qp.flat[name], qp.flat[f"z_{name}"]]) for name in ("lower", "upper")
    )
    solution = StageQpSolver(qp.shape, StageQpOptions(tolerance=1e-7)).solve_flat(qp)
    bounded = (lower < upper) & (np.isfinite(lower) | np.isfinite(upper))
    assert not solution.y[bounded].all()


def test_the_multiplier_of_the_initial_state_is_how_the_cost_rises() -> None:
    qp = random_qp(1, inequalities=False)
    x = np.array([0.3] * qp.shape.n_x[0])
    gradient = []
    for i in range(len(x)):
        costs = []
        for step in (1e-4, -1e-4):
            qp.fix_initial_state(x + step * np.eye(len(x))[i])
            costs.append(solved(qp).cost)
        gradient.append((costs[0] - costs[1]) / 2e-4)
    qp.fix_initial_state(x)
    np.testing.assert_allclose(-solved(qp).y_z[0][: len(x)], gradient, atol=1e-6)


@pytest.mark.parametrize("compiled", IN_C_AND_PYTHON)
@pytest.mark.parametrize(
    ("name", "value"),
    [
        *[("dynamics", np.nan), ("J", np.inf), ("l1", -1.0), ("z_upper", -np.inf)],
        *[(side, np.nan) for side in ("lower", "upper", "z_lower", "z_upper")],
    ],
)
def test_numbers_that_are_none_are_a_status(name: str, value: float, compiled: bool) -> None:
    qp = random_qp(0)
    qp.flat[name][-1] = value
    solution = StageQpSolver(qp.shape, StageQpOptions(compiled=compiled)).solve(qp)
    assert solution.status is StageQpStatus.NOT_A_NUMBER
    assert np.isfinite(flat(solution.z)).all()


@pytest.mark.parametrize("compiled", IN_C_AND_PYTHON)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_residual_that_is_none_is_noticed_where_nothing_moves_it(
    value: float, compiled: bool
) -> None:
    qp = random_qp(0)
    qp.J[-1][-1] = 0.0
    qp.r[-1][-1] = value
    assert (
        StageQpSolver(qp.shape, StageQpOptions(compiled=compiled)).solve(qp).status
        is StageQpStatus.NOT_A_NUMBER
    )


@pytest.mark.parametrize("compiled", IN_C_AND_PYTHON)
def test_a_cost_that_is_not_convex_is_named(compiled: bool) -> None:
    qp = random_qp(0, inequalities=False)
    qp.H[-1][:] = -100.0 * np.eye(len(qp.H[-1]))
    qp.dynamics[-1][:] = 1.0
    assert (
        StageQpSolver(qp.shape, StageQpOptions(compiled=compiled)).solve(qp).status
        is StageQpStatus.NOT_CONVEX
    )


@pytest.mark.parametrize("compiled", IN_C_AND_PYTHON)
def test_a_cost_that_falls_without_end_is_named(compiled: bool) -> None:
    qp = falling_qp()
    qp.z_upper[1][:] = 1.0
    assert (
        StageQpSolver(qp.shape, StageQpOptions(compiled=compiled)).solve(qp).status
        is StageQpStatus.UNBOUNDED
    )


@pytest.mark.parametrize("compiled", IN_C_AND_PYTHON)
@pytest.mark.parametrize(
    ("penalty", "status"), [(0.1, StageQpStatus.UNBOUNDED), (0.6, StageQpStatus.SOLVED)]
)
def test_soft_bounds_end_a_fall_where_missing_them_costs_more(
    penalty: float, status: StageQpStatus, compiled: bool
) -> None:
    """One unit down gains 1, and is paid for twice: by the state at the end, and by the input that
    leads there.
    """
    qp = falling_qp()
    qp.flat["z_lower"][:] = -1.0
    qp.flat["z_upper"][:] = 1.0
    qp.flat["z_l1"][:] = penalty
    assert StageQpSolver(qp.shape, StageQpOptions(compiled=compiled)).solve(qp).status is status


def falling_qp() -> StageQp:
    """An integrator whose cost falls with its last state."""
    qp = StageQp(StageShape(n_x=(1, 1), n_u=(1,), n_r=(1, 0), n_c=(0, 0)))
    qp.A[0][:] = 1.0
    qp.B[0][:] = 1.0
    qp.J[0][0, 0] = 1.0
    qp.g[1][:] = 1.0
    return qp


def test_no_cost_falls_without_end_between_hard_bounds() -> None:
    qp = falling_qp()
    qp.flat["z_lower"][:] = -1.0
    qp.flat["z_upper"][:] = 1.0
    assert not may_be_unbounded(qp)
    qp.flat["z_l1"][1] = 1.0
    assert may_be_unbounded(qp)
    qp.flat["damping"][1] = 1e-3
    assert not may_be_unbounded(qp)


@pytest.mark.parametrize("length", [1e-9, 1.0, 1e9])
def test_a_way_without_end_is_one_however_short_it_is_given(length: float) -> None:
    problem = recession_problem(falling_qp())
    down = (np.array([0.0, -length]), np.array([-length]))
    assert is_recession_direction(problem, down)
    assert not is_recession_direction(problem, tuple(-part for part in down))
    assert not is_recession_direction(problem, (np.zeros(2), down[1]))
    assert not is_recession_direction(problem, tuple(0.0 * part for part in down))


def test_the_iteration_limit_is_a_status() -> None:
    qp = random_qp(2)
    solution = StageQpSolver(qp.shape, StageQpOptions(max_iterations=2)).solve(qp)
    assert solution.status is StageQpStatus.ITERATION_LIMIT
    assert np.isfinite(flat(solution.z)).all()


def test_a_qp_of_another_shape_is_refused() -> None:
    empty = StageQp(StageShape(n_x=(1, 1), n_u=(1,), n_r=(0, 0), n_c=(0, 0)))
    with pytest.raises(InvalidInput, match="another shape"):
        StageQpSolver(random_qp(0).shape).solve(empty)


def test_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InvalidInput, match="n_r of 1 stages"):
        StageShape(n_x=(1, 1), n_u=(1,), n_r=(0,), n_c=(0, 0))
    with pytest.raises(InvalidInput, match="negative"):
        StageShape(n_x=(1, 1), n_u=(-1,), n_r=(0, 0), n_c=(0, 0))
    with pytest.raises(InvalidInput, match="no stage"):
        StageShape(n_x=(0, 0), n_u=(0,), n_r=(0, 0), n_c=(0, 0))


def moved_to(qp: StageQp, z: np.ndarray) -> StageQp:
    """The same with z as its origin."""
    shifted = StageQp(qp.shape)
    parts = np.split(z, np.cumsum(qp.shape.n_z)[:-1])
    for name, array in qp.flat.items():
        shifted.flat[name][:] = array
    for k, stage in enumerate(parts):
        shifted.r[k][:] += qp.J[k] @ stage
        shifted.g[k][:] += qp.H[k] @ stage + qp.damping[k] * stage
        shifted.lower[k][:] -= qp.C[k] @ stage
        shifted.upper[k][:] -= qp.C[k] @ stage
        if k < qp.shape.N:
            shifted.b[k][:] += qp.dynamics[k] @ stage - parts[k + 1][: qp.shape.n_x[k + 1]]
    shifted.flat["z_lower"][:] -= z
    shifted.flat["z_upper"][:] -= z
    return shifted


@pytest.mark.parametrize("options", [StageQpOptions(), PIQP], ids=["c", "piqp"])
@pytest.mark.parametrize("seed", range(10))
def test_multipliers_miss_the_conditions_nowhere_but_away_from_the_optimum(
    seed: int, options: StageQpOptions
) -> None:
    qp = random_qp(seed, equalities=seed % 2 > 0)
    solver = StageQpSolver(qp.shape, options)
    solution = solver.solve_flat(qp)
    assert solver.error(moved_to(qp, solution.z), solution.warm_start()) < 1e-6
    rng = np.random.default_rng(seed)
    away = solution.z + 0.1 * rng.standard_normal(len(solution.z))
    assert solver.error(moved_to(qp, away), solution.warm_start()) > 1e-4


@needs_compiler
@pytest.mark.parametrize("seed", range(20))
def test_from_a_qp_nearby_c_and_piqp_find_the_same(seed: int) -> None:
    qp = random_qp(seed)
    nearby = random_qp(seed)
    nearby.flat["r"][:] *= 1.1
    ours = StageQpSolver(qp.shape)
    twin = StageQpSolver(qp.shape, PIQP)
    warm_start = ours.solve_flat(nearby).warm_start()
    solution = ours.solve_flat(qp, warm_start)
    same = twin.solve_flat(qp, warm_start)
    assert solution.status is same.status is StageQpStatus.SOLVED
    np.testing.assert_allclose(solution.z, same.z, atol=1e-8)
    np.testing.assert_allclose(solution.z, flat(solved(qp).z), atol=1e-6)


@needs_compiler
def test_a_loose_tolerance_costs_fewer_factors() -> None:
    qp = reach_qp(1, goal=True)
    solver = StageQpSolver(qp.shape)
    assert solver.solve_flat(qp, tolerance=1e-3).iterations < solver.solve_flat(qp).iterations


@needs_compiler
@pytest.mark.parametrize("seed", range(3))
def test_a_rough_optimum_has_multipliers_of_reached_bounds_alone_so_that_the_next_qp_can_start_from_them(
    seed: int,
) -> None:
    qp = reach_qp(seed, goal=False)
    solution = StageQpSolver(qp.shape, StageQpOptions(tolerance=1e-3)).solve(qp)
    z = flat(solution.z)
    y = flat(solution.y_z)
    gap = np.where(y > 0.0, qp.flat["z_upper"] - z, z - qp.flat["z_lower"])
    limited = np.isfinite(qp.flat["z_upper"]) & (qp.flat["z_lower"] < qp.flat["z_upper"])
    assert 0 < (limited & (y != 0.0)).sum() < limited.sum()
    assert gap[limited & (y != 0.0)].max() < 0.01
