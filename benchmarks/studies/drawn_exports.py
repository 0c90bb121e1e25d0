"""Drawn robots and missions whose controllers are exported: C repeats what Python told to the last
bit.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
from recording.rows import column, rows_where

from studies.study import Study, seeded_study
from uvms_ocp.campaign.jobs import Row
from uvms_ocp.errors import UvmsError, plain_line
from uvms_ocp.export import export_controller
from uvms_ocp.mission.phase import Above, Below, Phase, Transition
from uvms_ocp.record.meta_values import DONE
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.collision_model import CollisionModel
from uvms_ocp.robot.shapes.obstacles import obstacle
from uvms_ocp.scenario.options import abort_phase, activate, mission_of, run_options
from uvms_ocp.scenario.scenario import Scenario, pose_at
from uvms_ocp.solvers import Icat, LexicographicActiveSet
from uvms_ocp.tasks import (
    Alignment,
    Clearance,
    HorizontalAttitude,
    JointLimits,
    JointTracking,
    Manipulability,
    MinimumAltitude,
    Task,
    ToolPose,
    ToolPosition,
    VehiclePose,
)
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial
from uvms_ocp.types import Count

# A robot: a box with drawn thrusters, or a fixed base, and an arm of drawn joints.

JOINT_KINDS = ("revolute", "prismatic", "continuous", "planar")
_OFTEN = (0.5, 0.2, 0.2, 0.1)
_MOST_JOINTS = 5
_MOST_THRUSTERS = 8
_HULL = """<link name="base_link">
  <inertial><mass value="{mass}"/><inertia ixx="0.5" ixy="0" ixz="0" iyy="0.7" iyz="0" izz="0.8"/></inertial>
  <collision><geometry><box size="0.6 0.4 0.3"/></geometry></collision></link>"""
_BOOM = """<link name="arm{k}"><inertial><origin xyz="0.1 0 0"/><mass value="0.6"/>
  <inertia ixx="0.0004" ixy="0" ixz="0" iyy="0.004" iyz="0" izz="0.004"/></inertial></link>
<joint name="joint{k}" type="{kind}"><parent link="{parent}"/><child link="arm{k}"/>
  <origin xyz="{reach} 0 0"/><axis xyz="{axis}"/>{limit}</joint>"""
_FOLLOWER = """<link name="finger"><inertial><origin xyz="0.02 0 0"/><mass value="0.1"/>
  <inertia ixx="1e-5" ixy="0" ixz="0" iyy="1e-5" iyz="0" izz="1e-5"/></inertial></link>
