"""Results of an identification: the report, the robot file with the identified coefficients, and
the report of an experiment.

A robot file holds coefficients of water. Mass and inertia are the URDF's, gains and delays the
driver's: the report has them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import yaml

from uvms_ocp.identification import (
    coordinates,
    experiment_design,
    fit,
    parameters,
    report_prose,
    settings,
    uncertainty,
)
from uvms_ocp.identification.advice import advice
from uvms_ocp.identification.calibration import Calibration, Comparison, HeldConstant
from uvms_ocp.identification.prediction_text import (
    prediction_data,
    prediction_lines,
    shortfall_data,
    still_lines,
)
from uvms_ocp.identification.uncertainty import DETERMINED_BELOW, LEAST_P, LEVEL, IdentifiedNumber
from uvms_ocp.identification.validation import (
    OTHERS,
    SCORED,
    HeldOutRecording,
    HorizonPrediction,
    errors,
)
from uvms_ocp.robot.description import read_description

_OF_FILE = ("mass", "centre_of_mass", "second_moment", "dead_zone", "dead_zone_reverse")
IN_FILE = ("added_mass", "linear_drag", "quadratic_drag", "volume", "centre_of_buoyancy")
"""Quantities that a robot file holds."""

_STILL = 1e-3  # [m/s, rad/s] deviation below which a channel has no fit

_MOST_COMBINATIONS = 6  # combinations, the worst first
_DECADES = 1e3  # between the ends of an interval that is told of what is positive


# What has been learnt as a robot file: a variant, whose keys replace those of the robot's own, with
# the source of each number.
#
# A file holds coefficients of water. Mass and inertia are the URDF's, gains and delays the
# driver's: the report tells them.


def variant_text(calibration: Calibration, recordings: Sequence[str]) -> str:
    """Write the identified coefficients as a variant of the robot's file, in YAML. Raises
    InvalidInput, as `CalibratedRobot.coefficients`.
    """
    shape = settings.shape_of(calibration.subject.robot, calibration.subject.frame)
    lines = [f"# Identified from: {', '.join(recordings)}."]
    learnt = list(_lines(calibration, shape))
    if learnt:
        lines += [
            "links:",
            f"  {calibration.subject.frame}:",
            *([f"    {shape}: null"] if shape else []),
        ]
        lines += ["    coefficients:", *(f"      {line}" for line in learnt)]
    else:  # which is no file of ours without a key
        lines += ["# A robot file holds nothing of what was learnt: see the report.", "links: {}"]
    return "\n".join(lines) + "\n"


def whole_text(calibration: Calibration, variant: Path | str) -> str:
    """Write the robot's file with the entries of a variant in place of its own."""
    variant = Path(variant)
    described = read_description(calibration.subject.file, variant).model_dump(
        mode="json", exclude_unset=True, exclude_none=True
    )
    subject = calibration.subject
    head = (
        f"# Of {subject.file.name}, with identified coefficients of {subject.frame}: see"
        f" {variant.name}.\n"
    )
    return head + yaml.safe_dump(described, sort_keys=False, width=130)


def _lines(calibration: Calibration, shape: str) -> Iterator[str]:
    """Yield lines of the coefficients that were learnt; of all coefficients where they take the
    place of a shape.
    """
    values = _of_file(calibration)
    learnt = {number.quantity for number in calibration.numbers}
    if learnt & {"volume", "centre_of_buoyancy"}:
        learnt |= {
            "volume",
            "centre_of_buoyancy",
        }  # with floats beside the hull one follows from the other
    by_shape = set[str]()
    if shape:
        by_shape = set(IN_FILE) - learnt
    learnt &= set(IN_FILE)
    if learnt and shape:
        coefficients = calibration.subject.coefficients()
        yield f"pose: {{position: {_row(np.array(coefficients.pose.position))}}}"
        yield f"drag_by: {coefficients.drag_by}"
    if not learnt:
        return
    for name in IN_FILE:
        if name in learnt:
            yield f"# {_source(name, calibration)}"
            yield f"{name}: {_written(values[name])}"
        elif name in by_shape:
            yield f"# of its {shape}, as before"
            yield f"{name}: {_written(values[name])}"


