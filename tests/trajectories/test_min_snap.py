"""Laws of minimum-derivative trajectories."""

from fractions import Fraction
from itertools import pairwise
from math import prod

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.trajectories import min_snap
from uvms_ocp.trajectories.coefficient_qp import Bound, min_snap_qp
from uvms_ocp.trajectories.curve_conditions import Boundary, Constraint, CurveSpecification
from uvms_ocp.trajectories.free_derivatives import end_data, piece_costs, pieces_of
from uvms_ocp.trajectories.min_snap import MinSnap

RNG = np.random.default_rng


def random_problem(
    n: int, axes: int = 3, seed: int = 0, ratio: float = 3.0
) -> tuple[np.ndarray, np.ndarray]:
    rng = RNG(seed)
    return rng.normal(size=(n + 1, axes)), np.concatenate(
        [[0.0], np.cumsum(rng.uniform(1.0, ratio, n))]
    )


def largest_jump(curve: MinSnap, derivative: int) -> float:
    peak = curve.trajectory.peak(derivative).max()
    return float(np.abs(curve.trajectory.jumps(derivative)).max() / peak)


def test_rest_to_rest_is_the_closed_form() -> None:
    curve = min_snap([0.0, 1.0], [0.0, 1.0])
    expected = [0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0]
    np.testing.assert_allclose(curve.trajectory.coefficients[:, 0, 0], expected, atol=1e-12)
    assert curve.cost == pytest.approx(100800.0, rel=1e-12)


@pytest.mark.parametrize("n", [1, 2, 10, 1000, 100_000])
def test_way_points_are_met(n: int) -> None:
    waypoints, times = random_problem(n)
    curve = min_snap(waypoints, times)
    np.testing.assert_allclose(curve.trajectory.evaluate(times), waypoints, atol=1e-10)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_uniform_times_of_any_scale_are_continuous_up_to_the_sixth_derivative(unit: float) -> None:
    waypoints, _ = random_problem(100)
    curve = min_snap(waypoints, unit * np.arange(101))
    assert max(largest_jump(curve, d) for d in range(7)) < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("n", [10, 1000, 100_000])
def test_neighbouring_ratios_up_to_three_are_continuous_up_to_the_sixth_derivative(n: int) -> None:
    waypoints, times = random_problem(n)
    curve = min_snap(waypoints, times)
    assert max(largest_jump(curve, d) for d in range(7)) < 1e-8


@pytest.mark.parametrize("k", [2, 3, 4])
def test_no_perturbation_of_the_free_derivatives_is_cheaper(k: int) -> None:
    waypoints, times = random_problem(6)
    curve = min_snap(waypoints, times, CurveSpecification(derivative=k))
    pieces = pieces_of(np.diff(times), k)
    rng = RNG(2)
    for size in np.repeat([1e-3, 1e-1], 100):
        moved = curve.node_derivatives.copy()
        moved[1:, 1:-1] += size * rng.normal(size=moved[1:, 1:-1].shape)
        assert piece_costs(pieces, end_data(pieces, moved)).sum() > curve.cost


@pytest.mark.parametrize("k", [2, 3, 4])
@pytest.mark.parametrize("n", [1, 3, 10])
def test_the_qp_and_the_free_derivative_form_agree(k: int, n: int) -> None:
    waypoints, times = random_problem(n)
    constraints = (Constraint(node=1, derivative=1, value=0.3),) if n > 1 else ()
    specification = CurveSpecification(derivative=k, constraints=constraints)
    free = min_snap(waypoints, times, specification)
    qp = min_snap_qp(waypoints, times, specification)
    size = np.abs(free.node_derivatives).max()
    np.testing.assert_allclose(qp.node_derivatives, free.node_derivatives, atol=1e-8 * size)
    assert qp.cost == pytest.approx(free.cost, rel=1e-8)


def test_the_qp_keeps_bounds_that_bind() -> None:
    waypoints = np.array([0.0, 1.0, 0.0])
    times = np.array([0.0, 1.0, 2.5])
    free = min_snap(waypoints, times)
    speed = free.node_derivatives[1, 1, 0]
    bounded = min_snap_qp(waypoints, times, bounds=[Bound(node=1, derivative=1, lower=speed + 0.5)])
    assert bounded.node_derivatives[1, 1, 0] == pytest.approx(speed + 0.5, abs=1e-8)
    assert bounded.cost > free.cost


def test_contradictory_bounds_are_refused() -> None:
    with pytest.raises(InvalidInput, match="no solution"):
        min_snap_qp(
            [0.0, 1.0, 0.0],
            [0.0, 1.0, 2.0],
            bounds=[Bound(node=1, derivative=1, lower=2.0, upper=1.0)],
        )