<joint name="finger_joint" type="prismatic"><parent link="{parent}"/><child link="finger"/>
  <origin xyz="0.2 0.03 0"/><axis xyz="0 1 0"/><limit lower="-9" upper="9" effort="8" velocity="0.7"/>
  <mimic joint="{leader}" multiplier="{multiplier}"/></joint>"""
_TOOL = """<link name="tool"/>
<joint name="mount" type="fixed"><parent link="{parent}"/><child link="tool"/>
  <origin xyz="0.3 0 0"/></joint>"""
_WATER = """coefficients: {{added_mass: [9, 14, 18, 0.3, 0.4, 0.5], linear_drag: [12, 15, 20, 1, 1, 1],
    quadratic_drag: [30, 45, 60, 2, 2, 2], volume: {volume}, centre_of_buoyancy: [0.011, 0, 0.03]}}"""
_AXES = ("0 1 0", "0 0 1", "1 0 0")
_DIRECTIONS = np.array([[1.0, 0.9, 0.0], [1.0, -0.9, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True, kw_only=True, slots=True)
class Machine:
    """Base, thrusters and joints from which the files of a robot are written."""

    floating: bool
    thrusters: int
    joints: tuple[str, ...]
    """Types."""
    follower: bool
    """A finger mimics the first joint."""


def drawn_machine(rng: np.random.Generator) -> Machine:
    """A vehicle of none to 8 thrusters with none to 5 joints, or a fixed base with an arm."""
    floating = bool(rng.random() < 0.85)
    fewest_joints = 0 if floating else 1
    joints = int(rng.integers(fewest_joints, _MOST_JOINTS + 1))
    kinds = tuple(rng.choice(JOINT_KINDS, p=_OFTEN, size=joints).tolist())
    can_be_followed = bool(kinds) and kinds[0] in ("revolute", "prismatic")
    follower = can_be_followed and bool(rng.random() < 0.2)
    thrusters = int(rng.integers(_MOST_THRUSTERS + 1)) if floating else 0
    return Machine(floating=floating, thrusters=thrusters, joints=kinds, follower=follower)


def write_machine(machine: Machine, rng: np.random.Generator, folder: Path) -> Robot:
    """The robot of files that are written to a folder. Raises `UvmsError` where the package refuses
    them.
    """
    mass = float(rng.uniform(20.0, 28.0))
    parts = [_HULL.format(mass=mass)]
    parent = "base_link"
    for k, kind in enumerate(machine.joints):
        reach = round(float(rng.uniform(0.2, 0.35)), 3)
        axis = "0 0 1"
        if kind != "planar":
            axis = _AXES[int(rng.integers(3))]
        limit = _limit(kind, rng)
        parts.append(
            _BOOM.format(k=k, kind=kind, parent=parent, reach=reach, axis=axis, limit=limit)
        )
        parent = f"arm{k}"
    if machine.follower:
        multiplier = round(float(rng.uniform(-1.0, 1.0)), 2)
        parts.append(_FOLLOWER.format(parent=parent, leader="joint0", multiplier=multiplier))
    parts.append(_TOOL.format(parent=parent))
    urdf = folder / "robot.urdf"
    urdf.write_text(f"<robot name='drawn'>{''.join(parts)}</robot>", encoding="utf-8")
    water = folder / "hydrodynamics.yaml"
    water.write_text(_water(machine, mass, rng), encoding="utf-8")
    return load_robot(urdf=urdf, hydrodynamics=water)


def _limit(kind: str, rng: np.random.Generator) -> str:
    if kind == "planar":
        return ""
    if kind == "continuous":
        return '<limit effort="8" velocity="0.7"/>'
    lower = -rng.uniform(0.3, 2.0)
    upper = rng.uniform(0.3, 2.0)
    return f'<limit lower="{lower:.3f}" upper="{upper:.3f}" effort="8" velocity="0.7"/>'


def _water(machine: Machine, mass: float, rng: np.random.Generator) -> str:
    volume = (mass + 0.6 * len(machine.joints)) / 1025.0 * rng.uniform(0.995, 1.005)
    bounds = "[0.8, 0.5, 0.5, 0.6, 0.6, 0.6]"
    lines = [f"base: {'free_flyer' if machine.floating else 'fixed'}", "altimeter: base_link"]
    if machine.floating:
        lines.append(f"vehicle_limits: {{velocity: {bounds}, acceleration: {bounds}}}")
    links = [f"base_link: {{{_WATER.format(volume=round(volume, 6))}}}"]
    for k in range(len(machine.joints)):
        links.append(f"arm{k}: {{coefficients: {{}}}}")
    lines.append(f"links: {{{', '.join(links)}}}")
    if machine.thrusters:
        lines.append("thrusters: ")
    else:
        lines.append("thrusters: []")
    for k in range(machine.thrusters):
        at = np.round(rng.uniform([-0.3, -0.2, -0.1], [0.3, 0.2, 0.1]), 3).tolist()
        usual = _DIRECTIONS[k % len(_DIRECTIONS)] + 0.1 * rng.normal(size=3)
        direction = np.round(usual / np.linalg.norm(usual), 4).tolist()
        strength = round(float(rng.uniform(20.0, 60.0)), 1)
        lines.append(
            f"  - {{name: t{k}, position: {at}, direction: {direction}, minimum: {-strength},"
            f" maximum: {strength}, time_constant: 0.1}}"
        )
    return "\n".join(lines) + "\n"


# A mission of two phases, the second with goals of its own.

_START = (0.0, 0.0, -5.0)
_FLOOR = -9.0  # [m]
_PERIODS = (0.005, 0.01, 0.02, 0.05)  # [s]
_TICKS = (150, 400)
_OBSTRUCTED = 0.25  # share of missions with an obstacle
_BESIDE = (1.6, 0.3, 0.2)  # [m] from the start to the middle of the obstacle


def drawn_scenario(robot: Robot, rng: np.random.Generator, name: str) -> Scenario:
    """Either solver and plant, with and without noise, current, obstacles, faults and abort.

    Raises `UvmsError` where the package refuses it.
    """
    dt = float(rng.choice(_PERIODS))
    duration = dt * int(rng.integers(*_TICKS))
    is_driven = bool(robot.description.thrusters) or not robot.n_vehicle
    plant = "kinematic"
    if is_driven and rng.random() < 0.8:
        plant = "dynamic"
    has_fault = plant == "dynamic" and robot.description.thrusters and rng.random() < 0.2
    solver: Icat | LexicographicActiveSet = LexicographicActiveSet()
    if rng.random() < 0.4:
        solver = Icat()
    noise = bool(rng.random() < 0.4)
    current = None
    if robot.n_vehicle and rng.random() < 0.3:
        current = (0.1, -0.05, 0.0)
    faults = None
    if has_fault:
        faults = (f"thruster1:dead@{0.4 * duration:.3f}",)
    run = run_options(
        {
            "robot": robot,
            "solver": solver,
            "plant": plant,
            "noise": noise,
            "current": current,
            "seed": int(rng.integers(1000)),
            "dt": dt,
            "duration": duration,
            "faults": faults,
        },
        seabed=_FLOOR,
    )
    start = _posture(robot, pose_at(_START, (0.0, 0.0, float(rng.uniform(-3.0, 3.0)))), rng)
    tasks = list(_tasks(robot, start, rng))
    later_tasks = {task.name: task for task in _tasks(robot, start, rng)}
    if rng.random() < _OBSTRUCTED:
        base = _START if robot.n_vehicle else (0.0, 0.0, 0.0)
        ball = obstacle("ball", coal.Sphere(0.3), np.array(base) + _BESIDE)
        surroundings = CollisionModel(robot, (ball,), self_collision=False)
        tasks.insert(0, Clearance(model=surroundings, n_nearest=4))
    phases = tuple(_phases(tasks, later_tasks, 0.4 * duration, rng))
    abort = None
    if "PC" in later_tasks and rng.random() < 0.5:
        abort = abort_phase("PC")
    mission = mission_of(robot, tasks, phases, abort=abort)
    return run.scenario(name=name, mission=mission, start=start, markers={})


def _posture(robot: Robot, pose: Any, rng: np.random.Generator) -> np.ndarray:
    """(n_q,) with joints anywhere in the middle of their range."""
    if robot.n_vehicle:
        q = robot.configuration(position=pose.translation, rpy=(0.0, 0.0, 0.0))
    else:
        q = robot.configuration()
    if not robot.n_joints:
        return q
    low = np.clip(robot.limits.position_lower, -1.0, 1.0)
    high = np.clip(robot.limits.position_upper, -1.0, 1.0)
    return robot.with_joint_values(q, 0.5 * rng.uniform(low, high))


def _tasks(robot: Robot, start: np.ndarray, rng: np.random.Generator) -> Iterator[Task]:
    """Tasks with drawn goals near the start."""
    if robot.n_joints:
        yield JointLimits()
    if robot.n_vehicle:
        yield MinimumAltitude()
        if rng.random() < 0.6:
            yield HorizontalAttitude()
        if rng.random() < 0.3:
            yield Alignment(goal=np.array([*rng.uniform(2.0, 5.0, 2), -5.0]))
    if robot.n_joints:
        if rng.random() < 0.3:
            yield Manipulability()
        tool = Kinematics(robot, start).pose("tool")
        target = tool.translation + rng.uniform(-0.3, 0.3, 3)
        if rng.random() < 0.3:
            yield ToolPose(name="T", goal=pose_at(tuple(target.tolist()), (0.1, 0.2, 0.3)))
        else:
            yield ToolPosition(name="T", goal=pose_at(tuple(target.tolist())))
    if robot.n_vehicle:
        place = np.array(_START) + rng.uniform(-1.0, 1.0, 3)
        yaw = float(rng.uniform(-1.0, 1.0))
        yield VehiclePose(goal=pose_at(tuple(place.tolist()), (0.0, 0.0, yaw)))
    tracked = _joints_of_one_axis(robot)
    if tracked:
        yield JointTracking(joints=tuple(tracked), goal=robot.home[list(tracked.values())])


def _joints_of_one_axis(robot: Robot) -> dict[str, int]:
    """Place among the joints' values, by name."""
    places = {}
    for name in robot.joint_names:
        joint = robot.model.joints[robot.model.getJointId(name)]
        if joint.nv == 1:
            places[name] = joint.idx_v - robot.n_vehicle
    return places


