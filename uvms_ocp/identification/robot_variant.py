"""Write the robot file with the identified coefficients: a variant, whose keys replace those of the
robot's own, with the source of each number.

A file holds coefficients of water. Mass and inertia are the URDF's, gains and delays the driver's:
the report has them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import casadi as ca
import numpy as np
import yaml

from uvms_ocp.checks import checked
from uvms_ocp.identification.calibration import Calibration
from uvms_ocp.identification.calibration_robot import shape_of
from uvms_ocp.identification.identified_numbers import IdentifiedNumber
from uvms_ocp.robot.description import read_description

IN_FILE = ("added_mass", "linear_drag", "quadratic_drag", "volume", "centre_of_buoyancy")
"""Quantities that a robot file holds."""


@checked
def variant_text(calibration: Calibration, recordings: Sequence[str]) -> str:
    """Write the identified coefficients as a variant of the robot's file, in YAML. Raises
    InvalidInput, as `CalibratedRobot.coefficients`.
    """
    shape = shape_of(calibration.subject.robot, calibration.subject.frame)
    lines = [f"# Identified from: {', '.join(recordings)}."]
    coefficient_lines = list(_lines(calibration, shape))
    if coefficient_lines:
        lines.append("links:")
        lines.append(f"  {calibration.subject.frame}:")
        if shape:
            lines.append(f"    {shape}: null")
        lines.append("    coefficients:")
        lines.extend(f"      {line}" for line in coefficient_lines)
    else:  # which is no file of ours without a key
        lines.append("# A robot file holds nothing of what was learnt: see the report.")
        lines.append("links: {}")
    return "\n".join(lines) + "\n"


@checked
def whole_text(calibration: Calibration, variant: Path | str) -> str:
    """Write the robot's file with the entries of a variant in place of its own."""
    variant = Path(variant)
    subject = calibration.subject
    description = read_description(subject.file, variant)
    described = description.model_dump(mode="json", exclude_unset=True, exclude_none=True)
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
    buoyancy = {"volume", "centre_of_buoyancy"}
    if learnt & buoyancy:  # with floats beside the hull one follows from the other
        learnt |= buoyancy
    by_shape = set(IN_FILE) - learnt if shape else set[str]()
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
    shared = ca.SX(ca.DM(calibration.exported.estimate.shared))
    quantities = calibration.subject.vehicle.shared.values(shared)
    identified = {name: np.asarray(ca.DM(quantities[name])) for name in IN_FILE}
    start = calibration.subject.start
    identified_volume = float(identified["volume"].item())
    identified_centre = identified["centre_of_buoyancy"].ravel()
    volume = identified_volume + before.volume - start.volume
    if before.centre_of_buoyancy is None:
        centre_before = np.zeros(3)
    else:
        centre_before = np.array(before.centre_of_buoyancy)
    # [m4] volumes times their centres, in the link's frame
    floats = start.volume * (start.centre_of_buoyancy + origin) - before.volume * centre_before
    hull = identified_volume * (identified_centre + origin) - floats
    return {**identified, "volume": np.array(volume), "centre_of_buoyancy": hull / volume}


def _source(name: str, calibration: Calibration) -> str:
    """Say for each entry of a quantity where its number comes from."""
    parts = []
    for number in calibration.numbers:
        if number.quantity == name:
            parts.append(f"{number.entry or name} {_verdict(number, calibration)}")
    if parts:
        return "; ".join(parts) + "; the others as before"
    return "follows from the others: floats are apart"


def _verdict(number: IdentifiedNumber, calibration: Calibration) -> str:
    """Say how well a number is determined, and where its value is from."""
    if number.name in calibration.exported.kept:
        return "not determined, as before"
    if number.determined:
        return f"identified, +-{number.sigma:.2g}"
    return f"not determined, +-{number.sigma:.2g}, and as before it contradicts the recordings"


def _written(value: np.ndarray) -> str:
    """Write a number, a vector or a matrix as YAML; of a diagonal matrix its diagonal."""
    if value.size == 1:
        return f"{value.item():.6g}"
    if value.ndim == 1:
        return _row(value)
    if np.count_nonzero(value - np.diag(np.diag(value))):
        return "[" + ", ".join(_row(row) for row in value) + "]"
    return _row(np.diag(value))


def _row(values: np.ndarray) -> str:
    """Write a vector as YAML."""
    return "[" + ", ".join(f"{float(value):.6g}" for value in values) + "]"
