"""How well recordings are predicted, as tables: nothing is told without what predictors that know less make of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from uvms_ocp.identification.answers.left_out import OTHERS, Horizon, LeftOut
from uvms_ocp.identification.answers.predictions import Predicted, fit
from uvms_ocp.identification.answers.scores import SCORED, errors
from uvms_ocp.identification.calibration.fitting import Comparison
from uvms_ocp.identification.parameters.vehicle_quantities import AXES

_STILL = 1e-3  # [m/s, rad/s] deviation below which a channel has no fit


def fits(comparisons: Sequence[Comparison]) -> Iterator[str]:
    """Of recordings that were seen."""
    yield "\n## Fits of whole recordings, in percent, from commands alone\n"
    yield "Recordings were seen by the search: predictions of others are worse. In brackets: before the calibration, and a"
    yield "vehicle that does not move. Tilt: error of the vertical in degrees; in brackets before, as it was at first, and in"
    yield "static balance.\n"
    yield "| recording | " + " | ".join((*AXES, "tilt")) + " |"
    yield "|---" * (2 + len(AXES)) + "|"
    for each in comparisons:
        columns = zip(*(_by_axis(one) for one in (each.calibrated, each.before, each.still)), strict=True)
        cells = [f"{after} ({before}; {still})" for after, before, still in columns]
        after, *others = (errors(one)[-1] for one in (each.calibrated, each.before, each.still, each.balance))
        yield f"| {each.name} | {' | '.join(cells)} | {after:.2g} ({'; '.join(f'{x:.2g}' for x in others)}) |"


def _by_axis(predicted: Predicted) -> list[str]:
    pairs = [(predicted.seen[k][:, i], predicted.rows[k][:, i]) for k in range(2) for i in range(3)]
    return [f"{fit(*pair):.0f}" if np.std(pair[0]) > _STILL else "-" for pair in pairs]


def left_out_tables(one: Sequence[LeftOut]) -> Iterator[str]:
    """Of recordings that were not, by horizons; nothing where none was left out."""
    if not one:
        return
    yield "\n## Predictions of recordings that were left out\n"
    yield "Each recording is predicted by what the others tell, from commands alone, horizon by horizon, each from what was"
    yield "known before it. Root mean squares of errors in m/s, rad/s and degrees (tilt), medians over the recordings; the last"
    yield "horizon is as long as recordings are. In bold: worse than one that knows less."
    for asked in sorted({each.asked for left in one for each in left.horizons}):
        yield from _horizon(asked, [each for left in one for each in left.horizons if each.asked == asked])
    yield from _by_recording(one)


def _horizon(asked: float, found: Sequence[Horizon]) -> Iterator[str]:
    short = min(each.length for each in found)
    yield f"\n### {asked:g} s" + (f" (recordings have {short:.3g} s)" if short < asked - 1e-6 else "")
    yield "\n| predicted by | " + " | ".join(SCORED) + " |"
    yield "|---" + "|---:" * len(SCORED) + "|"
    rows = {name: np.median([errors(each.by[name]) for each in found], axis=0) for name in found[0].by}
    best = np.min([row for name, row in rows.items() if name != OTHERS], axis=0)
    for name, row in rows.items():
        worse = (row > best) & (name == OTHERS)
        yield f"| {name} | {' | '.join(_cell(*pair) for pair in zip(row, worse, strict=True))} |"


def _by_recording(one: Sequence[LeftOut]) -> Iterator[str]:
    yield "\n### Each recording, over the longest horizon that it has\n"
    yield "In brackets: the best that knows less.\n"
    yield "| recording | " + " | ".join(SCORED) + " |"
    yield "|---" * (1 + len(SCORED)) + "|"
    for each in one:
        if each.horizons:
            yield f"| {each.name} | {' | '.join(_beside(each.horizons[-1]))} |"
    for each in one:
        if not each.horizons:
            yield f"\n{each.name}: the others determine too little to predict it (their search: {each.estimate.status.value})."


def _beside(one: Horizon) -> Iterator[str]:
    found = {name: errors(predicted) for name, predicted in one.by.items()}
    best = np.min([row for name, row in found.items() if name != OTHERS], axis=0)
    for value, other in zip(found[OTHERS], best, strict=True):
        yield f"{_cell(value, value > other)} ({other:.2g})"


def _cell(value: float, worse: bool) -> str:
    return f"**{value:.2g}**" if worse else f"{value:.2g}"