def _phases(
    tasks: Sequence[Task], later_tasks: dict[str, Task], longest: float, rng: np.random.Generator
) -> Iterator[Phase]:
    """The first ends where the first goal is near, or by time; the second has goals of its own.

    later_tasks: by name, with the goals of the second phase. longest [s]: of the first phase.
    """
    names = [task.name for task in tasks]
    goal = "PC" if "PC" in names else "T"
    arrived = (Below(quantity=f"{goal}.position_error", limit=0.1),)
    time_over = (Above(quantity="phase.time", limit=longest),)
    onward = (Transition(to="B", when=arrived, hold=0.1), Transition(to="B", when=time_over))
    active_at_first = {}
    for name in names:
        if name in ("JL", goal) or rng.random() < 0.6:
            active_at_first[name] = 1.0
    yield Phase(name="A", activations=active_at_first, transitions=onward)
    goals: dict[str, Any] = {}
    for name in ("PC", "T"):
        if name in names and type(later_tasks[name]) is type(tasks[names.index(name)]):
            goals[name] = later_tasks[name].goal  # type: ignore[attr-defined]
    for task in tasks:
        if isinstance(task, JointTracking) and rng.random() < 0.4:
            goals["MP"] = _ramp(len(task.joints), longest, rng)
    yield Phase(
        name="B",
        activations=activate(*names),
        transitions=(Transition(to=DONE, when=arrived, hold=0.1),),
        goals=goals,
    )


