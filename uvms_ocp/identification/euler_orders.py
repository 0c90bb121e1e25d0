"""Orders in which the turns by roll, pitch and yaw follow each other: the same three angles are another
attitude in each.

A name such as ``rpy 3-1-2`` lists the axes of the turns: about z, then about the x axis that is turned
so, then about the y axis. Without an order it is 3-2-1, which most software has.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from uvms_ocp.identification.mounting_checks import estimated_mounting
from uvms_ocp.identification.recording import Recording
from uvms_ocp.identification.turning_checks import estimated_gyro_mounting
from uvms_ocp.robot.spatial import continuous_quaternions

AXES = {
    "rpy": (2, 1, 0),
    "rpy 3-1-2": (2, 0, 1),
    "rpy 2-3-1": (1, 2, 0),
    "rpy 2-1-3": (1, 0, 2),
    "rpy 1-3-2": (0, 2, 1),
    "rpy 1-2-3": (0, 1, 2),
}
"""Axes of the turns, one after the other, by formats of an attitude."""
_LEAST_LEFT = 0.0005  # share of the motion that is left unexplained by noise alone
_MOST_LEFT = 0.7  # share beyond which something else than an order is wrong
_MUCH_LESS = 0.5  # share of what is left unexplained, which is left with the right order
_LITTLE = 0.05  # share that is left unexplained with the right order, at most
_NO_MORE = 1.1  # factor by which it may grow for another channel
_MOTIONS = {
    "angular_velocity": "the turns by the gyro",
    "linear_velocity": "the way by the velocity",
}
"""What an attitude is compared with, by channels."""


def quaternions_of_angles(angles: np.ndarray, form: str) -> np.ndarray:
    """Convert roll, pitch and yaw (n, 3) [rad] in a format of `AXES` to quaternions (n, 4)."""
    from scipy.spatial.transform import Rotation

    axes = AXES[form]
    names = "".join("XYZ"[axis] for axis in axes)
    return np.asarray(Rotation.from_euler(names, angles[:, axes]).as_quat())


def of_order(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield an order of roll, pitch and yaw with which the attitude agrees much better with gyro and
    velocity than with 3-2-1.
    """
    if "attitude" not in recording.channels:
        return
    present = _unexplained(recording)
    if not present or not _LEAST_LEFT < max(present.values()) < _MOST_LEFT:
        return
    attitude = recording.channels["attitude"]
    angles = _angles(attitude.values)
    best_form = ""
    best = present
    for form in AXES:
        if form == "rpy":
            continue
        quaternions = continuous_quaternions(quaternions_of_angles(angles, form))
        channels = {**recording.channels, "attitude": replace(attitude, values=quaternions)}
        by_form = _unexplained(replace(recording, channels=channels))
        unexplained = {name: by_form.get(name, 1.0) for name in present}
        is_best = sum(unexplained.values()) < sum(best.values())
        if is_best and _is_better(unexplained, present):
            best_form = form
            best = unexplained
    if best_form:
        before = _percentages(present)
        after = _percentages(best)
        yield (
            "attitude",
            (
                f"reads better with format: {best_form}, were it of roll, pitch and yaw: it leaves"
                f" {after} unexplained in place of {before}"
            ),
        )


def _angles(quaternions: np.ndarray) -> np.ndarray:
    """Convert quaternions (n, 4) to roll, pitch and yaw (n, 3) [rad] in the order 3-2-1."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(quaternions).as_euler("xyz"))


def _unexplained(recording: Recording) -> dict[str, float]:
    """Compute the share of turns, and of displacements, that is left by the best mounting of gyro and
    sensor of velocity; a sensor of which no mounting is found, as of what does not move, is left
    out.
    """
    unexplained = {}
    if "angular_velocity" in recording.channels:
        gyro = estimated_gyro_mounting(recording)
        if gyro is not None:
            unexplained["angular_velocity"] = 1.0 - gyro.share
    if {"position", "linear_velocity"} <= recording.channels.keys():
        velocity = estimated_mounting(recording)
        if velocity is not None:
            unexplained["linear_velocity"] = 1.0 - velocity.share
    return unexplained


def _is_better(unexplained: dict[str, float], present: dict[str, float]) -> bool:
    """Check that much less is left of one channel, and little, and no more of the other."""
    is_well_explained = False
    for name, share in present.items():
        ratio = (unexplained[name] + _LEAST_LEFT / 4) / (share + _LEAST_LEFT / 4)
        if ratio > _NO_MORE:
            return False
        is_well_explained |= ratio < _MUCH_LESS and unexplained[name] < _LITTLE
    return is_well_explained


def _percentages(unexplained: dict[str, float]) -> str:
    """Write shares as percentages, with the motions that they are of."""
    return " and ".join(
        f"{100 * share:.2g} % of {_MOTIONS[name]}" for name, share in unexplained.items()
    )
