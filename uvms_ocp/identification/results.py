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
from uvms_ocp.identification.calibration import Calibration, Comparison
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


def variant_text(one: Calibration, recordings: Sequence[str]) -> str:
    """Write what was learnt as a variant of the robot's file, in YAML. Raises InvalidInput, as
    `CalibratedRobot.coefficients`.
    """
    shape = settings.shape_of(one.subject.robot, one.subject.frame)
    lines = [f"# Identified from: {', '.join(recordings)}."]
    learnt = list(_lines(one, shape))
    if learnt:
        lines += ["links:", f"  {one.subject.frame}:", *([f"    {shape}: null"] if shape else [])]
        lines += ["    coefficients:", *(f"      {line}" for line in learnt)]
    else:  # which is no file of ours without a key
        lines += ["# A robot file holds nothing of what was learnt: see the report.", "links: {}"]
    return "\n".join(lines) + "\n"


def whole_text(one: Calibration, variant: Path | str) -> str:
    """The robot's file with what a variant says in its place."""
    variant = Path(variant)
    described = read_description(one.subject.file, variant).model_dump(
        mode="json", exclude_unset=True, exclude_none=True
    )
    head = (
        f"# Of {one.subject.file.name}, with identified coefficients of {one.subject.frame}: see"
        f" {variant.name}.\n"
    )
    return head + yaml.safe_dump(described, sort_keys=False, width=130)


def _lines(one: Calibration, shape: str) -> Iterator[str]:
    """Lines of coefficients that were learnt; where they take the place of a shape of all that
    there are.
    """
    values = _of_file(one)
    learnt = {number.quantity for number in one.numbers}
    if learnt & {"volume", "centre_of_buoyancy"}:
        learnt |= {
            "volume",
            "centre_of_buoyancy",
        }  # with floats beside the hull one follows from the other
    learnt, by_shape = learnt & set(IN_FILE), set(IN_FILE) - learnt if shape else set[str]()
    if learnt and shape:
        yield f"pose: {{position: {_row(np.array(one.subject.coefficients().pose.position))}}}"
        yield f"drag_by: {one.subject.coefficients().drag_by}"
    for name in IN_FILE if learnt else ():
        if name in learnt | by_shape:
            yield f"# {_source(name, one) if name in learnt else f'of its {shape}, as before'}"
            yield f"{name}: {_written(values[name])}"


def _of_file(one: Calibration) -> dict[str, np.ndarray]:
    """Convert to the file's numbers: those of the vehicle hold floats and ballast, those of its
    link do not.

    A file has the centre of buoyancy in the link's frame, an estimate in that of the coefficients.
    """
    before = one.subject.coefficients()
    origin = np.array(before.pose.position)
    found = one.subject.vehicle.shared.values(ca.SX(ca.DM(one.exported.estimate.shared)))
    now = {name: np.asarray(ca.DM(value)) for name, value in found.items() if name in IN_FILE}
    start = one.subject.start
    volume = float(now["volume"].item()) + before.volume - start.volume
    if before.centre_of_buoyancy is None:
        centre = np.zeros(3)
    else:
        centre = np.array(before.centre_of_buoyancy)
    floats = start.volume * (start.centre_of_buoyancy + origin) - before.volume * centre
    first = float(now["volume"].item()) * (now["centre_of_buoyancy"].ravel() + origin) - floats
    return {**now, "volume": np.array(volume), "centre_of_buoyancy": first / volume}


def _source(name: str, one: Calibration) -> str:
    parts = [
        f"{each.entry or name} {_word(each, one)}" for each in one.numbers if each.quantity == name
    ]
    if parts:
        return "; ".join(parts) + "; the others as before"
    return "follows from the others: floats are apart"