def _ramp(n: int, duration: float, rng: np.random.Generator) -> PiecewisePolynomial:
    """A goal that moves and then rests."""
    rates = rng.uniform(-0.2, 0.2, n)
    coefficients = np.stack([np.zeros(n), rates * duration])[:, None]
    return PiecewisePolynomial(breaks=np.array([0.0, duration]), coefficients=coefficients)


# Exported, built, replayed.

PLAIN = ("-std=c99", "-O0")
FUSING = ("-std=gnu99", "-O3", "-march=native")
"""Flags with which compilers fuse multiplications that nobody keeps them from fusing."""
_EVERY = 8  # exports, of which one is built with `FUSING`
_TIMEOUT = 600.0  # [s]


def replayed(folder: Path, name: str, flags: Sequence[str]) -> dict[str, Any]:
    """Build an export and have it replay its run: ticks, those apart, and the largest
    difference.
    """
    sources = sorted(path.name for path in folder.glob(f"{name}_*.c"))
    _called(folder, "cc", *flags, *sources, "-lm", "-o", "replay")
    printed = _called(folder, "./replay", f"{name}_recorded.bin", ok=(0, 1))
    ticks, _, apart = printed.split()[:3]
    return {
        "ticks": int(ticks),
        "apart": int(apart),
        "largest_difference": float(printed.split("difference ")[1].split(",")[0]),
    }


