"""Laws of the parts of a step: which share of it is taken, how far it may go, and when there is no
time for another.
"""

from __future__ import annotations

import numpy as np
import pytest

from uvms_ocp.solvers.nlp.options import SqpOptions
from uvms_ocp.solvers.nlp.program import LevelRows, RowBounds
from uvms_ocp.solvers.nlp.real_time_sqp import (
    LevelMerit,
    LexicographicSqp,
    ProximalWeights,
    SqpPoint,
    TimeBudget,
    acceptance,
)


def level(relax: float | None = None) -> LevelRows:
    return LevelRows(
        name="level", lower=np.zeros(1), upper=np.zeros(1), relax=relax, frozen=slice(0, 1)
    )


def merit(violation: float, *residuals: float) -> LevelMerit:
    return LevelMerit(violation=violation, residuals=np.array(residuals))


class Stuck:
    """A model whose steps lead nowhere, and which remembers whose they were."""

    slack = 0.0

    def __init__(self, point: SqpPoint) -> None:
        self.point = point
        self.stepped = list[int]()

    def begin(self, x: np.ndarray, p: np.ndarray, bounds: RowBounds) -> SqpPoint:
        return self.point

    def step(self, level: int, point: SqpPoint, bounds: RowBounds, damping: float) -> None:
        self.stepped.append(level)

    def moved(self, share: float) -> SqpPoint:
        return self.point

    def variables(self, point: SqpPoint) -> np.ndarray:
        return point.x


@pytest.mark.parametrize(
    ("lacking", "turns"), [((1.0, 0.1, 2.0), [0, 2]), ((0.0, 0.11, 0.0), [0, 1])]
)
def test_below_the_first_only_levels_that_lack_more_than_they_may_lose_have_their_turn(
    lacking: tuple[float, ...], turns: list[int]
) -> None:
    model = Stuck(SqpPoint(x=np.zeros(1), rows=(np.zeros(1),) * 3, merit=merit(0.0, *lacking)))
    bounds = RowBounds(
        lower=np.zeros(3), upper=np.zeros(3), x_lower=np.zeros(1), x_upper=np.zeros(1)
    )
    point, failure = LexicographicSqp(model, SqpOptions(tolerance=0.1), 3).step(
        model.point, (level(),) * 3, bounds, TimeBudget(np.inf, lambda: 0.0)
    )
    assert failure is None
    assert model.stepped == turns
    assert point.reached == lacking


@pytest.mark.parametrize(
    ("candidate_merit", "allowed"),
    [
        (merit(0.01, 1.1, 2.0), True),
        (merit(0.0, 0.0, 0.0), True),
        (merit(0.0, 1.11, 0.0), False),
        (merit(0.0, 1.0, 2.11), False),
        (merit(0.011, 1.0, 2.0), False),
        (merit(np.inf, 1.0, 2.0), False),
        (merit(0.0, np.nan, 2.0), False),
        (merit(np.nan, 1.0, 2.0), False),
    ],
)
def test_a_step_may_cost_no_level_above_and_no_constraint_more_than_the_tolerance(
    candidate_merit: LevelMerit, allowed: bool
) -> None:
    rule = acceptance(
        [level(), level()], [1.0], merit(0.0, 1.05, 2.0), accuracy=0.01, tolerance=0.1
    )
    assert rule.allows(candidate_merit) is allowed


def test_a_step_may_leave_constraints_as_broken_as_they_are() -> None:
    rule = acceptance([level(), level()], [1.0], merit(0.5, 1.0, 2.0), accuracy=0.01, tolerance=0.1)
    assert rule.allows(merit(0.5, 1.0, 2.0))
    assert not rule.allows(merit(0.51, 1.0, 2.0))


def test_only_the_first_level_pays_for_a_guess_that_breaks_constraints() -> None:
    first = acceptance([level()], [], merit(0.5, 1.0), accuracy=0.01, tolerance=0.1)
    assert first.allows(merit(0.4, 9.0))
    fine = acceptance([level()], [], merit(0.005, 1.0), accuracy=0.01, tolerance=0.1)
    assert not fine.allows(merit(0.004, 9.0))


def test_a_level_that_may_be_relaxed_keeps_its_share_of_the_cost() -> None:
    frozen = level(relax=0.21).kept(2.0, 0.0)
    assert frozen**2 / 2 == pytest.approx(1.21 * 2.0**2 / 2)
    assert level().kept(2.0, 0.1) == pytest.approx(2.1)


def test_weights_rise_where_steps_are_cut_fall_where_they_are_not_and_stay_within_bounds() -> None:
    weights = ProximalWeights(2, 1e-4)
    assert (weights[0], weights[1]) == (0.0, 1e-4)
    weights.adapt(1, 0.5)
    risen = weights[1]
    assert risen > 1e-4
    weights.adapt(1, 1.0)
    assert 1e-4 <= weights[1] < risen
    for _ in range(30):
        weights.adapt(0, 0.0)
        weights.adapt(1, 0.0)
    assert (weights[0], weights[1]) == pytest.approx((0.3, 0.3))
    for _ in range(30):
        weights.adapt(0, 1.0)
        weights.adapt(1, 1.0)
    assert (weights[0], weights[1]) == pytest.approx((0.0, 1e-4))


def test_time_is_over_when_another_solve_like_those_before_would_end_too_late() -> None:
    readings = iter([0.0, 1.0, 1.0, 2.0, 2.0])
    budget = TimeBudget(2.5, lambda: next(readings))
    budget.count()
    assert budget.elapsed == 1.0
    assert not budget.over
    budget.count()
    assert budget.over
