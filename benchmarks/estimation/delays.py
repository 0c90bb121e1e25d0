"""What late readings cost: errors with a delay over those without, of the same truths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from estimation.consistency import DELAYS, error_of, late
from estimation.drawn import Watched
from uvms_ocp.estimation.filter_memory import Part
from uvms_ocp.estimation.tuning import EstimatorTuning
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import ACCELEROMETER, SensorSpecs

WITH = SensorSpecs(specific_force=ACCELEROMETER)
WITHOUT = SensorSpecs()
"""The usual sensors, with and without an accelerometer."""
CASES: Mapping[str, Mapping[str, float]] = {
    "none": {},
    **{name: {name: delay} for name, delay in DELAYS.items()},
    "all": DELAYS,
}
"""Delays [s] by channel: each alone, and all at once."""
LEVEL = EstimatorTuning(angular_jerk=0.003, jerk=0.02, floor_roughness=0.02)
"""Motions of up to 1 m/s above a level floor: how a rough one goes on since a late echo nobody can
know.
"""
SETTLED = 8.0
"""[s] after which errors count: a fix a second and a half late has to come a few times first."""
OF = ("position", "attitude", "altitude", "velocity", "rates", "joint_rates")


def rms_errors(
    robot: Robot, specs: SensorSpecs, *, seeds: Sequence[int], duration: float
) -> dict[str, float]:
    """Root mean square errors [m, rad, m, m/s, rad/s, rad/s] of `OF`, after the filter has
    settled.
    """
    squares: dict[str, list[float]] = {name: [] for name in OF}
    for seed in seeds:
        run = Watched(robot, specs, LEVEL, seed=seed)
        for _ in range(round(duration / run.truth.dt)):
            run.tick()
            if run.t >= SETTLED:
                for name, squared in _squares(run).items():
                    squares[name].append(squared)
    return {name: float(np.sqrt(np.nanmean(values))) for name, values in squares.items()}


def _squares(run: Watched) -> dict[str, float]:
    error = error_of(run)
    memory = run.estimator.memory
    truth = run.truth
    parts = {
        "position": Part.PLACE,
        "attitude": Part.TURN,
        "velocity": Part.SPEED,
        "rates": Part.SPIN,
    }
    squares = {}
    for name, first in parts.items():
        squares[name] = float(np.mean(error[first : first + 3] ** 2))
    squares["joint_rates"] = float(np.mean((memory.joint_x[:, 1] - truth.joints[1]) ** 2))
    altitude = truth.place[0, 2] + truth.R[2] @ memory.beam_at - truth.floor.z
    true_range = altitude / (truth.R[2] @ memory.beam_up)
    squares["altitude"] = float((memory.range[0] - true_range) ** 2)
    return squares


def delay_table(
    robot: Robot, specs: SensorSpecs, *, seeds: Sequence[int], duration: float
) -> list[dict[str, object]]:
    """One row per case of `CASES`: errors over those without a delay; without one, the errors
    themselves in SI units.
    """
    rows: list[dict[str, object]] = []
    exact: dict[str, float] = {}
    for case, delays in CASES.items():
        errors = rms_errors(robot, late(specs, delays), seeds=seeds, duration=duration)
        row = {"late": case, "accelerometer": specs.specific_force is not None}
        if case == "none":
            exact = errors
            rows.append({**row, **errors})
        else:
            rows.append({**row, **{name: errors[name] / exact[name] for name in OF}})
    return rows