def _called(folder: Path, *words: str, ok: Sequence[int] = (0,)) -> str:
    process = subprocess.run(
        words, cwd=folder, capture_output=True, text=True, timeout=_TIMEOUT, check=False
    )
    if process.returncode not in ok:
        complaint = plain_line(process.stderr, 300)
        raise RuntimeError(f"{words[0]} failed with {process.returncode}: {complaint}")
    return process.stdout


def drawn_case(seed: int, folder: Path) -> Scenario:
    """Return the robot and mission of a seed; its files are in the folder.

    Raises `UvmsError` where the package refuses them.
    """
    rng = np.random.default_rng(seed)
    machine = drawn_machine(rng)
    return drawn_scenario(write_machine(machine, rng, folder), rng, f"drawn {seed}")


def run_export(case: dict[str, Any]) -> Row:
    """One robot, its mission, its controller in C."""
    seed = case["seed"]
    machine = drawn_machine(np.random.default_rng(seed))
    row: dict[str, Any] = {
        **case,
        "base": "floating" if machine.floating else "fixed",
        "thrusters": machine.thrusters,
        "joints": " ".join(machine.joints) or "none",
        "follower": machine.follower,
        "solver": "",
        "plant": "",
        "dt": 0.0,
        "tasks": "",
        "flags": "",
        "ticks": 0,
        "apart": 0,
        "largest_difference": 0.0,
        "text": "",
    }
    flags = FUSING if seed % _EVERY == 0 else PLAIN
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        try:
            scenario = drawn_case(seed, folder)
            row |= {
                "solver": type(scenario.solver).__name__,
                "plant": str(scenario.plant),
                "dt": scenario.dt,
                "tasks": " ".join(scenario.mission.hierarchy.names),
                "flags": " ".join(flags),
            }
            export_controller(scenario, folder / "c")
            row |= replayed(folder / "c", f"drawn_{seed}", flags)
            outcome = "apart" if row["apart"] else "the same bits"
        except UvmsError as error:
            outcome = "refused"
            row["text"] = plain_line(str(error).replace(place, "DIR"), 300)
        except Exception as error:
            outcome = "fault"
            row["text"] = plain_line(f"{type(error).__name__}: {error}".replace(place, "DIR"), 300)
    return {**row, "outcome": outcome, "completed": outcome in ("the same bits", "refused")}


def totals(rows: Sequence[Row]) -> list[Row]:
    """Outcomes, by what was drawn."""
    fusing = " ".join(FUSING)
    kinds = {
        "all": list(rows),
        "LexicographicActiveSet": rows_where(rows, "solver", "LexicographicActiveSet"),
        "Icat": rows_where(rows, "solver", "Icat"),
        "dynamic": rows_where(rows, "plant", "dynamic"),
        "kinematic": rows_where(rows, "plant", "kinematic"),
        "without joints": rows_where(rows, "joints", "none"),
        "without thrusters": rows_where(rows, "thrusters", 0),
        "fixed base": rows_where(rows, "base", "fixed"),
    }
    for kind in JOINT_KINDS:
        kinds[kind] = [row for row in rows if kind in row["joints"].split()]
    kinds["a finger that follows"] = rows_where(rows, "follower", True)
    kinds[fusing] = rows_where(rows, "flags", fusing)
    return [_total(name, chosen) for name, chosen in kinds.items()]


def _total(name: str, rows: Sequence[Row]) -> Row:
    number = Counter(column(rows, "outcome"))
    return {
        "exports": name,
        "drawn": len(rows),
        "the same bits": number["the same bits"],
        "apart": number["apart"],
        "refused": number["refused"],
        "fault": number["fault"],
        "ticks": sum(column(rows, "ticks")),
    }


def drawn_exports(*, n: Count = 300, seed: Count = 0) -> Study:
    """Make a study of n drawn exports from a seed on."""
    title = "Drawn controllers in C"
    return seeded_study(
        "drawn_exports", title, n=n, seed=seed, run_case=run_export, summarize=totals
    )