def test_constraints_are_met_on_the_chosen_axes_only() -> None:
    waypoints, times = random_problem(4)
    plain = min_snap(waypoints, times)
    stop = Constraint(node=2, derivative=1, value=0.0, axes=(1,))
    held_curve = min_snap(waypoints, times, CurveSpecification(constraints=(stop,)))
    np.testing.assert_allclose(held_curve.trajectory.evaluate(times[2], 1)[1], 0.0, atol=1e-12)
    np.testing.assert_allclose(
        held_curve.node_derivatives[:, :, [0, 2]], plain.node_derivatives[:, :, [0, 2]], rtol=1e-9
    )


def test_boundary_rows_fix_the_first_derivatives_and_leave_the_others_free() -> None:
    waypoints, times = random_problem(4)
    moving = Boundary(start=[[1.0, 2.0, 3.0]], end=None)
    stopping = Boundary(start=[[1.0, 2.0, 3.0]])
    curve = min_snap(waypoints, times, CurveSpecification(boundary=moving))
    np.testing.assert_allclose(curve.trajectory.evaluate(times[0], 1), [1.0, 2.0, 3.0], atol=1e-12)
    assert curve.cost < min_snap(waypoints, times, CurveSpecification(boundary=stopping)).cost


def test_a_free_way_point_lowers_the_cost_to_where_its_gradient_vanishes() -> None:
    waypoints, times = random_problem(5)
    curve = min_snap(waypoints, times, CurveSpecification(free_positions=(2,)))
    assert curve.cost < min_snap(waypoints, times).cost
    gradient = curve.gradients().waypoints
    assert np.abs(gradient[2]).max() < 1e-9 * np.abs(gradient).max()


def test_the_cost_does_not_change_under_a_shift_of_space_and_time() -> None:
    waypoints, times = random_problem(8)
    shifted = min_snap(waypoints + 100.0, times + 100.0)
    assert shifted.cost == pytest.approx(min_snap(waypoints, times).cost, rel=1e-9)


@pytest.mark.parametrize("k", [2, 3, 4])
def test_gradients_of_the_optimal_cost_match_differences(k: int) -> None:
    waypoints, times = random_problem(5)
    specification = CurveSpecification(derivative=k)
    gradients = min_snap(waypoints, times, specification).gradients()
    h = 1e-5
    for i in range(6):
        step = h * np.eye(6)[i]
        late, early = (min_snap(waypoints, times + s * step, specification).cost for s in (1, -1))
        assert (late - early) / (2 * h) == pytest.approx(gradients.times[i], rel=1e-6)
        for axis in range(3):
            move = h * np.outer(np.eye(6)[i], np.eye(3)[axis])
            up, down = (min_snap(waypoints + s * move, times, specification).cost for s in (1, -1))
            assert (up - down) / (2 * h) == pytest.approx(
                gradients.waypoints[i, axis], rel=1e-6, abs=1e-6
            )


@pytest.mark.parametrize(
    ("waypoints", "times", "message"),
    [
        ([0.0, 1.0, 1.0], [0.0, 1.0, 2.0], "way points 1 and 2 are equal"),
        ([0.0, np.nan], [0.0, 1.0], "way point 1 is"),
        ([0.0, 1.0, 2.0], [0.0, 1.0, 0.5], "time 2 is 0.5 after 1.0"),
        ([0.0, 1.0], [0.0, np.inf], "time 1 is inf"),
        ([0.0, 1.0], [0.0, 1.0, 2.0], "need"),
        ([0.0], [0.0], "n >= 2"),
    ],
)
def test_bad_way_points_and_times_are_refused_with_the_offending_index(
    waypoints: list[float], times: list[float], message: str
) -> None:
    with pytest.raises(InvalidInput, match=message):
        min_snap(waypoints, times)


def test_equal_way_points_are_a_wait_when_asked_for() -> None:
    curve = min_snap([1.0, 1.0], [0.0, 2.0], CurveSpecification(dwell=True))
    assert curve.cost == pytest.approx(0.0, abs=1e-12)