def _of_file(calibration: Calibration) -> dict[str, np.ndarray]:
    """Convert to the file's numbers: those of the vehicle hold floats and ballast, those of its
    link do not.

    A file has the centre of buoyancy in the link's frame, an estimate in that of the coefficients.
    """
    before = calibration.subject.coefficients()
    origin = np.array(before.pose.position)
    quantities = calibration.subject.vehicle.shared.values(
        ca.SX(ca.DM(calibration.exported.estimate.shared))
    )
    identified = {
        name: np.asarray(ca.DM(value)) for name, value in quantities.items() if name in IN_FILE
    }
    start = calibration.subject.start
    volume = float(identified["volume"].item()) + before.volume - start.volume
    if before.centre_of_buoyancy is None:
        centre = np.zeros(3)
    else:
        centre = np.array(before.centre_of_buoyancy)
    floats = start.volume * (start.centre_of_buoyancy + origin) - before.volume * centre
    first = (
        float(identified["volume"].item()) * (identified["centre_of_buoyancy"].ravel() + origin)
        - floats
    )
    return {**identified, "volume": np.array(volume), "centre_of_buoyancy": first / volume}


def _source(name: str, calibration: Calibration) -> str:
    parts = [
        f"{number.entry or name} {_word(number, calibration)}"
        for number in calibration.numbers
        if number.quantity == name
    ]
    if parts:
        return "; ".join(parts) + "; the others as before"
    return "follows from the others: floats are apart"


def _word(number: IdentifiedNumber, calibration: Calibration) -> str:
    if number.name in calibration.exported.kept:
        return "not determined, as before"
    return f"{'identified' if number.determined else 'not determined'}, +-{number.sigma:.2g}"


def _written(value: np.ndarray) -> str:
    if value.size == 1:
        return f"{value.item():.6g}"
    if value.ndim == 1:
        return _row(value)
    if np.count_nonzero(value - np.diag(np.diag(value))):
        return "[" + ", ".join(_row(row) for row in value) + "]"
    return _row(np.diag(value))


def _row(values: np.ndarray) -> str:
    return "[" + ", ".join(f"{float(value):.6g}" for value in values) + "]"


# How well recordings are predicted, as tables: nothing is told without what predictors that know
# less make of it.


def fits(comparisons: Sequence[Comparison]) -> Iterator[str]:
    """Tabulate fits of the recordings that the search used."""
    yield report_prose.FITS
    yield "| recording | " + " | ".join((*parameters.AXES, "tilt")) + " |"
    yield "|---" * (2 + len(parameters.AXES)) + "|"
    for comparison in comparisons:
        columns = zip(
            *(
                _by_axis(prediction)
                for prediction in (comparison.calibrated, comparison.before, comparison.static)
            ),
            strict=True,
        )
        cells = [f"{after} ({before}; {still})" for after, before, still in columns]
        after, *others = (
            errors(prediction)[-1]
            for prediction in (
                comparison.calibrated,
                comparison.before,
                comparison.static,
                comparison.balance,
            )
        )
        yield (
            f"| {comparison.name} | {' | '.join(cells)} | {after:.2g}"
            f" ({'; '.join(f'{x:.2g}' for x in others)}) |"
        )
    yield ""
    yield from still_lines(
        [worse for comparison in comparisons for worse in comparison.worse_than_still]
    )


def _by_axis(predicted: fit.Predicted) -> list[str]:
    pairs = [
        (predicted.measured[k][:, i], predicted.rows[k][:, i]) for k in range(2) for i in range(3)
    ]
    return [f"{fit.fit_percent(*pair):.0f}" if np.std(pair[0]) > _STILL else "-" for pair in pairs]


def left_out_tables(
    recordings: Sequence[HeldOutRecording], heading: str = report_prose.LEFT_OUT
) -> Iterator[str]:
    """Tabulate predictions of held-out recordings, by horizons; nothing where none was predicted.

    heading: text before it.
    """
    if not recordings:
        return
    yield heading
    horizons = [horizon for recording in recordings for horizon in recording.horizons]
    for horizon_length in sorted({horizon.asked for horizon in horizons}):
        yield from _horizon(
            horizon_length, [horizon for horizon in horizons if horizon.asked == horizon_length]
        )
    yield from _by_recording(recordings)


def _horizon(length: float, predictions: Sequence[HorizonPrediction]) -> Iterator[str]:
    shortest = min(prediction.length for prediction in predictions)
    if shortest < length - 1e-6:
        yield f"\n### {length:g} s (recordings have {shortest:.3g} s)"
    else:
        yield f"\n### {length:g} s"
    yield "\n| predicted by | " + " | ".join(SCORED) + " |"
    yield "|---" + "|---:" * len(SCORED) + "|"
    rows = {
        name: np.median([errors(prediction.by[name]) for prediction in predictions], axis=0)
        for name in predictions[0].by
    }
    best = np.min([row for name, row in rows.items() if name != OTHERS], axis=0)
    for name, row in rows.items():
        worse = row > best if name == OTHERS else np.zeros(len(row), dtype=bool)
        yield f"| {name} | {' | '.join(_cell(*pair) for pair in zip(row, worse, strict=True))} |"


