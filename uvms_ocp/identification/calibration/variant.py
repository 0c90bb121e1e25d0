"""What has been learnt as a robot file: a variant, whose keys replace those of the robot's own, with the source of each number.

A file holds coefficients of water. Mass and inertia are the URDF's, gains and delays the driver's: the report tells them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import casadi as ca
import numpy as np
import yaml

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.identification.answers.numbers import Number
from uvms_ocp.identification.calibration.fitting import Calibration
from uvms_ocp.identification.calibration.shapes import require_no_shape
from uvms_ocp.identification.calibration.subject import Subject
from uvms_ocp.model.files.description import LinkCoefficients
from uvms_ocp.model.files.description_file import read_description

IN_FILE = ("added_mass", "linear_drag", "quadratic_drag", "volume", "centre_of_buoyancy")
"""Quantities that a robot file holds."""


def require_coefficients(subject: Subject) -> LinkCoefficients:
    """Those of the link that is calibrated, as the robot's file has them: what is learnt takes their places.

    Raises InvalidInput for a robot whose link has none of its own, as `require_no_shape` does for a shape, or a frame of theirs.
    """
    require_no_shape(subject)
    description, frame = subject.robot.description, subject.frame
    link = description.links.get(frame)
    found = None if link is None else link.coefficients
    if found is None or description.convention != "FLU" or found.pose != type(found.pose)():
        raise InvalidInput(f"{frame}: give it coefficients in the link frame, convention FLU, to have it calibrated")
    return found


def variant_text(one: Calibration, recordings: Sequence[str]) -> str:
    """The file. Raises InvalidInput, as `require_coefficients`."""
    lines, learnt = [f"# Identified from: {', '.join(recordings)}."], list(_lines(one))
    if not learnt:  # which is no file of ours without a key
        return (
            "\n".join([*lines, "# A robot file holds nothing of what was learnt: see the report.", "links: {}"]) + "\n"
        )
    lines += ["links:", f"  {one.subject.frame}:", "    coefficients:"]
    return "\n".join([*lines, *(f"      {line}" for line in learnt)]) + "\n"


def whole_text(one: Calibration, variant: Path) -> str:
    """The robot's file with what a variant says in its place."""
    described = read_description(one.subject.file, variant).model_dump(mode="json", exclude_unset=True)
    head = f"# Of {one.subject.file.name}, with identified coefficients of {one.subject.frame}: see {variant.name}.\n"
    return head + yaml.safe_dump(described, sort_keys=False, width=130)


def _lines(one: Calibration) -> Iterator[str]:
    values = _of_file(one)
    learnt = {number.quantity for number in one.numbers}
    if learnt & {"volume", "centre_of_buoyancy"}:
        learnt |= {"volume", "centre_of_buoyancy"}  # with floats beside the hull one follows from the other
    for name in IN_FILE:
        if name in learnt:
            yield f"# {_source(name, one)}"
            yield f"{name}: {_written(values[name])}"


def _of_file(one: Calibration) -> dict[str, np.ndarray]:
    """As the file has them: floats and ballast are in the vehicle's numbers, and not in those of its link."""
    before = require_coefficients(one.subject)
    found = one.subject.vehicle.shared.values(ca.SX(ca.DM(one.flown.estimate.shared)))
    now = {name: np.asarray(ca.DM(value)) for name, value in found.items() if name in IN_FILE}
    start = one.subject.start
    volume = float(now["volume"].item()) + before.volume - start.volume
    centre = np.zeros(3) if before.centre_of_buoyancy is None else np.array(before.centre_of_buoyancy)
    floats = start.volume * start.centre_of_buoyancy - before.volume * centre
    first = float(now["volume"].item()) * now["centre_of_buoyancy"].ravel() - floats
    return {**now, "volume": np.array(volume), "centre_of_buoyancy": first / volume}


def _source(name: str, one: Calibration) -> str:
    parts = [f"{each.entry or name} {_word(each, one)}" for each in one.numbers if each.quantity == name]
    return "; ".join(parts) + "; the others as before" if parts else "follows from the others: floats are apart"


def _word(number: Number, one: Calibration) -> str:
    if number.name in one.flown.kept:
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
