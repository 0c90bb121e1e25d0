"""A made-up run with the structure of a real one: two phases, a vehicle that descends, an arm that
unfolds.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.record.meta_values import (
    AlarmMeta,
    LevelMeta,
    MarkerMeta,
    PhaseMeta,
    SurroundingsMeta,
    TaskMeta,
    ThresholdMeta,
)
from uvms_ocp.record.record import Record
from uvms_ocp.record.run_meta import RunMeta
from uvms_ocp.robot.robot import Robot

QUANTITIES = (
    "AT.misalignment",
    "LA.altitude",
    "PC.position_error",
    "PC.orientation_error",
    "T.position_error",
    "MP.posture_error",
)

SURROUNDINGS = SurroundingsMeta(
    floor_z=-40.0,
    markers=(
        MarkerMeta(name="target", position=(2.5, 1.0, -39.9)),
        MarkerMeta(name="way point", position=(1.5, 0.5, -38.0)),
    ),
)


def synthetic_record(
    robot: Robot, *, duration: float = 6.0, dt: float = 0.02, **meta: Any
) -> Record:
    """A smooth motion of `duration` [s] from the robot's neutral posture; `meta` adds to or
    replaces fields of `RunMeta`.
    """
    t = np.arange(round(duration / dt) + 1) * dt
    q, v = _motion(robot, t)
    phase = (t > 0.6 * duration).astype(int)
    series = {
        "t": t,
        "q": q,
        "q_estimated": q,
        "q_std": np.full((len(t), robot.n_v), 1e-3),
        "v": v,
        "command": v,
        "altimeter_range": np.linspace(4.0, 0.2, len(t)),
        "phase": phase,
        "activations": np.column_stack([1.0 - phase, phase, np.ones(len(t))]),
        "activity": np.column_stack(
            [np.ones((len(t), robot.n_v)), 1.0 - phase, 1.0 - phase, phase]
        ),
        "quantities": np.exp(
            -np.outer(t, np.arange(1, 1 + len(meta.get("quantities", QUANTITIES))))
        ),
        "status": np.zeros(len(t), dtype=int),
        "health": _health(t),
        "tick_time": 1e-4 * (1.5 + np.sin(7 * t)),
        **_efforts(robot, t),
    }
    return Record(series=series, meta=RunMeta(**{**_meta(robot), **meta}))


def _health(t: np.ndarray) -> np.ndarray:
    """One channel that is good throughout, one that is suspect, lost and suspect again."""
    codes = np.array([0, 1, 2, 1, 0], dtype=np.int8)[
        np.clip(5 * np.arange(len(t)) // max(len(t), 1), 0, 4)
    ]
    return np.column_stack([np.zeros_like(codes), codes])


def without(record: Record, *names: str, rows: slice = slice(None)) -> Record:
    """The record with quantities that are not known in some rows."""
    values = record["quantities"].copy()
    for name in names:
        values[rows, record.meta.quantities.index(name)] = np.nan
    return Record(series={**record.series, "quantities": values}, meta=record.meta)


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
    return np.array([pin.integrate(robot.model, start, rate * s) for s in t]), np.tile(
        rate, (len(t), 1)
    )


def _meta(robot: Robot) -> dict[str, Any]:
    tasks = {"PC": "vehicle pose", "T": "tool pose", "HA": "horizontal attitude"}
    rows = {"limits": robot.n_v, "PC": 2, "T": 1, "HA": 0}
    return {
        "scenario": "synthetic",
        "robot": robot.name,
        "thrusters": tuple(f"t{k + 1}" for k in range(robot.n_v)),
        "plant": "dynamic",
        "solver": "none",
        "floating": bool(robot.n_vehicle),
        "dt": 0.02,
        "completed": True,
        "phases": (PhaseMeta(name="A", title="way point"), PhaseMeta(name="B", title="tool frame")),
        "tasks": tuple(TaskMeta(name=name, label=label) for name, label in tasks.items()),
        "tool_task": "T",
        "levels": tuple(LevelMeta(name=name, rows=n) for name, n in rows.items()),
        "quantities": QUANTITIES,
        "thresholds": (ThresholdMeta(quantity="LA.altitude", limit=0.17, sign="<", phase="A"),),
        "joints": robot.joint_names,
        "channels": ("position", "altimeter_range"),
        "alarms": (
            AlarmMeta(t=1.2, text="altimeter_range suspect: the same value 4 times"),
            AlarmMeta(t=1.5, text="measurements are 0.60 s old: holding"),
            AlarmMeta(t=2.4, text="altimeter_range lost: the same value 4 times"),
        ),
        "surroundings": SURROUNDINGS,
    }