def _by_recording(recordings: Sequence[HeldOutRecording]) -> Iterator[str]:
    yield "\n### Each recording, over the longest horizon that it has\n"
    yield (
        "In brackets: the best that knows less, and by how much the prediction was expected to"
        " err.\n"
    )
    yield "| recording | " + " | ".join(SCORED) + " |"
    yield "|---" * (1 + len(SCORED)) + "|"
    for recording in recordings:
        if recording.horizons:
            yield f"| {recording.name} | {' | '.join(_beside(recording.horizons[-1]))} |"
    for recording in recordings:
        if not recording.horizons:
            yield (
                f"\n{recording.name}: the others determine too little to predict it (their search:"
                f" {recording.estimate.status.value})."
            )
        elif extrapolated := recording.horizons[-1].extrapolated:
            yield (
                f"\n{recording.name}: {', '.join(extrapolated)} rest on what the others do not"
                " determine: do not rely on them."
            )
        if recording.horizons and (less := recording.horizons[-1].uninformative):
            yield (
                f"\n{recording.name}: {', '.join(less)} move less than the prediction may err: it says"
                " nothing of them."
            )


def _beside(prediction: HorizonPrediction) -> Iterator[str]:
    errors_by_name = {name: errors(predicted) for name, predicted in prediction.by.items()}
    best = np.min([row for name, row in errors_by_name.items() if name != OTHERS], axis=0)
    for value, best_error, expected in zip(
        errors_by_name[OTHERS], best, prediction.expected_error, strict=True
    ):
        yield f"{_cell(value, value > best_error)} ({best_error:.2g}; {expected:.2g})"


def _cell(value: float, worse: bool) -> str:
    if worse:
        return f"**{value:.2g}**"
    return f"{value:.2g}"


# A calibration in words: numbers, how sure they are, what is not determined, and how well
# recordings are predicted.


def report_text(calibration: Calibration) -> str:
    """Write the report of a calibration as Markdown: numbers, intervals, what stays open,
    predictions, doubts.
    """
    parts = [
        "# Calibration",
        *_number_table(calibration),
        *_own(calibration),
        *_profiles(calibration),
        *_open(calibration),
        *_held(calibration),
        *_white(calibration),
    ]
    parts += fits(calibration.comparisons)
    parts += left_out_tables(calibration.left_out)
    parts += prediction_lines(calibration.left_out, calibration.left_out_bounds)
    parts += _disagreed(calibration)
    parts += left_out_tables(calibration.predicted, report_prose.PREDICTED)
    parts += prediction_lines(calibration.predicted, calibration.predicted_bounds)
    parts += ["", "## Doubts about the recordings", ""]
    return "\n".join([*parts, *(f"- {doubt}" for doubt in calibration.issues or ("none",))]) + "\n"


