"""The one table of series: what each is, its unit and frame, and which columns it has."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

_XYZ = ("x", "y", "z")
_VEHICLE_Q = (*_XYZ, "qx", "qy", "qz", "qw")
_VEHICLE_V = ("surge", "sway", "heave", "roll_rate", "pitch_rate", "yaw_rate")
_N_WRENCH = 6


@dataclass(frozen=True, kw_only=True, slots=True)
class SeriesKind:
    """Of one series of a record."""

    meaning: str
    shape: str
    """After the first axis, which is time."""
    unit: str
    frame: str = "-"
    """In which it is expressed."""


def _of(meaning: str, shape: str, unit: str, frame: str = "-") -> SeriesKind:
    return SeriesKind(meaning=meaning, shape=shape, unit=unit, frame=frame)


SERIES: Mapping[str, SeriesKind] = {
    "t": _of("time of the tick", "()", "s"),
    "q": _of("true configuration: position, quaternion xyzw, joints", "(n_q,)", "m, -, rad or m", "W"),
    "v": _of("true velocity: linear, angular, joints", "(n_v,)", "m/s, rad/s", "B"),
    "q_measured": _of("configuration as estimated", "(n_q,)", "m, -, rad or m", "W"),
    "v_measured": _of("velocity as estimated", "(n_v,)", "m/s, rad/s", "B"),
    "q_spread": _of("standard deviations of the estimate of q", "(n_v,)", "m, rad", "B"),
    "altimeter_range": _of("range of the altimeter as estimated", "()", "m"),
    "altimeter_spread": _of("standard deviation of that range", "()", "m"),
    "command": _of("velocity that is asked for", "(n_v,)", "m/s, rad/s", "B"),
    "health": _of("trust in every channel: 0 good, 1 suspect, 2 lost", "(n_channels,)", "-"),
    "controller_time": _of("time that the whole controller took", "()", "s"),
    "phase": _of("number of the phase", "()", "-"),
    "gates": _of("external activation of every task", "(n_tasks,)", "-"),
    "activity": _of("activation of every row of all levels", "(n_rows,)", "-"),
    "residual": _of("what every row of all levels misses", "(n_rows,)", "of the task's rate"),
    "quantities": _of("what the tasks measure, by name", "(n_quantities,)", "of the task"),
    "status": _of("outcome of the solver, as `meta.statuses`", "()", "-"),
    "viable_share": _of("share of the step that viability allows", "()", "-"),
    "solve_time": _of("time that the solver took", "()", "s"),
    "tick_time": _of("time that the layer of velocities took", "()", "s"),
    "freshness": _of("which measurements are fresh enough", "()", "-"),
    "disturbance": _of("generalized force that is not explained", "(n_v,)", "N, N m", "B"),
    "wrench": _of("generalized force asked of the thrusters", "(6,)", "N, N m", "B"),
    "unreachable": _of("part of it that they cannot give", "(6,)", "N, N m", "B"),
    "saturated": _of("whether any thruster is at its limit", "()", "-"),
    "thruster_share": _of("share of its thrust that each is believed to give", "(n_thrusters,)", "-"),
    "thruster_constant": _of("thrust that each is believed to add", "(n_thrusters,)", "N"),
    "thruster_health": _of("verdict on every thruster", "(n_thrusters,)", "-"),
    "joint_health": _of("verdict on every joint", "(n_joints,)", "-"),
    "thrust": _of("thrust of every thruster", "(n_thrusters,)", "N"),
    "torque": _of("effort of every joint", "(n_joints,)", "N m or N"),
    "contact": _of("force of the floor on every corner of the skid", "(n_points,)", "N", "W"),
    "current": _of("velocity of the water at the vehicle", "(3,)", "m/s", "W"),
    "thruster_energy": _of("electrical energy of every thruster so far", "(n_thrusters,)", "J"),
    "joint_energy": _of("electrical energy of all joints so far", "()", "J"),
    "x": _of("coordinates of a plan", "(n_x,)", "m, rad"),
    "x_rate": _of("their first derivative", "(n_x,)", "m/s, rad/s"),
    "x_acceleration": _of("their second derivative", "(n_x,)", "m/s2, rad/s2"),
    "x_jerk": _of("their third derivative", "(n_x,)", "m/s3, rad/s3"),
    "x_snap": _of("their fourth derivative", "(n_x,)", "m/s4, rad/s4"),
    "clearance": _of("distance of every pair of shapes", "(n_pairs,)", "m"),
}
"""By name. Controllers of one's own may record others."""


def column_names(name: str, width: int, meta: Any) -> list[str]:
    """Names of the columns of a series of that name with so many columns (width [-]); meta: of its record."""
    makers: Mapping[str, Callable[[Any], Sequence[str]]] = {
        **dict.fromkeys(("q", "q_measured"), lambda meta: (*_VEHICLE_Q, *meta.joints)),
        **dict.fromkeys(("v", "v_measured", "command", "q_spread", "disturbance"), _velocities),
        **dict.fromkeys(("wrench", "unreachable"), lambda meta: _VEHICLE_V),
        **dict.fromkeys(("torque", "joint_health"), lambda meta: meta.joints),
        "current": lambda meta: _XYZ,
        "gates": lambda meta: [task.name for task in meta.tasks],
        "health": lambda meta: getattr(meta, "channels", ()),
    }
    if name == "quantities":
        return list(meta.quantities)
    found = [*makers[name](meta)] if name in makers else []
    if len(found) != width:  # such as a fixed base, whose configuration is its joints
        found = [*meta.joints] if len(meta.joints) == width else [str(k + 1) for k in range(width)]
    return [f"{name}.{column}" for column in found]


def _velocities(meta: Any) -> Sequence[str]:
    return (*_VEHICLE_V, *meta.joints)
