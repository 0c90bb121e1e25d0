"""Reports of an identification: a calibration in words and as data, and the report of an experiment.

`uvms_ocp.identification.report_prose` has the wording, `uvms_ocp.identification.fit_tables` the
tables of predictions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.identification import (
    coordinates,
    experiment_design,
    parameters,
    report_prose,
)
from uvms_ocp.identification.advice import advice
from uvms_ocp.identification.calibration import Calibration
from uvms_ocp.identification.calibration_robot import SHAPE_SPREADS, shape_of
from uvms_ocp.identification.channel_evidence import Evidence
from uvms_ocp.identification.fit_tables import fits, left_out_tables
from uvms_ocp.identification.held_constants import HeldConstant
from uvms_ocp.identification.identified_numbers import DETERMINED_BELOW, MISSES, IdentifiedNumber
from uvms_ocp.identification.prediction_text import (
    prediction_data,
    prediction_lines,
    shortfall_data,
)
from uvms_ocp.identification.robot_variant import IN_FILE
from uvms_ocp.identification.whiteness import LEAST_P, LEVEL

_OF_FILE = ("mass", "centre_of_mass", "second_moment", "dead_zone", "dead_zone_reverse")
"""Quantities that settings or a robot file give."""
_MOST_COMBINATIONS = 6  # that are listed, the worst first
_DECADES = 1e3  # ratio of the ends from which on the interval of a positive number is called open


@checked
def report_text(calibration: Calibration) -> str:
    """Write the report of a calibration as Markdown: numbers, intervals, what stays open,
    predictions, doubts.
    """
    parts = [
        "# Calibration",
        *_number_table(calibration),
        *_recording_table(calibration),
        *_profile_table(calibration),
        *_open_directions(calibration),
        *_held_table(calibration),
        *_whiteness_table(calibration),
    ]
    parts += fits(calibration.comparisons)
    parts += left_out_tables(calibration.left_out)
    parts += prediction_lines(calibration.left_out, calibration.left_out_bounds)
    parts += _disagreed(calibration)
    parts += left_out_tables(calibration.predicted, report_prose.PREDICTED)
    parts += prediction_lines(calibration.predicted, calibration.predicted_bounds)
    parts += ["", "## Doubts about the recordings", ""]
    parts += [f"- {doubt}" for doubt in calibration.issues or ("none",)]
    parts += _evidence_table(calibration)
    return "\n".join(parts) + "\n"


@checked
def report_data(calibration: Calibration) -> dict[str, Any]:
    """Return the numbers and verdicts of the report, for JSON; what is not finite is `None`."""
    shortfalls: list[dict[str, Any]] = []
    for comparison in calibration.comparisons:
        shortfalls.extend(shortfall_data(shortfall) for shortfall in comparison.worse_than_still)
    data: dict[str, Any] = {
        "status": calibration.status.value,
        "advice": calibration.advice,
        "file_usable": calibration.exported.usable,
        "numbers": [_number_data(number) for number in calibration.numbers],
        "seen_worse_than_still": shortfalls,
        "doubts": list(calibration.issues),
        "evidence": [_evidence_data(name, entry) for name, entry in calibration.evidence],
    }
    if calibration.left_out:
        data["left_out"] = prediction_data(calibration.left_out, calibration.left_out_bounds)
        data["numbers_disagreed_on"] = [
            {"name": entry.number.name, "scatter": entry.scatter, "sentence": str(entry)}
            for entry in calibration.disagreed
        ]
    if calibration.predicted:
        data["predicted"] = prediction_data(calibration.predicted, calibration.predicted_bounds)
    return data


def _disagreed(calibration: Calibration) -> Iterator[str]:
    """List the determined numbers that move by more than their interval where a recording is left
    out.
    """
    if not calibration.left_out:
        return
    yield report_prose.DISAGREED
    disagreed = calibration.disagreed
    if not disagreed:
        yield "None."
    for number in disagreed:
        yield f"- {number}"


def _number_data(number: IdentifiedNumber) -> dict[str, Any]:
    """Return an identified number for JSON."""
    low, high = number.interval
    return {
        "name": number.name,
        "unit": number.unit,
        "value": number.value,
        "standard_error": _finite(number.sigma),
        "interval": [_finite(low), _finite(high)],
        "determined": number.determined,
    }


def _finite(value: float) -> float | None:
    """Return the value, or `None` where it is not finite."""
    return value if np.isfinite(value) else None


def _number_table(calibration: Calibration) -> Iterator[str]:
    """Tabulate the identified numbers, after the status of the search and the assumptions of
    intervals.
    """
    yield report_prose.STATUS.format(
        status=calibration.status,
        inflation=calibration.inflation,
        below=100 * DETERMINED_BELOW,
        most=MISSES,
    )
    missed = [test.channel for test in calibration.whiteness if test.unexplained]
    if missed:
        yield report_prose.UNEXPLAINED.format(missed=", ".join(missed))
    axes = calibration.subject.vehicle.axes
    if len(axes) < len(parameters.AXES):
        yield report_prose.HELD_AXES.format(axes=", ".join(parameters.AXES[k] for k in axes))
    shape = shape_of(calibration.subject.robot, calibration.subject.frame)
    if shape:
        yield report_prose.SHAPE_PRIORS.format(
            shape=shape, frame=calibration.subject.frame, **SHAPE_SPREADS
        )
    yield report_prose.NUMBER_TABLE
    for number in calibration.numbers:
        columns = (
            f"{number.value:.4g} | {number.unit} | {number.sigma:.2g} | {_ends(number.interval)}"
        )
        determined = "yes" if number.determined else "no"
        in_file = _in_file(calibration, number)
        yield f"| {number.name} | {columns} | {determined} | {in_file} |"


def _recording_table(calibration: Calibration) -> Iterator[str]:
    """Tabulate the unknowns that each recording has for itself, such as its current; nothing where
    none are learnt.
    """
    unknowns = calibration.subject.vehicle.per_recording
    if not unknowns.names:
        return
    headers = []
    for name in unknowns.names:
        quantity = unknowns.declaration.quantities[name.partition(" ")[0]]
        headers.append(f"{name} [{quantity.unit}]")
    yield report_prose.PER_RECORDING
    yield "| recording | " + " | ".join(headers) + " |"
    yield "|---" + "|---:" * len(headers) + "|"
    for name, values in calibration.estimate.per_recording.items():
        yield f"| {name} | {' | '.join(f'{value:.3g}' for value in values)} |"


def _in_file(calibration: Calibration, number: IdentifiedNumber) -> str:
    """Write whether the robot's file gets a number."""
    if number.quantity not in IN_FILE or not calibration.exported.usable:
        return "no"
    if number.name in calibration.exported.kept:
        return "as before"
    return "yes"