def report_data(calibration: Calibration) -> dict[str, Any]:
    """Return the numbers and verdicts of the report, for JSON; what is not finite is `None`."""
    data: dict[str, Any] = {
        "status": calibration.estimate.status.value,
        "advice": calibration.estimate.status.advice,
        "file_usable": calibration.exported.usable,
        "numbers": [_number_data(number) for number in calibration.numbers],
        "seen_worse_than_still": [
            shortfall_data(shortfall)
            for entry in calibration.comparisons
            for shortfall in entry.worse_than_still
        ],
        "doubts": list(calibration.issues),
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
    low, high = number.interval
    return {
        "name": number.name,
        "unit": number.unit,
        "value": number.value,
        "standard_error": number.sigma if np.isfinite(number.sigma) else None,
        "interval": [low if np.isfinite(low) else None, high if np.isfinite(high) else None],
        "determined": number.determined,
    }


def _number_table(calibration: Calibration) -> Iterator[str]:
    summary = {"status": calibration.estimate.status, "inflation": calibration.inflation}
    yield report_prose.NUMBERS.format(
        **summary, below=100 * DETERMINED_BELOW, most=uncertainty.MISSES
    )
    missed = [test.channel for test in calibration.whiteness if test.unexplained]
    if missed:
        yield report_prose.UNEXPLAINED.format(missed=", ".join(missed))
    if len(axes := calibration.subject.vehicle.axes) < len(parameters.AXES):
        yield report_prose.AXES.format(axes=", ".join(parameters.AXES[k] for k in axes))
    shape = settings.shape_of(calibration.subject.robot, calibration.subject.frame)
    if shape:
        yield report_prose.SHAPE.format(
            shape=shape, frame=calibration.subject.frame, **settings.SHAPE_SPREADS
        )
    yield report_prose.NUMBER_TABLE
    for number in calibration.numbers:
        columns = (
            f"{number.value:.4g} | {number.unit} | {number.sigma:.2g} | {_ends(number.interval)}"
        )
        yield (
            f"| {number.name} | {columns} | {'yes' if number.determined else 'no'} |"
            f" {_in_file(calibration, number)} |"
        )


def _own(calibration: Calibration) -> Iterator[str]:
    """Tabulate the numbers that each recording has for itself, such as its current; nothing where
    none are learnt.
    """
    unknowns = calibration.subject.vehicle.own
    if unknowns.names:
        units = [
            unknowns.declaration.quantities[name.partition(" ")[0]].unit for name in unknowns.names
        ]
        yield report_prose.OWN
        yield (
            "| recording | "
            + " | ".join(
                f"{name} [{unit}]" for name, unit in zip(unknowns.names, units, strict=True)
            )
            + " |"
        )
        yield "|---" + "|---:" * len(units) + "|"
        for name, values in calibration.estimate.own.items():
            yield f"| {name} | {' | '.join(f'{value:.3g}' for value in values)} |"


def _in_file(calibration: Calibration, number: IdentifiedNumber) -> str:
    if number.quantity not in IN_FILE or not calibration.exported.usable:
        return "no"
    if number.name in calibration.exported.kept:
        return "as before"
    return "yes"


def _profiles(calibration: Calibration) -> Iterator[str]:
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
    wide = interval[1] > _DECADES * abs(interval[0]) and interval[0] >= 0.0
    if np.isfinite(interval).all() and not wide:
        return f"{interval[0]:.4g} to {interval[1]:.4g}"
    return "open"


def _open(calibration: Calibration) -> Iterator[str]:
    yield "\n## Combinations that the recordings leave open\n"
    if not calibration.open:
        yield "None."
    for direction in calibration.open[:_MOST_COMBINATIONS]:
        shares = " ".join(f"{share:+.2f} {name}" for name, share in direction.shares)
        yield (
            f"- {shares}: standard error {min(direction.sigma, 1e3):.2g} without priors. To determine"
            f" it: {advice(direction)}."
        )


def _held(calibration: Calibration) -> Iterator[str]:
    yield report_prose.HELD
    effects = {constant.quantity: constant for constant in calibration.constants}
    for name, quantity in calibration.subject.vehicle.shared.declaration.quantities.items():
        if name not in IN_FILE and not quantity.free.any():
            values = np.round(quantity.value.ravel(), 5)
            if np.ptp(values) == 0.0:
                shown = f"{values.min():.4g}"
            else:
                shown = f"{values.min():.4g} to {values.max():.4g}"
            constant = effects.get(name)
            if name in _OF_FILE or not calibration.constants:
                origin = "robot's file"
            else:
                origin = "assumed"
            if constant:
                effect = (
                    f"{constant.known} | {constant.spread:g} | {constant.most} by"
                    f" {constant.change:.2g}"
                )
            else:
                effect = f"{origin} | - | -"
            yield f"| {name} | {shown} | {quantity.unit} | {effect} |"
    box = calibration.subject.vehicle.shared.declaration.quantities[
        "centre_of_buoyancy"
    ].coordinates
    if isinstance(box, coordinates.Interval):
        yield (
            f"| hull | {box.lower.min():.4g} to {box.upper.max():.4g} | m | given | - |"
            " centre_of_buoyancy at its ends |"
        )
    for effect_of_noise in effects.values():
        if effect_of_noise.unit:
            yield _noise_row(effect_of_noise)


def _noise_row(constant: HeldConstant) -> str:
    """Write the row of a constant with a unit of its own, such as the noise of a sensor."""
    return (
        f"| {constant.quantity} | {constant.value:g} | {constant.unit} | {constant.known} |"
        f" {constant.spread:g} | {constant.most} by {constant.change:.2g} |"
    )


def _white(calibration: Calibration) -> Iterator[str]:
    yield report_prose.WHITE.format(level=LEVEL)
    for test in calibration.whiteness:
        word = "yes" if test.white else "no"
        if test.p > LEAST_P:
            p = f"{test.p:.2g}"
        else:
            p = f"below {LEAST_P:g}"
        yield f"| {test.channel} | {test.size:.2g} | {test.inflation:.3g} | {p} | {word} |"


# A design in words: where it leads, and what one recording of it is expected to determine.


def excitation_text(excitation: experiment_design.Excitation, actuators: Sequence[str]) -> str:
    """Write the report of an excitation as Markdown. actuators: names, in the order of its
    commands.
    """
    return "\n".join(["# Excitation", "", *_course(excitation, actuators)]) + "\n"


def _course(excitation: experiment_design.Excitation, actuators: Sequence[str]) -> Iterator[str]:
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
        yield (
            f"| {number.name} | {number.value:.4g} | {number.unit} | {number.sigma:.2g} |"
            f" {'yes' if number.determined else 'no'} |"
        )
