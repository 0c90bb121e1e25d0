"""A calibration in words: numbers, what is not determined, and how well recordings are predicted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uvms_ocp.identification.answers.numbers import KNOWN
from uvms_ocp.identification.answers.predictions import Predicted, fit
from uvms_ocp.identification.calibration.fitting import Calibration
from uvms_ocp.identification.calibration.variant import IN_FILE
from uvms_ocp.identification.parameters.vehicle_quantities import AXES

_STILL = 1e-3  # [m/s, rad/s] deviation below which a channel has no fit
_TOLD = 6  # combinations, the worst first


def report_text(one: Calibration) -> str:
    """Markdown."""
    parts = ["# Calibration", *_numbers(one), *_open(one), *_fits(one), "", "## Doubts about the recordings", ""]
    return "\n".join([*parts, *(f"- {doubt}" for doubt in one.doubts or ("none",))]) + "\n"


def _numbers(one: Calibration) -> Iterator[str]:
    yield f"\nThe search has ended: {one.estimate.status.value}. {one.estimate.status.advice}"
    yield f"Standard errors take {one.together:.3g} samples for one, as residuals are not white; a number is called"
    yield f"determined below {100 * KNOWN:.0f} % of its size (lengths: of 5 cm), beyond what priors said."
    yield "\n| number | value | unit | standard error | 95 % interval | determined | in the file |"
    yield "|---|---:|---|---:|---|---|---|"
    for each in one.numbers:
        least, most = each.interval
        words = "yes" if each.determined else "no", "yes" if each.quantity in IN_FILE else "no"
        told = f"{each.value:.4g} | {each.unit} | {each.sigma:.2g} | {least:.4g} to {most:.4g}"
        yield f"| {each.name} | {told} | {words[0]} | {words[1]} |"


def _open(one: Calibration) -> Iterator[str]:
    yield "\n## Combinations that the recordings leave open\n"
    if not one.open:
        yield "None."
    for each in one.open[:_TOLD]:
        shares = " ".join(f"{share:+.2f} {name}" for name, share in each.shares)
        yield f"- {shares}: standard error {min(each.sigma, 1e3):.2g} without priors"


def _fits(one: Calibration) -> Iterator[str]:
    yield "\n## Fits of whole recordings, in percent, from commands alone\n"
    yield "Recordings were seen by the search: predictions of others are worse. In brackets: before the calibration. A vehicle"
    yield "that does not move has 0 or less.\n"
    yield "| recording | " + " | ".join(AXES) + " |"
    yield "|---" * (1 + len(AXES)) + "|"
    for each in one.comparisons:
        cells = zip(_by_axis(each.calibrated), _by_axis(each.before), strict=True)
        yield f"| {each.name} | " + " | ".join(f"{after} ({before})" for after, before in cells) + " |"


def _by_axis(predicted: Predicted) -> list[str]:
    pairs = [(predicted.seen[k][:, i], predicted.rows[k][:, i]) for k in range(2) for i in range(3)]
    return [f"{fit(*pair):.0f}" if np.std(pair[0]) > _STILL else "-" for pair in pairs]