def _word(number: IdentifiedNumber, one: Calibration) -> str:
    if number.name in one.exported.kept:
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
    """Table of fits of recordings that the search used."""
    yield report_prose.FITS
    yield "| recording | " + " | ".join((*parameters.AXES, "tilt")) + " |"
    yield "|---" * (2 + len(parameters.AXES)) + "|"
    for each in comparisons:
        columns = zip(
            *(_by_axis(one) for one in (each.calibrated, each.before, each.static)), strict=True
        )
        cells = [f"{after} ({before}; {still})" for after, before, still in columns]
        after, *others = (
            errors(one)[-1] for one in (each.calibrated, each.before, each.static, each.balance)
        )
        yield (
            f"| {each.name} | {' | '.join(cells)} | {after:.2g}"
            f" ({'; '.join(f'{x:.2g}' for x in others)}) |"
        )
    yield ""
    yield from still_lines([worse for each in comparisons for worse in each.worse_than_still])


def _by_axis(predicted: fit.Predicted) -> list[str]:
    pairs = [
        (predicted.measured[k][:, i], predicted.rows[k][:, i]) for k in range(2) for i in range(3)
    ]
    return [f"{fit.fit_percent(*pair):.0f}" if np.std(pair[0]) > _STILL else "-" for pair in pairs]


def left_out_tables(
    recordings: Sequence[HeldOutRecording], heading: str = report_prose.LEFT_OUT
) -> Iterator[str]:
    """Table of predictions of held-out recordings, by horizons; nothing where none was predicted.

    heading: text before it.
    """
    if not recordings:
        return
    yield heading
    horizons = [horizon for recording in recordings for horizon in recording.horizons]
    for asked in sorted({horizon.asked for horizon in horizons}):
        yield from _horizon(asked, [horizon for horizon in horizons if horizon.asked == asked])
    yield from _by_recording(recordings)


def _horizon(asked: float, found: Sequence[HorizonPrediction]) -> Iterator[str]:
    short = min(each.length for each in found)
    yield f"\n### {asked:g} s" + (
        f" (recordings have {short:.3g} s)" if short < asked - 1e-6 else ""
    )
    yield "\n| predicted by | " + " | ".join(SCORED) + " |"
    yield "|---" + "|---:" * len(SCORED) + "|"
    rows = {
        name: np.median([errors(each.by[name]) for each in found], axis=0) for name in found[0].by
    }
    best = np.min([row for name, row in rows.items() if name != OTHERS], axis=0)
    for name, row in rows.items():
        worse = (row > best) & (name == OTHERS)
        yield f"| {name} | {' | '.join(_cell(*pair) for pair in zip(row, worse, strict=True))} |"


def _by_recording(one: Sequence[HeldOutRecording]) -> Iterator[str]:
    yield "\n### Each recording, over the longest horizon that it has\n"
    yield (
        "In brackets: the best that knows less, and by how much the prediction was expected to"
        " err.\n"
    )
    yield "| recording | " + " | ".join(SCORED) + " |"
    yield "|---" * (1 + len(SCORED)) + "|"
    for each in one:
        if each.horizons:
            yield f"| {each.name} | {' | '.join(_beside(each.horizons[-1]))} |"
    for each in one:
        if not each.horizons:
            yield (
                f"\n{each.name}: the others determine too little to predict it (their search:"
                f" {each.estimate.status.value})."
            )
        elif extrapolated := each.horizons[-1].extrapolated:
            yield (
                f"\n{each.name}: {', '.join(extrapolated)} rest on what the others do not"
                " determine: do not rely on them."
            )
        if each.horizons and (less := each.horizons[-1].uninformative):
            yield (
                f"\n{each.name}: {', '.join(less)} move less than the prediction may err: it says"
                " nothing of them."
            )


def _beside(one: HorizonPrediction) -> Iterator[str]:
    found = {name: errors(predicted) for name, predicted in one.by.items()}
    best = np.min([row for name, row in found.items() if name != OTHERS], axis=0)
    for value, other, expected in zip(found[OTHERS], best, one.expected_error, strict=True):
        yield f"{_cell(value, value > other)} ({other:.2g}; {expected:.2g})"


def _cell(value: float, worse: bool) -> str:
    if worse:
        return f"**{value:.2g}**"
    return f"{value:.2g}"


# A calibration in words: numbers, how sure they are, what is not determined, and how well
# recordings are predicted.


