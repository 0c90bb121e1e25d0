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
        problems = {LEVELS: conflict.problem} | {
            f"weights, {w:g}": conflict.as_sum(w) for w in runs.weights
        }
        for seed in runs.seeds:
            for name, problem in problems.items():
                nmpc = Nmpc(
                    problem, dt=DT, period=PERIOD, clock=process_time, options=STRICT, gains=GAINS
                )
                found = conflict_run(conflict, nmpc, seed, min(runs.seconds, conflict.seconds))
                yield {
                    "conflict": conflict.name,
                    "priorities": name,
                    "seed": seed,
                    **found,
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
        plant.step(
            nmpc(StateEstimate(q=plant.state.q, v=plant.state.v, altimeter_range=30.0), i * DT), DT
        )
        now = plant.state.q
        t = (i + 1) * DT
        tool.append(
            1e3 * float(np.linalg.norm(tool_position(robot, now) - conflict.goal(t)[0].translation))
        )
        vehicle.append(1e3 * float(np.linalg.norm(now[:3] - q[:3])))
        gaps.append(1e3 * conflict.obstacle.gap(robot, now, t) if conflict.obstacle else np.inf)
    settled = tool[round((conflict.returned + SETTLING) / DT) :]
    spent = plant.telemetry()
    return {
        "largest tool error [mm]": max(tool),
        "largest tool error afterwards [mm]": max(settled, default=np.nan),
        "largest way of the vehicle [mm]": max(vehicle),
        "smallest gap [mm]": min(gaps),
        "energy [J]": float(np.sum(spent["thruster_energy"])) + float(spent["joint_energy"]),
    }
