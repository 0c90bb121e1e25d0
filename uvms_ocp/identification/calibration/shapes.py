"""What a shape of a robot file amounts to: coefficients can be learnt, shapes cannot."""

from __future__ import annotations

import numpy as np
import yaml

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.identification.calibration.subject import Subject
from uvms_ocp.model.files.description import LinkCoefficients, LinkDescription, Pose
from uvms_ocp.model.water.coefficients import links_in_water


def require_no_shape(subject: Subject) -> None:
    """Raises InvalidInput for a robot file that has a shape of the link, with the coefficients that may stand in its place."""
    description, frame = subject.robot.description, subject.frame
    link = description.links.get(frame)
    for name in ("box", "cylinder", "sphere") if link is not None else ():
        shape = getattr(link, name)
        if shape is None or description.convention != "FLU" or shape.pose != Pose():
            continue
        told = "give it coefficients in the link frame in place of its shape; the same are"
        raise InvalidInput(f"{frame}: {told} {same_coefficients(subject)} instead of {name}")


def same_coefficients(subject: Subject) -> str:
    """As they stand in a robot file, of the link's shape alone, without floats and ballast."""
    description, frame = subject.robot.description, subject.frame
    alone = description.model_copy(update={"links": {frame: description.links[frame]}, "trim": ()})
    (wet,) = links_in_water(alone)
    given = LinkCoefficients(
        added_mass=_row(wet.added_mass),
        linear_drag=_row(wet.linear_drag),
        quadratic_drag=_row(wet.quadratic_drag),
        volume=_rounded(wet.volume),
    )
    content = LinkDescription(coefficients=given).model_dump(mode="json", exclude_unset=True)
    return yaml.safe_dump(content, default_flow_style=True, sort_keys=False, width=10_000).strip()


def _row(values: np.ndarray) -> tuple[float, float, float, float, float, float]:
    a, b, c, d, e, f = map(_rounded, np.diag(values) if values.ndim == 2 else values)
    return a, b, c, d, e, f


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")