def report_text(one: Calibration) -> str:
    """Write the report of a calibration as Markdown: numbers, intervals, what stays open,
    predictions, doubts.
    """
    parts = [
        "# Calibration",
        *_number_table(one),
        *_own(one),
        *_profiles(one),
        *_open(one),
        *_held(one),
        *_white(one),
    ]
    parts += fits(one.comparisons)
    parts += left_out_tables(one.left_out)
    parts += prediction_lines(one.left_out, one.left_out_bounds)
    parts += _disagreed(one)
    parts += left_out_tables(one.predicted, report_prose.PREDICTED)
    parts += prediction_lines(one.predicted, one.predicted_bounds)
    parts += ["", "## Doubts about the recordings", ""]
    return "\n".join([*parts, *(f"- {doubt}" for doubt in one.issues or ("none",))]) + "\n"


def report_data(one: Calibration) -> dict[str, Any]:
    """The numbers and verdicts of the report, for JSON; what is not finite is `None`."""
    data: dict[str, Any] = {
        "status": one.estimate.status.value,
        "advice": one.estimate.status.advice,
        "file_usable": one.exported.usable,
        "numbers": [_number_data(number) for number in one.numbers],
        "seen_worse_than_still": [
            shortfall_data(shortfall)
            for each in one.comparisons
            for shortfall in each.worse_than_still
        ],
        "doubts": list(one.issues),
    }
    if one.left_out:
        data["left_out"] = prediction_data(one.left_out, one.left_out_bounds)
        data["numbers_disagreed_on"] = [
            {"name": each.number.name, "scatter": each.scatter, "sentence": str(each)}
            for each in one.disagreed
        ]
    if one.predicted:
        data["predicted"] = prediction_data(one.predicted, one.predicted_bounds)
    return data


def _disagreed(one: Calibration) -> Iterator[str]:
    """Numbers called determined that move by more than that where a recording is left out."""
    if not one.left_out:
        return
    yield report_prose.DISAGREED
    disagreed = one.disagreed
    if not disagreed:
        yield "None."
    for each in disagreed:
        yield f"- {each}"


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


def _number_table(one: Calibration) -> Iterator[str]:
    known = {"status": one.estimate.status, "inflation": one.inflation}
    yield report_prose.NUMBERS.format(
        **known, below=100 * DETERMINED_BELOW, most=uncertainty.MISSES
    )
    missed = [each.channel for each in one.whiteness if each.unexplained]
    if missed:
        yield report_prose.UNEXPLAINED.format(missed=", ".join(missed))
    if len(axes := one.subject.vehicle.axes) < len(parameters.AXES):
        yield report_prose.AXES.format(axes=", ".join(parameters.AXES[k] for k in axes))
    shape = settings.shape_of(one.subject.robot, one.subject.frame)
    if shape:
        yield report_prose.SHAPE.format(
            shape=shape, frame=one.subject.frame, **settings.SHAPE_SPREADS
        )
    yield report_prose.NUMBER_TABLE
    for each in one.numbers:
        columns = f"{each.value:.4g} | {each.unit} | {each.sigma:.2g} | {_ends(each.interval)}"
        yield (
            f"| {each.name} | {columns} | {'yes' if each.determined else 'no'} |"
            f" {_in_file(one, each)} |"
        )


def _own(one: Calibration) -> Iterator[str]:
    """Tabulate the numbers that each recording has for itself, such as its current; nothing where
    none are learnt.
    """
    own = one.subject.vehicle.own
    if own.names:
        units = [own.declaration.quantities[name.partition(" ")[0]].unit for name in own.names]
        yield report_prose.OWN
        yield (
            "| recording | "
            + " | ".join(f"{name} [{unit}]" for name, unit in zip(own.names, units, strict=True))
            + " |"
        )
        yield "|---" + "|---:" * len(units) + "|"
        for name, values in one.estimate.own.items():
            yield f"| {name} | {' | '.join(f'{value:.3g}' for value in values)} |"


def _in_file(one: Calibration, each: IdentifiedNumber) -> str:
    if each.quantity not in IN_FILE or not one.exported.usable:
        return "no"
    if each.name in one.exported.kept:
        return "as before"
    return "yes"


