"""What no reading of a working sensor can be: not a number, of another size, from the future."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import Reading

_UNIT = 1e-3  # by which the norm of a quaternion may differ from 1, as in records


def shapes_of(robot: Robot) -> dict[str, tuple[int, ...]]:
    """The shape of the value of each channel that is an array."""
    return {
        "position": (3,),
        "attitude": (4,),
        "angular_velocity": (3,),
        "linear_velocity": (3,),
        "specific_force": (3,),
        "joint_positions": (len(robot.home),),
        "joint_velocities": (robot.n_joints,),
    }


def nonsense(name: str, reading: Reading[Any], shape: tuple[int, ...] | None) -> str | None:
    """Why the value or the time stamp means nothing; `None` where it may mean something. A range that is nan is no echo."""
    if not math.isfinite(reading.t):
        return f"a time stamp of {reading.t}"
    if shape is None:
        return _scalar(name, reading.value)
    value = np.asarray(reading.value)
    if value.shape != shape:
        return f"a value of shape {value.shape} in place of {shape}"
    if not np.isfinite(value).all():
        return "a value that is no number"
    if name == "attitude" and not abs(float(value @ value) - 1.0) <= 2 * _UNIT:
        return f"a quaternion of length {math.sqrt(float(value @ value)):.3g}"
    return None


def _scalar(name: str, value: Any) -> str | None:
    if np.ndim(value) != 0:
        return f"a value of shape {np.shape(value)} in place of a number"
    if name == "altimeter_range" and value < 0.0:
        return f"a range of {value:.3g} m"
    if math.isfinite(value) or (name == "altimeter_range" and math.isnan(value)):
        return None
    return "a value that is no number"


def mistimed(stamp: float, last: float, t: float, clock: float) -> str | None:
    """Why a time stamp [s] cannot be, after the `last` [s] one that was used and at time t [s]; clock [s] of grace."""
    if stamp > t + clock:
        return f"a time stamp {stamp - t:.3g} s in the future"
    if stamp < last:
        return f"a time stamp {last - stamp:.3g} s before that of the reading before"
    return None
