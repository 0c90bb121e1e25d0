"""A made-up run with the structure of a real one: two phases, a vehicle that descends, an arm that unfolds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.model.robot import Robot
from uvms_ocp.record import Record

QUANTITIES = ("AT.misalignment", "LA.altitude", "PC.position_error", "PC.orientation_error", "T.position_error")


def synthetic_record(robot: Robot, *, duration: float = 6.0, dt: float = 0.02, **meta: Any) -> Record:
    """A smooth motion of `duration` [s] from the robot's neutral posture; `meta` adds to or replaces entries."""
    t = np.arange(round(duration / dt) + 1) * dt
    q, v = _motion(robot, t)
    phase = (t > 0.6 * duration).astype(int)
    series = {
        "t": t,
        "q": q,
        "v": v,
        "command": v,
        "altimeter_range": np.linspace(4.0, 0.2, len(t)),
        "phase": phase,
        "gates": np.column_stack([1.0 - phase, phase, np.ones(len(t))]),
        "activity": np.column_stack([np.ones((len(t), robot.n_v)), 1.0 - phase, 1.0 - phase, phase]),
        "quantities": np.exp(-np.outer(t, np.arange(1, 1 + len(QUANTITIES)))),
        "status": np.zeros(len(t), dtype=int),
        "tick_time": 1e-4 * (1.5 + np.sin(7 * t)),
        **_efforts(robot, t),
    }
    return Record(series=series, meta={**_meta(robot), **meta})


def _efforts(robot: Robot, t: np.ndarray) -> dict[str, np.ndarray]:
    """What the physical plant and the dynamic layer add."""
    wave = np.sin(np.outer(t, np.arange(1, robot.n_v + 1)))
    return {
        "thrust": 30.0 * wave,
        "torque": 5.0 * wave[:, robot.joint_v],
        "thruster_energy": np.cumsum(wave**2, axis=0),
        "joint_energy": np.cumsum(wave[:, 0] ** 2),
        "disturbance": wave,
    }


def _motion(robot: Robot, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    start = robot.configuration(position=(0, 0, -36)) if robot.n_vehicle else robot.home
    rate = np.zeros(robot.n_v)
    rate[robot.joint_v] = 0.05
    rate[robot.vehicle_v] = (0.3, 0.1, -0.4, 0.0, 0.0, 0.15)[: robot.n_vehicle]
    return np.array([pin.integrate(robot.model, start, rate * s) for s in t]), np.tile(rate, (len(t), 1))


def _meta(robot: Robot) -> dict[str, Any]:
    return {
        "scenario": "synthetic",
        "robot": robot.name,
        "completed": True,
        "events": [],
        "phases": [{"name": "A", "title": "way point"}, {"name": "B", "title": "tool frame"}],
        "tasks": [
            {"name": "PC", "label": "vehicle pose"},
            {"name": "T", "label": "tool pose"},
            {"name": "HA", "label": "horizontal attitude"},
        ],
        "tool_task": "T",
        "levels": [
            {"name": "limits", "rows": robot.n_v},
            {"name": "PC", "rows": 2},
            {"name": "T", "rows": 1},
            {"name": "HA", "rows": 0},
        ],
        "quantities": list(QUANTITIES),
        "thresholds": [{"quantity": "LA.altitude", "limit": 0.17, "phase": "A"}],
        "joints": list(robot.joint_names),
        "floor_z": -40.0,
        "markers": {"target": [2.5, 1.0, -39.9], "way point": [1.5, 0.5, -38.0]},
    }
