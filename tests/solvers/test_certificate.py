"""The certificate is a bound: nobody finds a better velocity than it allows, in Python and in C,
and at optima it is small.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import casadi as ca
import numpy as np
import pytest
from compiler import MISSING, needs_compiler
from hierarchies import _optimum, dependent_hierarchy, distance, random_hierarchy

from uvms_ocp.codegen.libraries import compile_library
from uvms_ocp.errors import InvalidInput
from uvms_ocp.solvers.hierarchy import tolerances
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet, core_source
from uvms_ocp.solvers.hierarchy.certificate import (
    NormalRows,
    certificate,
    level_excesses,
    normal_certificate,
    normal_rows,
)
from uvms_ocp.solvers.hierarchy.level import Level, stack

SIZES = (5, 2, 3, 1, 3, 5)
ACTIVE_SET = LexicographicActiveSet()


def _normal(levels: list[Level]) -> NormalRows:
    rows = stack(levels)
    return normal_rows(rows.jacobian, rows.lower, rows.upper, rows.sizes)


def _in_python(levels: list[Level], v: np.ndarray) -> float:
    rows = _normal(levels)
    return normal_certificate(rows, v / rows.velocity)


@cache
def _core(n: int, sizes: tuple[int, ...]) -> ca.Function:
    return ca.external("active_set_certificate", str(compile_library(core_source(n, sizes))))


def _in_c(levels: list[Level], v: np.ndarray) -> float:
    rows = stack(levels)
    return float(_core(len(v), rows.sizes)(rows.jacobian, rows.lower, rows.upper, rows.gate, v))


NORMAL = [_in_python] if MISSING else [_in_python, _in_c]


def _better(levels: list[Level], k: int, v: np.ndarray, low: np.ndarray, up: np.ndarray) -> float:
    """By how much level k can be improved with the rows above at their residuals or better, and y
    in [low, up].
    """
    above = [
        Level(jacobian=np.eye(len(v)), lower=np.minimum(low, v), upper=np.maximum(up, v)),
        *levels[:k],
    ]
    J = np.concatenate([level.jacobian for level in above])
    lower = np.minimum(np.concatenate([level.lower for level in above]), J @ v)
    upper = np.maximum(np.concatenate([level.upper for level in above]), J @ v)
    y = _optimum(levels[k], (J, lower, upper), v)
    # Better at the cost of the rows above is no better.
    allowed = np.abs(distance(J @ y, lower, upper)).max() < 1e-10
    return _missed(levels[k], v) - _missed(levels[k], y) if allowed else -np.inf


def _share(levels: list[Level], k: int, v: np.ndarray, rows: NormalRows) -> float:
    """What `_better` finds within reach, of the residual of the level or the unit of rates."""
    reach = tolerances.REACH * rows.velocity
    unit = rows.unit * rows.level[k] * rows.velocity
    return _better(levels, k, v, v - reach, v + reach) / max(_missed(levels[k], v), unit)


def _missed(level: Level, v: np.ndarray) -> float:
    return float(np.linalg.norm(distance(level.jacobian @ v, level.lower, level.upper)))


def _nearly_slack(seed: int, slack: float) -> tuple[list[Level], np.ndarray]:
    """A box, rows missed by nearly nothing, and a level that wants to go where these rows let
    it.
    """
    rng = np.random.default_rng(seed)
    J = rng.standard_normal((3, 5))
    v = rng.uniform(-0.5, 0.5, 5)
    size = 10.0 ** rng.uniform(-3, 1)
    box = Level(jacobian=np.eye(5), lower=-1.0, upper=1.0)
    missed = slack * rng.choice([-1.0, 0.0, 1.0], 3)
    lent = Level(jacobian=size * J, upper=size * (J @ v - missed))
    desired = rng.standard_normal((2, 5))
    return [box, lent, Level(jacobian=desired, lower=2.0, upper=2.0)], v


def _cases() -> list[tuple[list[Level], np.ndarray]]:
    cases = [_nearly_slack(seed, 10.0 ** (seed % 10 - 12)) for seed in range(30)]
    for seed in range(30):
        levels = random_hierarchy(seed, 5, SIZES)
        rng = np.random.default_rng(seed)
        v = ACTIVE_SET.solve(levels).v
        cases.append((levels, v + 10.0 ** rng.uniform(-13, 0) * rng.standard_normal(5)))
    return cases


def test_no_better_velocity_is_found_than_the_certificate_allows() -> None:
    tight = 0
    tried = []
    for levels, v in _cases():
        box = levels[0]
        unit = _normal(levels)
        excesses = [_better(levels, k, v, box.lower, box.upper) for k in range(len(levels))]
        tried += np.isfinite(excesses).tolist()
        bounds = level_excesses(levels, v)
        assert (bounds >= np.array(excesses) - 1e-9).all()
        share = max(_share(levels, k, v, unit) for k in (1, 2))
        for normal in NORMAL:
            assert normal(levels, v) >= share - 1e-9
        tight += bool((bounds <= 3.0 * np.maximum(excesses, 1e-9)).all())
    assert np.mean(tried) > 0.9
    assert tight > 20


@needs_compiler
@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("slack", [2e-9, 1e-12, 1e-6])
def test_a_slack_of_nearly_nothing_does_not_hide_what_a_lower_level_is_short_of(
    size: float, slack: float
) -> None:
    levels = [Level(jacobian=[[size]], upper=0.0), Level(jacobian=[[1.0]], lower=-1.0, upper=-1.0)]
    assert certificate(levels, [slack]) == pytest.approx(1.0, rel=1e-5)
    assert _in_c(levels, np.array([slack])) > 0.1
    assert max(certificate(levels, [-1.0]), _in_c(levels, np.array([-1.0]))) < 1e-12


@needs_compiler
def test_a_wrong_velocity_of_seven_joints_is_seen() -> None:
    rng = np.random.default_rng(0)
    J = rng.standard_normal((3, 7))
    direction = rng.standard_normal(7)
    direction *= 0.21 / np.linalg.norm(direction)
    box = Level(jacobian=np.eye(7), lower=-1.0, upper=1.0)
    levels = [
        box,
        Level(jacobian=1e-3 * J, upper=0.0),
        Level(jacobian=J[:1], lower=-0.2, upper=-0.2),
    ]
    v = ACTIVE_SET.solve([*levels, Level(jacobian=np.eye(7), lower=0.0, upper=0.0)]).v
    assert certificate(levels, v) < 1e-12
    wrong = v - 0.21 * np.linalg.pinv(J) @ [-1.0, 0.0, 0.0]
    lent = levels[1].jacobian @ wrong
    levels[1] = Level(jacobian=levels[1].jacobian, upper=lent - 2e-12)
    assert certificate(levels, wrong) == pytest.approx(0.21, rel=1e-3)
    assert _in_c(levels, wrong) > 0.1


CONTRADICTING: list[tuple[Level, list[float]]] = [
    (Level(jacobian=[[1.0], [1.0]], lower=[1.0, -1.0], upper=[1.0, -1.0]), [0.9]),
    (Level(jacobian=[[1.0], [1.0]], lower=[-2.0, 1.0], upper=[-1.0, 2.0]), [0.5]),
    (
        Level(
            jacobian=[[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]],
            lower=[-1.0, -1.0, 10.0],
            upper=[1.0, 1.0, 10.0],
        ),
        [1.0, 1.0],
    ),
]


@pytest.mark.parametrize(("level", "v"), CONTRADICTING)
def test_a_first_level_that_contradicts_its_own_box_is_no_optimum_because_the_box_ends_there(
    level: Level, v: list[float]
) -> None:
    solution = ACTIVE_SET.solve([level])
    short = _missed(level, np.array(v)) - _missed(level, solution.v)
    assert certificate([level], v) >= short > 0.1
    assert solution.status.exact
    for normal in NORMAL:
        assert (
            normal([level], solution.v) <= tolerances.CERTIFIED < 0.1 < normal([level], np.array(v))
        )


@pytest.mark.sampled
@pytest.mark.parametrize("normal", [_in_python, pytest.param(_in_c, marks=needs_compiler)])
def test_an_optimum_has_a_small_certificate(
    normal: Callable[[list[Level], np.ndarray], float],
) -> None:
    for seed in range(30):
        levels = random_hierarchy(seed)
        v = ACTIVE_SET.solve(levels).v
        assert certificate(levels, v) < 1e-10
        assert normal(levels, v) <= tolerances.CERTIFIED


def test_the_radius_is_how_far_a_better_velocity_is_looked_for() -> None:
    levels = [Level(jacobian=[[1.0, 0.0]], lower=5.0, upper=5.0)]
    assert certificate(levels, [0.0, 0.0]) == pytest.approx(5.0)
    assert certificate(levels, [0.0, 0.0], radius=0.5) == pytest.approx(0.5)
    assert certificate(levels, [0.0, 0.0], radius=[2.0, 1e-3]) == pytest.approx(2.0)
    for wrong in (0.0, -1.0, np.inf, np.nan, [1.0, 2.0, 3.0]):
        with pytest.raises(InvalidInput, match="give one finite velocity > 0"):
            certificate(levels, [0.0, 0.0], radius=wrong)
    with pytest.raises(InvalidInput, match=r"v has shape \(3,\); the levels have 2 columns"):
        certificate(levels, np.zeros(3))


def test_what_is_left_of_a_cancellation_asks_for_no_velocity() -> None:
    levels = [
        Level(jacobian=[[1e-17, 0.0]], lower=1.0, upper=1.0),
        *random_hierarchy(0, 2, (2, 1, 1, 2)),
    ]
    solution = ACTIVE_SET.solve(levels)
    assert solution.status.exact
    assert solution.certificate(levels) < 1e-10


@needs_compiler
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e308])
def test_what_is_no_velocity_has_no_certificate(value: float) -> None:
    levels = random_hierarchy(0, 5, SIZES)
    v = np.full(5, value)
    assert not certificate(levels, v) < 1e300
    assert not _in_c(levels, v) < 1e300


@pytest.mark.parametrize("power", [-300, -12, 11, 300])
def test_the_certificate_has_the_unit_of_its_rows(power: int) -> None:
    levels = random_hierarchy(1, 5, SIZES)
    scale = 2.0 ** (3 * power)
    scaled = [
        Level(jacobian=lv.jacobian * scale, lower=lv.lower * scale, upper=lv.upper * scale)
        for lv in levels
    ]
    v = ACTIVE_SET.solve(levels).v + 1e-3
    assert certificate(scaled, v) == pytest.approx(
        certificate(levels, v) * scale, rel=1e-9, abs=0.0
    )


@pytest.mark.parametrize("slope", [1.0, 1e-3, 1e-5])
def test_without_a_box_what_is_far_away_counts(slope: float) -> None:
    levels = [
        Level(jacobian=[[1.0, 0.0]], lower=0.0, upper=0.0),
        Level(jacobian=[[1.0, slope]], lower=1.0, upper=1.0),
    ]
    assert certificate(levels, [0.0, 0.0]) == pytest.approx(1.0)
    assert certificate(levels, [0.0, 0.5 / slope]) == pytest.approx(0.5)
    assert certificate(levels, [0.0, 1.0 / slope]) < 1e-9


@pytest.mark.parametrize("seed", range(20))
def test_without_a_box_no_loss_is_larger_than_the_certificate(seed: int) -> None:
    """Equalities of random rows, of which some are nearly dependent, against least squares in the
    null space.
    """
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(2, 4))
    B = rng.normal(size=(3, 4))
    B[0] = A[0] + 10.0 ** rng.uniform(-4, 0) * B[0]
    a = A @ rng.normal(size=4)
    b = rng.normal(size=3)
    levels = [Level(jacobian=A, lower=a, upper=a), Level(jacobian=B, lower=b, upper=b)]
    on_first = np.linalg.lstsq(A, a, rcond=None)[0]
    null = np.linalg.svd(A)[2][2:].T
    best = on_first + null @ np.linalg.lstsq(B @ null, b - B @ on_first, rcond=None)[0]
    smallest = np.linalg.norm(B @ best - b)
    assert certificate(levels, best) < 1e-7 * max(1.0, np.abs(best).max())
    for size in (1e-2, 1.0, 100.0):
        v = best + null @ rng.normal(size=2) * size
        assert certificate(levels, v) >= (np.linalg.norm(B @ v - b) - smallest) * (1 - 1e-9)


@pytest.mark.sampled
@needs_compiler
@pytest.mark.parametrize("nearly", [0.0, 1e-3])
def test_c_and_numpy_find_the_same_bound(nearly: float) -> None:
    """Also of rows that are copied, combined and zero, at optima and away from them. Which of rows
    that depend on each other exactly bear a multiplier is for rounding to decide; then both are
    bounds, and say the same of whether a velocity is an optimum.
    """
    equal = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        levels = dependent_hierarchy(seed, 5, SIZES, nearly)
        optimum = ACTIVE_SET.solve(levels).v
        for v in (optimum, optimum + 10.0 ** rng.uniform(-13, 0) * rng.standard_normal(5)):
            bound = _in_python(levels, v)
            twin = _in_c(levels, v)
            equal.append(twin == pytest.approx(bound, rel=1e-11, abs=1e-11))
            assert (twin <= tolerances.CERTIFIED) == (bound <= tolerances.CERTIFIED), seed
    assert np.mean(equal) >= (1.0 if nearly else 0.98)
