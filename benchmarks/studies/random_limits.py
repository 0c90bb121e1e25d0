"""Random starts and goals among obstacles: are joints, altitude and clearance kept on the way?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from recording.rows import column

from studies.study import Study, seeds_from
from uvms_ocp.campaign.jobs import Row
from uvms_ocp.checks import checked
from uvms_ocp.control.velocity.kinematic import HierarchySolver
from uvms_ocp.mission.phase import Above, Phase, Transition
from uvms_ocp.record.meta_values import DONE
from uvms_ocp.record.record import Record
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.collision_model import CollisionModel
from uvms_ocp.robot.shapes.obstacles import Obstacle
from uvms_ocp.scenario.options import activate, mission_of, run_options
from uvms_ocp.scenario.scenario import Scenario, pose_at
from uvms_ocp.sim.seafloor import FlatSeafloor, floor_obstacle
from uvms_ocp.tasks.altitude import MinimumAltitude
from uvms_ocp.tasks.attitude import HorizontalAttitude
from uvms_ocp.tasks.clearance import Clearance
from uvms_ocp.tasks.joints import JointLimits, JointTracking
from uvms_ocp.tasks.pose import ToolPose, VehiclePose
from uvms_ocp.types import Count, Period

_FLOOR = -4.0  # [m]
_ALTITUDE = 1.0  # [m]
CLEARANCE = 0.05  # [m] kept from obstacles and floor
SELF_CLEARANCE = 0.03  # [m] kept between the links of the robot
N_OBSTACLES = 6
N_PHASES = 4
_SHORTEST = 1.0  # [s] of a phase
_LONGEST = 4.0  # [s] of a phase
TOLERANCE = 1e-6
"""[m, rad] below which a violation is rounding."""
_WAYS = (("PC", "MP"), ("T", "MP"), ("PC", "T"))
"""Tasks of a phase besides the limits."""


@checked
def random_limits(
    *, n: int = 1000, seed: Count = 0, robot: str = "girona_maris7_full", dt: Period = 1 / 200
) -> Study:
    """`n` runs on the kinematic plant with the seeds `seed`, `seed` + 1, ..., see `close_quarters`.

    dt [s]: control period. Raises `InvalidInput` for no runs or a negative seed.
    """
    cases = [{"seed": drawn, "robot": robot, "dt": dt} for drawn in seeds_from(seed, n)]
    title = f"{n} random starts and goals among obstacles"
    return Study(
        name="random_limits", title=title, cases=cases, run_case=run_limits, summarize=largest
    )


def close_quarters(
    *,
    seed: int,
    robot: str = "girona_maris7_full",
    dt: Period = 1 / 200,
    solver: HierarchySolver | None = None,
) -> Scenario:
    """Four phases of 1 to 4 s towards goals that nobody checked, from rest, among spheres, capsules
    and boxes.

    Start, obstacles, goals and tasks of the phases are drawn from `seed`. Joint limits, minimum
    altitude and clearance of obstacles, floor and the robot itself hold at the start and are on
    throughout. dt [s]: control period.
    """
    options = {"robot": robot, "solver": solver, "plant": "kinematic", "dt": dt}
    run = run_options(options | {"duration": _LONGEST * N_PHASES + 1.0}, seabed=_FLOOR)
    rng = np.random.default_rng(seed)
    machine = run.robot
    obstacles = (
        floor_obstacle(FlatSeafloor(z=_FLOOR), centre=(0.0, 0.0), extent=40.0),
        *(_obstacle(rng, index) for index in range(N_OBSTACLES)),
    )
    clear = Clearance(
        model=CollisionModel(machine, obstacles, self_collision=False), threshold=CLEARANCE
    )
    itself = Clearance(
        name="SC", model=CollisionModel(machine), threshold=SELF_CLEARANCE, margin=SELF_CLEARANCE
    )
    tasks = [
        JointLimits(),
        MinimumAltitude(threshold=_ALTITUDE),
        HorizontalAttitude(),
        clear,
        itself,
        VehiclePose(goal=pose_at((0.0, 0.0, 0.0))),
        ToolPose(goal=pose_at((0.0, 0.0, 0.0))),
        JointTracking(joints=machine.joint_names, goal=machine.home),
    ]
    phases = tuple(_phase(machine, rng, index) for index in range(N_PHASES))
    return run.scenario(
        name=f"limits{seed}",
        mission=mission_of(machine, tasks, phases),
        start=_start(machine, rng, (clear, itself)),
        obstacles=obstacles[1:],
        markers={},
    )


def run_limits(case: dict[str, Any]) -> Row:
    """How far each limit was violated at any tick, and the largest step of the command."""
    scenario = close_quarters(**case)
    record = scenario.run()
    step = np.diff(record["command"], axis=0, prepend=0.0) / (
        scenario.robot.limits.acceleration * scenario.dt
    )
    return {
        **case,
        **limit_violations(scenario, record),
        "largest_step": float(np.abs(step).max()),
        "slowed_share": float(np.mean(record["viable_share"] < 1.0)),
        "duration_s": float(record["t"][-1]),
        "path_m": float(np.linalg.norm(np.diff(record["q"][:, :3], axis=0), axis=1).sum()),
    }


def limit_violations(scenario: Scenario, record: Record) -> dict[str, float]:
    """Largest violation at any tick of joint limits [rad], minimum altitude [m] and clearances [m],
    0 where kept.

    From the true configurations, the floor and the definition of each limit alone. Infinite where a
    value is no number.
    """
    robot = scenario.robot
    q = record["q"]
    joints = q[:, robot.joint_q]
    limits = robot.limits
    beyond = np.maximum(limits.position_lower - joints, joints - limits.position_upper)
    violations = {"joints_rad": _violation(beyond.max())}
    for task in scenario.mission.hierarchy.tasks:
        if not isinstance(task, (MinimumAltitude, Clearance)):
            continue
        if not np.isfinite(q).all():
            violations[f"{task.name}_m"] = np.inf
            continue
        if isinstance(task, MinimumAltitude):
            smallest = _altitudes(scenario, task, q).min()
        else:
            smallest = np.min([task.model.values(row) for row in q])
        violations[f"{task.name}_m"] = _violation(task.threshold - smallest)
    return violations


def _violation(excess: float) -> float:
    """0 where a limit is kept, infinite where the excess is no number."""
    return np.inf if np.isnan(excess) else max(float(excess), 0.0)


def _altitudes(scenario: Scenario, task: MinimumAltitude, q: np.ndarray) -> np.ndarray:
    """(n,) [m] of the sensor above the floor straight below it, at q (n, n_q)."""
    robot = scenario.robot
    floor = scenario.environment.seafloor
    data = robot.model.createData()
    frame = robot.frame_id(task.frame or robot.description.altimeter or "")
    altitudes = []
    for row in q:
        pin.framesForwardKinematics(robot.model, data, row)
        x, y, z = data.oMf[frame].translation
        altitudes.append(z - floor.height(x, y))
    return np.array(altitudes)


def largest(rows: Sequence[Row]) -> list[Row]:
    """One row: the largest violation and step of all runs, and in how many runs any limit is
    violated by > 1e-6.
    """
    violations = [name for name in rows[0] if name.endswith(("_rad", "_m")) and name != "path_m"]
    seeds = []
    for row in rows:
        if not all(row[name] <= TOLERANCE for name in violations):
            seeds.append(str(row["seed"]))
    maxima = {}
    for name in (*violations, "largest_step"):
        maxima[name] = float(np.max(column(rows, name)))
    return [
        {
            "runs": len(rows),
            "violated": len(seeds),
            "seeds": " ".join(seeds),
            **maxima,
            "slowed_share": float(np.mean(column(rows, "slowed_share"))),
            "mean_path_m": float(np.mean(column(rows, "path_m"))),
        }
    ]


def _phase(robot: Robot, rng: np.random.Generator, index: int) -> Phase:
    """A phase that ends by the clock, with goals on both sides of the limits."""
    low, high = _joint_range(robot)
    way = rng.uniform([-3.0, -3.0, -3.5], [3.0, 3.0, -1.0])
    turn = rng.uniform(-np.pi, np.pi)
    goals = {
        "PC": pose_at(tuple(way), (0.0, 0.0, turn)),
        "T": pose_at(
            tuple(rng.uniform([-3.0, -3.0, -4.5], [3.0, 3.0, -1.0])),
            tuple(rng.uniform(-np.pi, np.pi, 3)),
        ),
        "MP": low + rng.uniform(-0.2, 1.2, len(low)) * (high - low),
    }
    # Any altitude is above 0: the condition holds at once, and the phase ends when it has held.
    clock = (Above(quantity="MAC.altitude", limit=1e-6),)
    next_phase = str(index + 2)
    if index == N_PHASES - 1:
        next_phase = DONE
    end = Transition(to=next_phase, when=clock, hold=float(rng.uniform(_SHORTEST, _LONGEST)))
    activations = activate("JL", "MAC", "HA", "CL", "SC", *_WAYS[rng.integers(len(_WAYS))])
    return Phase(name=str(index + 1), activations=activations, transitions=(end,), goals=goals)


def _obstacle(rng: np.random.Generator, index: int) -> Obstacle:
    size = rng.uniform(0.1, 0.5, 3)
    shape = (
        coal.Sphere(size[0]),
        coal.Capsule(0.5 * size[0], 4.0 * size[1]),
        coal.Box(*(2.0 * size)),
    )[index % 3]
    pose = pose_at(
        tuple(rng.uniform([-2.0, -2.0, -4.0], [2.0, 2.0, -1.0])),
        tuple(rng.uniform(-np.pi, np.pi, 3)),
    )
    return Obstacle(name=f"obstacle{index + 1}", shape=shape, X_WO=pose)


def _start(robot: Robot, rng: np.random.Generator, clearances: Sequence[Clearance]) -> np.ndarray:
    """A configuration (n_q,) inside all limits."""
    low, high = _joint_range(robot)
    altimeter = robot.frame_id("altimeter")
    while True:
        q = robot.configuration(
            position=rng.uniform([-3.0, -3.0, -3.0], [3.0, 3.0, -1.0]),
            rpy=rng.uniform([-0.2, -0.2, -np.pi], [0.2, 0.2, np.pi]),
            joints=low + np.clip(rng.uniform(-0.1, 1.1, len(low)), 0.0, 1.0) * (high - low),
        )
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, q)
        high_enough = data.oMf[altimeter].translation[2] - _FLOOR >= _ALTITUDE
        if high_enough and all(task.model.values(q).min() >= task.threshold for task in clearances):
            return q


def _joint_range(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper ends (n_joints,) to draw from, half a turn where there is no limit."""
    limits = robot.limits
    return np.maximum(limits.position_lower, -np.pi), np.minimum(limits.position_upper, np.pi)
