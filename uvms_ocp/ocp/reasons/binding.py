"""What holds a level back at its optimum, by the multipliers of bounds, constraints and levels above."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.reasons.groups import Group, Grouped, Measure, row_groups, variable_groups
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers.nlp.level_solver import NlpPoint
from uvms_ocp.solvers.nlp.lexicographic_nlp import LexicographicResult
from uvms_ocp.solvers.nlp.program import LevelRows

_WEAK = 0.1  # share of the strongest below which a group is not named
_MOST = 3  # groups that are named
_FARTHEST = 10.0  # times its scale: what would have to give way by more does not hold the level back


@dataclass(frozen=True, kw_only=True, slots=True)
class Binding:
    """A group that holds a level back."""

    group: Group
    strength: float
    """[-] by which the cost of the level would fall for an amount of 1, to first order."""
    axes: tuple[str, ...]
    """That hold most, where the group has several."""

    def needed(self, cost: float) -> float:
        """Amount by which the group alone would have to give way for the level to lose its cost [-].

        The root of the cost is taken to go on falling as it does at first.
        """
        return 2 * cost / self.strength


def is_held(point: NlpPoint) -> bool:
    """Whether anything holds the end of a level at all."""
    multipliers = (point.x_multipliers, point.row_multipliers)
    return any(own is not None and bool(own.any()) for own in multipliers)


def bindings(
    transcription: Transcription, problem: OcpProblem, point: NlpPoint, level: int, cost: float
) -> list[Binding]:
    """What holds a level back where it ended, at `cost` [-], the strongest first; none where its end has no multipliers."""
    if point.x_multipliers is None or point.row_multipliers is None or cost == 0.0:
        return []
    rows = row_groups(transcription, problem)
    found = [
        *_summed(variable_groups(transcription), point.x_multipliers),
        *_summed(rows, point.row_multipliers[: len(rows.number)]),
        *_levels(transcription, point.row_multipliers, level),
    ]
    strong = [item for item in found if item.strength > 0 and item.needed(cost) <= _FARTHEST]
    strong.sort(key=lambda item: -item.strength)
    return [item for item in strong if item.strength >= _WEAK * strong[0].strength][:_MOST]


def _summed(grouped: Grouped, multipliers: np.ndarray) -> Iterator[Binding]:
    """An amount of 1 loosens all bounds of a group at all nodes."""
    strengths = np.abs(multipliers) * grouped.scale
    for i, group in enumerate(grouped.groups):
        strength = float(strengths[grouped.number == i].sum())
        yield Binding(group=group, strength=strength, axes=grouped.strongest(i, strengths))


def _levels(transcription: Transcription, multipliers: np.ndarray, level: int) -> Iterator[Binding]:
    rows = transcription.ranges().levels
    for above, price in zip(rows[:level], prices_of(rows, multipliers, level), strict=True):
        yield Binding(group=Group(name=f"level {above.name!r}", measure=Measure.LEVEL), strength=price, axes=())


def prices_of(rows: tuple[LevelRows, ...], multipliers: np.ndarray, level: int) -> tuple[float, ...]:
    """What every level above costs a level whose end has these multipliers (n_rows,) [1/unit of the row].

    Of all ways to let the residual of a level above grow by 1 as a norm, the best one lowers the cost by the norm of its
    multipliers.
    """
    return tuple(float(np.linalg.norm(multipliers[above.frozen])) for above in rows[:level])


def level_prices(transcription: Transcription, result: LexicographicResult, level: int) -> tuple[float, ...]:
    """See `uvms_ocp.ocp.plan.LevelReport.prices`; zeros where a level is met in full by anticipation, none if not known."""
    last = level == len(result.points) - 1
    multipliers = result.points[level].row_multipliers
    if multipliers is None or (result.anticipated and not last):
        return (0.0,) * level
    prices = prices_of(transcription.ranges().levels, multipliers, level)
    return () if np.isnan(prices).any() else prices