def test_bad_constraints_are_refused_with_the_offending_index() -> None:
    waypoints, times = random_problem(2)
    good = Constraint(node=1, derivative=1)
    for bad, message in (
        (Constraint(node=3, derivative=1), "constraint 1 is on derivative 1 of way point 3"),
        (Constraint(node=1, derivative=4), "derivatives 1 to 3"),
        (Constraint(node=1, derivative=1, value=1.0), "constraint 1 contradicts"),
        (Constraint(node=1, derivative=2, value=[1.0, 2.0]), "one per axis"),
        (Constraint(node=1, derivative=2, axes=(5,)), "axes 0 to 2"),
    ):
        with pytest.raises(InvalidInput, match=message):
            min_snap(waypoints, times, CurveSpecification(constraints=(good, bad)))


def test_a_curve_with_too_little_fixed_is_refused() -> None:
    with pytest.raises(InvalidInput, match="not determined"):
        min_snap(
            [0.0, 1.0], [0.0, 1.0], CurveSpecification(boundary=Boundary(start=None, end=None))
        )
    with pytest.raises(InvalidInput, match="start boundary"):
        min_snap(
            [0.0, 1.0], [0.0, 1.0], CurveSpecification(boundary=Boundary(start=np.zeros((4, 1))))
        )


def test_a_specification_that_does_not_exist_is_refused() -> None:
    with pytest.raises(InvalidInput, match="derivative is 0; allowed is 1 or more"):
        CurveSpecification(derivative=0)
    for node in (3, -4):
        with pytest.raises(
            InvalidInput,
            match=f"the position of way point {node} is to be free; allowed are -3 to 2",
        ):
            min_snap([0.0, 1.0, 0.0], [0.0, 1.0, 2.0], CurveSpecification(free_positions=(node,)))


def _nearly_coincident(short: float) -> tuple[np.ndarray, np.ndarray]:
    return np.array([0.0, 5.0, 5.0 + 0.05 * short**2, 10.0]), np.cumsum([0.0, 12.0, short, 12.0])


@pytest.mark.parametrize("short", [1.0, 1e-1, 1e-2])
def test_the_cost_is_that_of_rational_numbers(short: float) -> None:
    waypoints, times = _nearly_coincident(short)
    assert min_snap(waypoints, times).cost == pytest.approx(
        _rational_cost(waypoints, times), rel=1e-4
    )


@pytest.mark.parametrize("short", [1e-4, 1e-5, 1e-6])
def test_a_curve_that_rounding_decides_is_refused(short: float) -> None:
    with pytest.raises(
        InvalidInput, match=r"rounding decides the curve|is not determined at way point"
    ):
        min_snap(*_nearly_coincident(short))


def _rational_cost(waypoints: np.ndarray, times: np.ndarray) -> float:
    """Least cost from rest to rest, by the equations of optimality of all pieces in rational
    numbers.
    """
    k = 4
    n = len(times) - 1
    h = [Fraction(float(b)) - Fraction(float(a)) for a, b in pairwise(times)]

    def falling(i: int, d: int) -> int:
        return prod(range(i - d + 1, i + 1))

    rows: list[list[Fraction]] = []

    def row(value: float, *parts: tuple[int, int, Fraction, int]) -> None:
        """Sum of sign times derivative d of piece p at its time t."""
        rows.append([Fraction(0)] * (2 * k * n) + [Fraction(float(value))])
        for p, d, t, sign in parts:
            for i in range(d, 2 * k):
                rows[-1][2 * k * p + i] += sign * falling(i, d) * t ** (i - d)

    for p in range(n):
        row(waypoints[p], (p, 0, Fraction(0), 1))
        row(waypoints[p + 1], (p, 0, h[p], 1))
        for d in range(1, 2 * k - 1) if p + 1 < n else ():
            row(0.0, (p, d, h[p], 1), (p + 1, d, Fraction(0), -1))
    for d in range(1, k):
        row(0.0, (0, d, Fraction(0), 1))
        row(0.0, (n - 1, d, h[-1], 1))
    x = _solved_in_fractions(rows)
    pieces = [x[2 * k * p :][: 2 * k] for p in range(n)]
    return float(
        sum(
            falling(i, k)
            * falling(j, k)
            * c[i]
            * c[j]
            * t ** (i + j - 2 * k + 1)
            / (i + j - 2 * k + 1)
            for c, t in zip(pieces, h, strict=True)
            for i in range(k, 2 * k)
            for j in range(k, 2 * k)
        )
    )


def _solved_in_fractions(rows: list[list[Fraction]]) -> list[Fraction]:
    for i in range(len(rows)):
        pivot = next(r for r in range(i, len(rows)) if rows[r][i])
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for r in range(len(rows)):
            if r != i and rows[r][i]:
                rows[r] = [a - rows[r][i] * b for a, b in zip(rows[r], rows[i], strict=True)]
    return [row[-1] for row in rows]
