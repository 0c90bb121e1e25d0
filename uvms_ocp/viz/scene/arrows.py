"""Arrows of what pushes the vehicle, in its own frame: thrust, contact with the floor, the current, the disturbance."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.model.robot import Robot
from uvms_ocp.model.thrusters import thruster_matrix
from uvms_ocp.record import Record
from uvms_ocp.sim.contact import skid_points
from uvms_ocp.viz.scene.animation import Frames, rounded

_LEAST = 1e-6  # [N, N m, m/s] nothing that is smaller throughout has an arrow
_USUAL, _MOST = 80, 1.6  # [%] of the time the largest is shorter than its share; how much longer than that any is drawn
Arrow = tuple[np.ndarray, np.ndarray]
"""Where it begins (3,) [m] in B, and its vectors (n, 3) [its unit] in B."""
Draw = Callable[[np.ndarray, Robot, Frames, float], Iterator[Arrow]]
"""Takes the series at the frames, and the size of the robot."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ArrowKind:
    """What a group of arrows is of, and how it looks."""

    label: str
    unit: str
    colour: str
    share: float
    """[-] usual length in sizes of the robot."""
    series: str
    draw: Draw
    """Places the arrows."""
    shown: bool = True
    """Before anyone asks for it."""


def arrow_groups(record: Record, robot: Robot, frames: Frames, size: float) -> list[dict[str, Any]]:
    """JSON values, a group for each kind that the record has; size [m] of the robot, which lengths go by; peaks are cut.

    Of each arrow: the point ``at`` (3,) [m] in B where it begins, and ``vectors`` (n, 3) [unit of the group] in B at the frames.
    """
    kinds = [kind for kind in _KINDS if kind.series in record.series and robot.n_vehicle]
    drawn = [(kind, list(kind.draw(record[kind.series][frames.row], robot, frames, size))) for kind in kinds]
    norms = [np.array([np.linalg.norm(vectors, axis=1) for _, vectors in arrows]) for _, arrows in drawn]
    return [
        _group(kind, arrows, norm, kind.share * size)
        for (kind, arrows), norm in zip(drawn, norms, strict=True)
        if norm.size and norm.max() > _LEAST
    ]


def _group(kind: ArrowKind, arrows: list[Arrow], norms: np.ndarray, length: float) -> dict[str, Any]:
    """The values of a group; norms (n_arrows, n) [its unit], length [m] of a usual one."""
    usual = max(float(np.percentile(norms.max(axis=0), _USUAL)), _LEAST)
    return {
        "label": kind.label,
        "unit": kind.unit,
        "colour": kind.colour,
        "shown": kind.shown,
        "largest": float(norms.max()),
        "scale": length / usual,
        "longest": length * _MOST,
        "arrows": [_told(*arrow) for arrow in arrows],
    }


def _told(at: np.ndarray, vectors: np.ndarray) -> dict[str, Any]:
    return {"at": rounded(at), "vectors": rounded(vectors)}


def _thrust(thrust: np.ndarray, robot: Robot, frames: Frames, size: float) -> Iterator[Arrow]:
    for thruster, direction, values in zip(
        robot.description.thrusters, thruster_matrix(robot)[:3].T, thrust.T, strict=False
    ):
        X_BF = robot.model.frames[robot.model.getFrameId(thruster.link)].placement
        yield X_BF.act(np.array(thruster.position)), np.outer(values, direction)


def _contact(pressing: np.ndarray, robot: Robot, frames: Frames, size: float) -> Iterator[Arrow]:
    up = _in_vehicle(np.tile([0.0, 0.0, 1.0], (len(pressing), 1)), frames)
    for point, values in zip(skid_points(robot), pressing.T, strict=False):
        yield point, values[:, None] * up


def _current(velocity: np.ndarray, robot: Robot, frames: Frames, size: float) -> Iterator[Arrow]:
    yield np.array([0.0, 0.0, 0.75 * size]), _in_vehicle(velocity, frames)


def _force(disturbance: np.ndarray, robot: Robot, frames: Frames, size: float) -> Iterator[Arrow]:
    yield np.zeros(3), disturbance[:, :3]


def _moment(disturbance: np.ndarray, robot: Robot, frames: Frames, size: float) -> Iterator[Arrow]:
    yield np.zeros(3), disturbance[:, 3:6]


def _in_vehicle(vectors: np.ndarray, frames: Frames) -> np.ndarray:
    """Vectors (n, 3) in W, in the frame of the vehicle at each frame."""
    turns = (pin.XYZQUATToSE3(pose).rotation for pose in frames.placements[:, 1])
    return np.array([R_WB.T @ vector for R_WB, vector in zip(turns, vectors, strict=True)])


_KINDS = (
    ArrowKind(label="thrust", unit="N", colour="#b8f23c", share=0.55, series="thrust", draw=_thrust),
    ArrowKind(label="contact with the floor", unit="N", colour="#ff6b5e", share=0.5, series="contact", draw=_contact),
    ArrowKind(label="current", unit="m/s", colour="#63e6ff", share=0.7, series="current", draw=_current),
    ArrowKind(label="disturbance, force", unit="N", colour="#ff7ad9", share=0.8, series="disturbance", draw=_force),
    ArrowKind(
        label="disturbance, moment",
        unit="N m",
        colour="#c9a0ff",
        share=0.6,
        series="disturbance",
        draw=_moment,
        shown=False,
    ),
)