def _profile_table(calibration: Calibration) -> Iterator[str]:
    """Tabulate profiles beside intervals by standard errors; nothing where there are none."""
    if not calibration.profiles:
        return
    yield report_prose.PROFILES
    for profile in calibration.profiles:
        number = profile.number
        word = "differs" if profile.differs else ""
        yield (
            f"| {number.name} | {number.unit} | {_ends(number.interval)} | {_ends(profile.interval)} |"
            f" {word} |"
        )


def _ends(interval: tuple[float, float]) -> str:
    """Write the ends of an interval; ``open`` where one is missing, or decades are between them."""
    low, high = interval
    is_wide = high > _DECADES * abs(low) and low >= 0.0
    if not np.isfinite(interval).all() or is_wide:
        return "open"
    return f"{low:.4g} to {high:.4g}"


def _open_directions(calibration: Calibration) -> Iterator[str]:
    """List the worst combinations that stay open, and what would determine them."""
    yield "\n## Combinations that the recordings leave open\n"
    if not calibration.open:
        yield "None."
    for direction in calibration.open[:_MOST_COMBINATIONS]:
        shares = " ".join(f"{share:+.2f} {name}" for name, share in direction.shares)
        yield (
            f"- {shares}: standard error {min(direction.sigma, 1e3):.2g} without priors. To determine"
            f" it: {advice(direction)}."
        )


def _evidence_table(calibration: Calibration) -> Iterator[str]:
    """Tabulate what the reading of each channel rests on."""
    if not calibration.evidence:
        return
    yield report_prose.EVIDENCE
    for recording, entry in calibration.evidence:
        yield (
            f"| {recording} | {entry.channel} | {entry.aspect} | {entry.status} |"
            f" {entry.evidence} |"
        )


