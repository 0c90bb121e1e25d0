"""Runs of receding conflicts on the dynamic plant, with strict levels and with weights."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np
from recording.report import Row

from horizon.following import CURRENT, DT, GUSTS, PERIOD, STRICT, deadlines, tool_position
from horizon.receding_conflicts import CONFLICTS, SETTLING, RecedingConflict
from uvms_ocp.control.force.computed_torque import TrackingGains
from uvms_ocp.control.nmpc import Nmpc
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import StateEstimate
from uvms_ocp.sim.currents import GustyCurrent, UniformCurrent
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import FlatSeafloor

LEVELS = "levels"
GAINS = TrackingGains(vehicle_stiffness=4.0, vehicle_damping=4.0, lead=8.0)
"""A vehicle that is to stay within millimetres in gusts needs thrusters faster than by default,
whose lag plans do not know.
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class ConflictRuns:
    """How much is run."""

    seeds: tuple[int, ...] = tuple(range(1, 11))
    weights: tuple[float, ...] = (10.0, 100.0)
    """of a level's terms against those of the next, in one level."""
    only: tuple[str, ...] = ()
    """Names of conflicts; all by default."""
    seconds: float = np.inf
    """[s] at most, of each run."""


def conflict_rows(runs: ConflictRuns) -> Iterator[Row]:
    """One row per conflict, seed and way to rank its goals."""
    robot = load_robot("girona_maris7_full")
    for make in CONFLICTS:
        conflict = make(robot)
        if runs.only and conflict.name not in runs.only:
            continue
        problems = {LEVELS: conflict.problem}
        for weight in runs.weights:
            problems[f"weights, {weight:g}"] = conflict.as_sum(weight)
        for seed in runs.seeds:
            for name, problem in problems.items():
                nmpc = Nmpc(
                    problem, dt=DT, period=PERIOD, clock=process_time, options=STRICT, gains=GAINS
                )
                errors = conflict_run(conflict, nmpc, seed, min(runs.seconds, conflict.seconds))
                yield {
                    "conflict": conflict.name,
                    "priorities": name,
                    "seed": seed,
                    **errors,
                    **deadlines(nmpc),
                }


def conflict_run(
    conflict: RecedingConflict, nmpc: Nmpc, seed: int, seconds: float
) -> dict[str, Any]:
    """Errors [mm] of tool and vehicle, smallest distance [mm] from what closes in, energy [J]."""
    robot = conflict.problem.robot
    q = conflict.problem.start.q
    water = GustyCurrent(base=UniformCurrent(CURRENT), sigma=GUSTS, seed=seed)
    environment = Environment(seafloor=FlatSeafloor(z=-40), current=water)
    plant = DynamicPlant(robot, q, dynamics=robot_dynamics(robot), environment=environment)
    tool = []
    vehicle = []
    gaps = []
    for i in range(round(seconds / DT)):
        estimate = StateEstimate(q=plant.state.q, v=plant.state.v, altimeter_range=30.0)
        plant.step(nmpc(estimate, i * DT), DT)
        t = (i + 1) * DT
        q_after = plant.state.q
        goal, _ = conflict.goal(t)
        tool_error = tool_position(robot, q_after) - goal.translation
        tool.append(1e3 * float(np.linalg.norm(tool_error)))
        vehicle.append(1e3 * float(np.linalg.norm(q_after[:3] - q[:3])))
        if conflict.obstacle:
            gaps.append(1e3 * conflict.obstacle.gap(robot, q_after, t))
    settled = tool[round((conflict.returned + SETTLING) / DT) :]
    spent = plant.telemetry()
    return {
        "largest tool error [mm]": max(tool),
        "largest tool error afterwards [mm]": max(settled, default=np.nan),
        "largest way of the vehicle [mm]": max(vehicle),
        "smallest gap [mm]": min(gaps, default=np.inf),
        "energy [J]": float(np.sum(spent["thruster_energy"])) + float(spent["joint_energy"]),
    }
