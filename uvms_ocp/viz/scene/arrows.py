"""Arrows of what pushes the vehicle, in its own frame: thrust, contact with the floor, the current,
the disturbance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.record.record import Record
from uvms_ocp.robot import Robot, thruster_matrix
from uvms_ocp.robot.shapes import hull
from uvms_ocp.viz.scene import colours
from uvms_ocp.viz.scene.animation import Frames, rounded

_NEGLIGIBLE = 1e-6  # [N, N m, m/s] size below which, throughout, a quantity has no arrow
_USUAL = 80  # [%] of the time in which the largest arrow is shorter than its share
_LONGEST = 1.6  # length to which longer arrows are cut, in shares of the largest
Arrow = tuple[np.ndarray, np.ndarray]
"""Origin (3,) [m] of an arrow in B, and its vectors (n, 3) [its unit] in B."""
Draw = Callable[[np.ndarray, Robot, Frames, float], Iterator[Arrow]]
"""Function that yields arrows from a series at the frames, the robot, the frames, and the size of
the robot [m].
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class ArrowKind:
    """Quantity and look of a group of arrows."""

    label: str
    unit: str
    colour: str
    share: float
    """Usual length in sizes of the robot."""
    series: str
    draw: Draw
    """Function that places the arrows."""
    shown: bool = True
    """True where it is shown before anyone asks for it."""


def arrow_groups(record: Record, robot: Robot, frames: Frames, size: float) -> list[dict[str, Any]]:
    """Return JSON values, a group for each kind that the record has; size [m] of the robot, which
    lengths go by; peaks are cut.

    Of each arrow: the point ``at`` (3,) [m] in B where it begins, and ``vectors`` (n, 3) [unit of
    the group] in B at the frames.
    """
    if not robot.n_vehicle:
        return []
    groups = []
    for kind in _KINDS:
        if kind.series not in record.series:
            continue
        arrows = list(kind.draw(record[kind.series][frames.row], robot, frames, size))
        norms = np.array([np.linalg.norm(vectors, axis=1) for _, vectors in arrows])
        if norms.size and norms.max() > _NEGLIGIBLE:
            groups.append(_group(kind, arrows, norms, kind.share * size))
    return groups


def _group(
    kind: ArrowKind, arrows: list[Arrow], norms: np.ndarray, length: float
) -> dict[str, Any]:
    """Return the values of a group; norms (n_arrows, n) [its unit], length [m] of a usual one."""
    usual_norm = max(float(np.percentile(norms.max(axis=0), _USUAL)), _NEGLIGIBLE)
    return {
        "label": kind.label,
        "unit": kind.unit,
        "colour": kind.colour,
        "shown": kind.shown,
        "largest": float(norms.max()),
        "scale": length / usual_norm,
        "longest": length * _LONGEST,
        "arrows": [
            {"at": rounded(positions), "vectors": rounded(vectors)} for positions, vectors in arrows
        ],
    }


def _thrust(thrust: np.ndarray, robot: Robot, frames: Frames, size: float) -> Iterator[Arrow]:
    for thruster, direction, values in zip(
        robot.description.thrusters, thruster_matrix(robot)[:3].T, thrust.T, strict=False
    ):
        X_BF = robot.model.frames[robot.model.getFrameId(thruster.link)].placement
        yield X_BF.act(np.array(thruster.position)), np.outer(values, direction)


def _contact(pressing: np.ndarray, robot: Robot, frames: Frames, size: float) -> Iterator[Arrow]:
    up = _in_vehicle(np.tile([0.0, 0.0, 1.0], (len(pressing), 1)), frames)
    for point, values in zip(hull.skid_points(robot), pressing.T, strict=False):
        yield point, values[:, None] * up


def _current(velocity: np.ndarray, robot: Robot, frames: Frames, size: float) -> Iterator[Arrow]:
    yield np.array([0.0, 0.0, 0.75 * size]), _in_vehicle(velocity, frames)


def _disturbance(column: int, values: np.ndarray, *_: object) -> Iterator[Arrow]:
    """Yield the arrow of force or moment, whose columns begin at `column`."""
    yield np.zeros(3), values[:, column : column + 3]


def _in_vehicle(vectors: np.ndarray, frames: Frames) -> np.ndarray:
    """Return vectors (n, 3) in W, in the frame of the vehicle at each frame."""
    turns = (pin.XYZQUATToSE3(pose).rotation for pose in frames.placements[:, 1])
    return np.array([R_WB.T @ vector for R_WB, vector in zip(turns, vectors, strict=True)])


_KINDS = (
    ArrowKind(
        label="thrust",
        unit="N",
        colour=colours.ARROW_THRUST,
        share=0.55,
        series="thrust",
        draw=_thrust,
    ),
    ArrowKind(
        label="contact with the floor",
        unit="N",
        colour=colours.ARROW_CONTACT,
        share=0.5,
        series="contact",
        draw=_contact,
    ),
    ArrowKind(
        label="current",
        unit="m/s",
        colour=colours.ARROW_CURRENT,
        share=0.7,
        series="current",
        draw=_current,
    ),
    ArrowKind(
        label="disturbance, force",
        unit="N",
        colour=colours.ARROW_FORCE,
        share=0.8,
        series="disturbance",
        draw=partial(_disturbance, 0),
    ),
    ArrowKind(
        label="disturbance, moment",
        unit="N m",
        colour=colours.ARROW_MOMENT,
        share=0.6,
        series="disturbance",
        draw=partial(_disturbance, 3),
        shown=False,
    ),
)
"""Groups of arrows, in the order of the page."""