def _evidence_data(recording: str, entry: Evidence) -> dict[str, str]:
    """Return what one aspect of a channel's reading rests on, for JSON."""
    return {
        "recording": recording,
        "channel": entry.channel,
        "aspect": entry.aspect,
        "status": entry.status,
        "evidence": entry.evidence,
    }


def _held_table(calibration: Calibration) -> Iterator[str]:
    """Tabulate the constants of the fit, and the effect that an error of each would have."""
    yield report_prose.HELD_CONSTANTS
    constants = {constant.quantity: constant for constant in calibration.constants}
    quantities = calibration.subject.vehicle.shared.declaration.quantities
    for name, quantity in quantities.items():
        if name in IN_FILE or quantity.free.any():
            continue
        constant = constants.get(name)
        if constant is not None:
            effect = f"{constant.known} | {constant.spread:g} | {constant.most_changed} by {constant.change:.2g}"
        elif name in _OF_FILE or not calibration.constants:
            effect = "robot's file | - | -"
        else:
            effect = "assumed | - | -"
        yield f"| {name} | {_range_of(quantity.value)} | {quantity.unit} | {effect} |"
    box = quantities["centre_of_buoyancy"].coordinates
    if isinstance(box, coordinates.Interval):
        yield (
            f"| hull | {box.lower.min():.4g} to {box.upper.max():.4g} | m | given | - |"
            " centre_of_buoyancy at its ends |"
        )
    for constant in constants.values():
        if constant.unit:
            yield _noise_row(constant)


def _range_of(values: np.ndarray) -> str:
    """Write the smallest and the largest value, or the one that all have."""
    rounded = np.round(values.ravel(), 5)
    if np.ptp(rounded) == 0.0:
        return f"{rounded.min():.4g}"
    return f"{rounded.min():.4g} to {rounded.max():.4g}"


def _noise_row(constant: HeldConstant) -> str:
    """Write the row of a constant with a unit of its own, such as the noise of a sensor."""
    return (
        f"| {constant.quantity} | {constant.value:g} | {constant.unit} | {constant.known} |"
        f" {constant.spread:g} | {constant.most_changed} by {constant.change:.2g} |"
    )


def _whiteness_table(calibration: Calibration) -> Iterator[str]:
    """Tabulate the whiteness of the residuals, channel by channel."""
    yield report_prose.WHITENESS.format(level=LEVEL)
    for test in calibration.whiteness:
        word = "yes" if test.white else "no"
        p_value = f"below {LEAST_P:g}"
        if test.p > LEAST_P:
            p_value = f"{test.p:.2g}"
        yield f"| {test.channel} | {test.size:.2g} | {test.inflation:.3g} | {p_value} | {word} |"


@checked
def excitation_text(excitation: experiment_design.Excitation, actuators: Sequence[str]) -> str:
    """Write the report of an excitation as Markdown. actuators: names, in the order of its
    commands.
    """
    lines = ["# Excitation", ""]
    lines += _course(excitation, actuators)
    return "\n".join(lines) + "\n"


def _course(excitation: experiment_design.Excitation, actuators: Sequence[str]) -> Iterator[str]:
    """Yield how far a design leads, and what one recording of it is expected to determine."""
    spans = [f"{low:+.2f} to {high:+.2f}" for low, high in excitation.swept.T]
    step = float(excitation.commands.t[1] - excitation.commands.t[0])
    tilt = 2.0 * np.arcsin(np.hypot(*excitation.states[:, 3:5].T).max())
    yield f"{excitation.status.value}: {excitation.status.advice}\n"
    yield (
        f"Commands last {step * len(excitation.commands.t):.4g} s, held for {step:.4g} s each, of"
        f" {', '.join(actuators)}.\n"
    )
    yield report_prose.EXCITATION.format(spans=", ".join(spans), tilt=tilt)
    for number in excitation.numbers:
        determined = "yes" if number.determined else "no"
        yield (
            f"| {number.name} | {number.value:.4g} | {number.unit} | {number.sigma:.2g} |"
            f" {determined} |"
        )