def _profiles(one: Calibration) -> Iterator[str]:
    if not one.profiles:
        return
    yield report_prose.PROFILES
    for each in one.profiles:
        number = each.number
        word = "differs" if each.differs else ""
        yield (
            f"| {number.name} | {number.unit} | {_ends(number.interval)} | {_ends(each.interval)} |"
            f" {word} |"
        )


def _ends(interval: tuple[float, float]) -> str:
    wide = interval[1] > _DECADES * abs(interval[0]) and interval[0] >= 0.0
    if np.isfinite(interval).all() and not wide:
        return f"{interval[0]:.4g} to {interval[1]:.4g}"
    return "open"


def _open(one: Calibration) -> Iterator[str]:
    yield "\n## Combinations that the recordings leave open\n"
    if not one.open:
        yield "None."
    for each in one.open[:_MOST_COMBINATIONS]:
        shares = " ".join(f"{share:+.2f} {name}" for name, share in each.shares)
        yield (
            f"- {shares}: standard error {min(each.sigma, 1e3):.2g} without priors. To determine"
            f" it: {advice(each)}."
        )


def _held(one: Calibration) -> Iterator[str]:
    yield report_prose.HELD
    effects = {each.quantity: each for each in one.constants}
    for name, each in one.subject.vehicle.shared.declaration.quantities.items():
        if name not in IN_FILE and not each.free.any():
            values = np.round(each.value.ravel(), 5)
            if np.ptp(values) == 0.0:
                shown = f"{values.min():.4g}"
            else:
                shown = f"{values.min():.4g} to {values.max():.4g}"
            of = effects.get(name)
            if name in _OF_FILE or not one.constants:
                other = "robot's file"
            else:
                other = "assumed"
            if of:
                effect = f"{of.known} | {of.spread:g} | {of.most} by {of.change:.2g}"
            else:
                effect = f"{other} | - | -"
            yield f"| {name} | {shown} | {each.unit} | {effect} |"
    box = one.subject.vehicle.shared.declaration.quantities["centre_of_buoyancy"].coordinates
    if isinstance(box, coordinates.Interval):
        yield (
            f"| hull | {box.lower.min():.4g} to {box.upper.max():.4g} | m | given | - |"
            " centre_of_buoyancy at its ends |"
        )
    for of in (effects[name] for name in effects if effects[name].unit):
        yield (
            f"| {of.quantity} | {of.value:g} | {of.unit} | {of.known} | {of.spread:g} | {of.most}"
            f" by {of.change:.2g} |"
        )


def _white(one: Calibration) -> Iterator[str]:
    yield report_prose.WHITE.format(level=LEVEL)
    for each in one.whiteness:
        word = "yes" if each.white else "no"
        if each.p > LEAST_P:
            p = f"{each.p:.2g}"
        else:
            p = f"below {LEAST_P:g}"
        yield f"| {each.channel} | {each.size:.2g} | {each.inflation:.3g} | {p} | {word} |"


# A design in words: where it leads, and what one recording of it is expected to determine.


def excitation_text(one: experiment_design.Excitation, actuators: Sequence[str]) -> str:
    """Write the report of an excitation as Markdown. actuators: names, in the order of its
    commands.
    """
    return "\n".join(["# Excitation", "", *_course(one, actuators)]) + "\n"


def _course(one: experiment_design.Excitation, actuators: Sequence[str]) -> Iterator[str]:
    spans = [f"{low:+.2f} to {high:+.2f}" for low, high in one.swept.T]
    step = float(one.commands.t[1] - one.commands.t[0])
    tilt = 2.0 * np.arcsin(np.hypot(*one.states[:, 3:5].T).max())
    yield f"{one.status.value}: {one.status.advice}\n"
    yield (
        f"Commands last {step * len(one.commands.t):.4g} s, held for {step:.4g} s each, of"
        f" {', '.join(actuators)}.\n"
    )
    yield report_prose.EXCITATION.format(spans=", ".join(spans), tilt=tilt)
    for each in one.numbers:
        yield (
            f"| {each.name} | {each.value:.4g} | {each.unit} | {each.sigma:.2g} |"
            f" {'yes' if each.determined else 'no'} |"
        )
