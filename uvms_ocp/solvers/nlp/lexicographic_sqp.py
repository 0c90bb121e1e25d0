"""Lexicographic SQP: one step of a program, its levels solved in turn, with step acceptance and proximal damping.

Judged by true residuals, not by the linear model of them. A share of 0 always keeps the rule.

The first level has none: what it wants is worth a full step. Those below move what the levels above leave free, which is
most of the variables and nearly flat for each of them, so that without a weight their steps are as long as the
linear model says and longer than it holds. A weight rises where only a share of the step could be taken, and falls slowly
back while whole steps are taken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from uvms_ocp.solvers.nlp.level_solver import SqpOptions
from uvms_ocp.solvers.nlp.program import LevelRows, NlpStatus, RowBounds

# Which share of a level's step is taken: the rule by which no level loses what it had for the sake of one below.

SHARES = (1.0, 1 / 2, 1 / 4, 1 / 8, 1 / 16)
"""Tried one after the other."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LevelMerit:
    """Merit of a point: residuals and violation."""

    violation: float
    """Largest, of scaled rows; infinite where one of them is no number."""
    residuals: np.ndarray
    """(n_levels,) norm of the residual of each level."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Acceptance:
    """Conditions on the step of a level."""

    violation: float
    """Most that constraints may be broken."""
    residuals: np.ndarray
    """(n,) largest norms of the levels above, and that of the level itself."""

    def allows(self, found: LevelMerit) -> bool:
        """Never for a merit that is not a number."""
        kept = found.residuals[: len(self.residuals)] <= self.residuals
        return bool(found.violation <= self.violation and kept.all())


def acceptance(
    levels: Sequence[LevelRows], reached: Sequence[float], here: LevelMerit, *, accuracy: float, tolerance: float
) -> Acceptance:
    """For the step of the level after those that have `reached` their residuals, from a point with merit `here`.

    Constraints may be broken by `accuracy`, or as much as they are here; residuals may rise by `tolerance`, those of
    the levels above by no more than that from where their own turn left them, however many levels follow. The first level
    pays whatever a guess lacks that breaks constraints.
    """
    above = [level.kept(norm, tolerance) for level, norm in zip(levels, reached, strict=False)]
    mending = not above and here.violation > accuracy
    own = np.inf if mending else here.residuals[len(reached)] + tolerance
    return Acceptance(violation=max(accuracy, here.violation), residuals=np.array([*above, own]))


# Weights that keep the step of a level near the point at which its rows were linearised.

_RISE, _FALL = 5.0, 0.5
_MOST = 3e3  # times the least


class ProximalWeights:
    """Proximal weights of the levels of one program; carried from one solve to the next."""

    def __init__(self, n_levels: int, least: float) -> None:
        """Least [1/unit of x^2]: of all levels but the first, whose weight is 0."""
        self._least = np.full(n_levels, least)
        self._least[:1] = 0.0
        self._now = self._least.copy()

    def __getitem__(self, level: int) -> float:
        """[1/unit of x^2]"""
        return float(self._now[level])

    def adapt(self, level: int, share: float) -> None:
        """After `share` of the level's step could be taken."""
        factor = _FALL if share == 1 else _RISE
        least = self._least[level]
        self._now[level] = np.clip(factor * self._now[level], least, _MOST * least)


# One step of a lexicographic program: its levels take their turns.


class TimeBudget:
    """Time budget that admits another QP, judged by those that were solved."""

    def __init__(self, limit: float, clock: Callable[[], float]) -> None:
        """Limit [s] from now."""
        self._limit, self._clock, self._begin, self._solved = limit, clock, clock(), 0

    def count(self) -> None:
        """One more QP was solved."""
        self._solved += 1

    @property
    def elapsed(self) -> float:
        """[s] so far."""
        return self._clock() - self._begin

    @property
    def over(self) -> bool:
        """Another QP that takes as long as those before would end too late."""
        return self.elapsed * (self._solved + 1) / max(self._solved, 1) > self._limit


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SqpPoint:
    """Point reached by the levels so far."""

    x: np.ndarray
    """(n,) [unit of x] as the model of the levels has them."""
    rows: tuple[np.ndarray, ...]
    """(m,) [unit of the row] of every level."""
    merit: LevelMerit
    reached: tuple[float, ...] = ()
    """(n,) norm of the residual of each level that had its turn, at its end."""

    def after_level(self) -> SqpPoint:
        """The same once the next level has had its turn here."""
        return replace(self, reached=(*self.reached, float(self.merit.residuals[len(self.reached)])))


class LevelModel(Protocol):
    """Linear models of the levels of a program, and the solver of their QPs."""

    slack: float
    """Allowed rise of the norm of frozen rows in a QP; 0 where it bears dependent equalities."""

    def begin(self, x: np.ndarray, p: np.ndarray, bounds: RowBounds) -> SqpPoint:
        """The point of variables x (n_x,) [unit of x]; p (n_p,) [unit of the parameter] holds from now on."""
        ...

    def step(self, level: int, point: SqpPoint, bounds: RowBounds, damping: float) -> NlpStatus | None:
        """Find the step of a level from a point, and why there is none; damping [1/unit of x^2]: weight of its square."""
        ...

    def moved(self, share: float) -> SqpPoint:
        """After a share of the last step."""
        ...

    def variables(self, point: SqpPoint) -> np.ndarray:
        """Variables (n_x,) [unit of x] of a point."""
        ...


class LexicographicSqp:
    """Lexicographic SQP on one program; the weights of its levels are carried from step to step."""

    def __init__(self, model: LevelModel, options: SqpOptions, n_levels: int) -> None:
        self._model, self._options = model, options
        self._weights = ProximalWeights(n_levels, options.proximal)

    def step(
        self, guess: SqpPoint, levels: tuple[LevelRows, ...], bounds: RowBounds, budget: TimeBudget
    ) -> tuple[SqpPoint, NlpStatus | None]:
        """Make one step from a guess; return the point reached, and why there is none."""
        guess = replace(guess, reached=())
        failure = self._model.step(0, guess, bounds, self._options.damping)
        budget.count()
        if failure is not None:
            return guess, failure
        point = self._first_searched(guess, levels).after_level()
        for i in range(1, len(levels)):
            if budget.over:
                break
            bounds = bounds.with_rows(*self._frozen(levels[i - 1], point))
            # While it lacks no more than it may lose, a level has no need of a turn.
            if point.merit.residuals[i] > self._options.tolerance:
                point = self._turn(point, levels, bounds)
                budget.count()
            point = point.after_level()
        return point, None

    def _first_searched(self, guess: SqpPoint, levels: tuple[LevelRows, ...]) -> SqpPoint:
        """Return the first point that the rule allows, or, because a guess must be left, the one of least violation."""
        rule, tried = self._rule(guess, levels), []
        for share in SHARES:
            tried.append(self._model.moved(share))
            if rule.allows(tried[-1].merit):
                return tried[-1]
        return min(tried, key=lambda point: point.merit.violation)

    def _turn(self, point: SqpPoint, levels: tuple[LevelRows, ...], bounds: RowBounds) -> SqpPoint:
        """Move the point by the step of the next level."""
        i = len(point.reached)
        failure = self._model.step(i, point, bounds, self._options.damping + self._weights[i])
        share, found = (0.0, point) if failure is not None else self._searched(point, levels, bounds)
        self._weights.adapt(i, share)
        return found

    def _searched(self, point: SqpPoint, levels: tuple[LevelRows, ...], bounds: RowBounds) -> tuple[float, SqpPoint]:
        """The share of the step that is taken, and where it leads: the largest that is allowed, or all of it, mended."""
        rule, i = self._rule(point, levels), len(point.reached)
        tried = [self._model.moved(1.0)]
        while not rule.allows(tried[-1].merit) and len(tried) < len(SHARES):
            tried.append(self._model.moved(SHARES[len(tried)]))
        share, found = (SHARES[len(tried) - 1], tried[-1]) if rule.allows(tried[-1].merit) else (0.0, point)
        if share < 1.0:
            mended = self._mended(tried[0], i, bounds)
            if rule.allows(mended.merit) and mended.merit.residuals[i] <= found.merit.residuals[i]:
                share, found = 1.0, mended
        return share, replace(found, reached=point.reached)

    def _mended(self, whole: SqpPoint, level: int, bounds: RowBounds) -> SqpPoint:
        """A whole step, and one more, which brings back what curvature did to the rows above: a second-order correction."""
        failure = self._model.step(level, whole, bounds, self._options.damping + self._weights[level])
        return whole if failure is not None else self._model.moved(1.0)

    def _rule(self, point: SqpPoint, levels: tuple[LevelRows, ...]) -> Acceptance:
        options = self._options
        return acceptance(levels, point.reached, point.merit, accuracy=options.accuracy, tolerance=options.tolerance)

    def _frozen(self, level: LevelRows, point: SqpPoint) -> tuple[slice, tuple[np.ndarray, np.ndarray]]:
        """Rows that keep the level that had the last turn where that has left it, and their bounds."""
        i = len(point.reached) - 1
        return level.frozen, level.frozen_bounds(point.rows[i], point.reached[i] ** 2 / 2, self._model.slack)
