"""One work of one size, in this process: ``python works.py WORK SIZE``, which leaves what it took
in the file ``spent``.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import coal
import numpy as np
from hierarchy_solvers import ours, problems
from horizon.problems import tool_reach

import uvms_ocp as uo
from uvms_ocp.control.velocity.kinematic import HierarchySolver
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.trajectory import hold_guess
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.shapes.obstacles import Obstacle
from uvms_ocp.scenario import scenario_run
from uvms_ocp.scenario.cases import case1, obstacle_field
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.cascade import LexicographicQp
from uvms_ocp.solvers.hierarchy.level import Level
from uvms_ocp.solvers.nlp.options import NlpOptions
from uvms_ocp.tasks import JointLimits, JointTracking, ToolPosition

Spent = dict[str, float]
"""``time_s`` [s], and what else there is to tell."""
TICKS = 100
"""Ticks in a run of a campaign."""


def plan(stages: int) -> Spent:
    """Time of an iteration of the tool reach, planned for the second time."""
    planner = Planner(tool_reach(stages), NlpOptions(plugin="stagewise"), wait_for_compiler=True)
    for _ in range(2):
        begin = time.process_time()
        plan_found = planner.plan(guess=hold_guess(planner.problem), diagnose=False)
        spent = time.process_time() - begin
    assert plan_found.status is OcpStatus.SOLVED, plan_found.status
    return {
        "time_s": spent / plan_found.iterations,
        "us_each": 1e6 * spent / plan_found.iterations / stages,
    }


def hierarchy(n: int) -> Spent:
    """Velocity box, equalities and inequalities, least velocity below."""
    sets = [problems.grown_hierarchy(np.random.default_rng(seed), n) for seed in range(20)]
    return _solved(LexicographicActiveSet(), sets)


def humanoid(n: int) -> Spent:
    """Simple bounds of most variables, 33, 3 and 2 rows, and 97 below."""
    sets = [problems.humanoid_hierarchy(np.random.default_rng(seed), n) for seed in range(20)]
    return _solved(LexicographicActiveSet(), sets)


def cascade(n: int) -> Spent:
    """Random hierarchies by qpOASES."""
    structure = problems.STRUCTURES[n]
    sets = [
        problems.random_hierarchy(np.random.default_rng(seed), n, structure) for seed in range(20)
    ]
    return _solved(LexicographicQp(), sets)


def dependent(n: int) -> Spent:
    """Rows that depend on each other, by qpOASES."""
    sets = [
        problems.dependent_hierarchy(np.random.default_rng(k), n, problems.DEPENDENT, 0.0)
        for k in range(200)
    ]
    return _solved(LexicographicQp(), sets)


def control(n: int) -> Spent:
    """Linear model predictive control of a mass over n steps, within limits of position and
    velocity, by qpOASES.
    """
    sets = [_control(np.random.default_rng(seed), n) for seed in range(30)]
    return _solved(LexicographicQp(), sets)


def _control(rng: np.random.Generator, n: int) -> list[Level]:
    dt = 0.1
    after = dt * np.tril(np.ones((n, n)))  # velocities after each step, of n accelerations
    place = dt * np.tril(np.ones((n, n))) @ after - 0.5 * dt * after
    x = rng.uniform(-1.0, 1.0)
    v = rng.uniform(-0.5, 0.5)
    free = x + dt * v * np.arange(1, n + 1)
    limits = Level(
        jacobian=np.vstack([place, after]),
        lower=np.concatenate([-1.5 - free, np.full(n, -1.0 - v)]),
        upper=np.concatenate([1.5 - free, np.full(n, 1.0 - v)]),
    )
    goal = rng.uniform(-2.0, 2.0) - free
    return [
        limits,
        Level(jacobian=place, lower=goal, upper=goal),
        Level(jacobian=np.eye(n), lower=0.0, upper=0.0),
    ]


def _solved(solver: HierarchySolver, sets: list[list[Level]]) -> Spent:
    solution = ours.solved(solver, problems.Problem(name="", warm=False, sets=sets))
    return {
        "time_s": float(np.median(solution.seconds)),
        "problems": len(sets),
        "inexact": solution.inexact,
    }


def campaign(runs: int) -> Spent:
    """Runs of one mission, each made anew, after a first one."""
    _run(0)
    begin = time.process_time()
    for seed in range(runs):
        _run(seed)
    spent = time.process_time() - begin
    return {"time_s": spent, "us_each": 1e6 * spent / runs}


def _run(seed: int) -> None:
    case1(noise=True, seed=seed, dt=0.005, duration=0.005 * TICKS).run()


def setup(runs: int) -> Spent:
    """Until the first tick of each: robot, mission, controller, estimator, sensors and plant."""
    begun = list[float]()
    simulate = scenario_run.simulate

    def timed(**parts: Any) -> Any:
        begun.append(time.process_time())
        return simulate(**parts)

    scenario_run.simulate = timed
    spent = 0.0
    for seed in range(-1, runs):
        begin = time.process_time()
        case1(noise=True, seed=max(seed, 0), duration=0.005).run()
        if seed >= 0:
            spent += begun[-1] - begin
    return {"time_s": spent, "us_each": 1e6 * spent / runs}


def obstacles(count: int) -> Spent:
    """Ticks past so many spheres, most of them beside the way."""
    rng = np.random.default_rng(0)
    to_the_left = rng.uniform((-10.0, 1.2, -45.0), (20.0, 20.0, -30.0), (count, 3))
    places = to_the_left * np.where(rng.random((count, 1)) < 0.5, 1, (1, -1, 1))
    rocks = []
    for k, place in enumerate(places):
        rocks.append(Obstacle(name=f"rock{k}", shape=coal.Sphere(0.3), X_WO=uo.pose_at(place)))
    return _ticks(obstacle_field(obstacles=rocks, plant="kinematic", duration=5.0))


def arms(count: int) -> Spent:
    """Ticks of a vehicle with so many arms of seven joints, a goal for each tool."""
    urdf = Path(f"arms{count}.urdf")
    yaml = Path(f"arms{count}.yaml")
    tools = [f"tool{a}" for a in range(count)]
    urdf.write_text(_urdf(count), encoding="utf-8")
    yaml.write_text(f"tool: [{', '.join(tools)}]\n{_WATER}", encoding="utf-8")
    robot = uo.load_robot(urdf=urdf, hydrodynamics=yaml)
    start = robot.configuration(position=(0.0, 0.0, -5.0))
    kinematics = Kinematics(robot, start)
    reaches = []
    never = []
    for a, tool in enumerate(tools):
        goal = uo.pose_at(kinematics.pose(tool).translation + 0.2)
        reaches.append(ToolPosition(name=f"T{a}", frame=tool, goal=goal))
        never.append(uo.Below(quantity=f"T{a}.position_error", limit=1e-9))
    tasks = [JointLimits(), *reaches, JointTracking(joints=robot.joint_names, goal=robot.home)]
    phase = uo.Phase(
        name="reach",
        activations={task.name: 1 for task in tasks},
        transitions=(uo.Transition(to=uo.DONE, when=tuple(never)),),
    )
    mission = uo.Mission(hierarchy=uo.Hierarchy(tasks), phases=(phase,))
    water = uo.Environment(seafloor=uo.FlatSeafloor(z=-20))
    return _ticks(
        Scenario(
            name="arms",
            robot=robot,
            mission=mission,
            environment=water,
            start=start,
            duration=5.0,
            plant="kinematic",
        )
    )


_WATER = """links:
  base_link: {coefficients: {added_mass: [20, 40, 40, 2, 4, 4], linear_drag: [20, 40, 40, 5, 5, 5]}}
"""


def _urdf(count: int) -> str:
    parts = ["<robot name='arms'>", _link("base_link", 60.0)]
    for a in range(count):
        above = "base_link"
        for j in range(7):
            name = f"a{a}l{j}"
            axis = ("0 0 1", "0 1 0")[j % 2]
            place = f"{0.5 - 0.3 * a} {0.3 * (-1) ** a} 0" if j == 0 else "0.15 0 0"
            parts += [_link(name, 1.0), _joint(f"a{a}j{j}", "revolute", above, name, place, axis)]
            above = name
        parts += [
            f"<link name='tool{a}'/>",
            _joint(f"a{a}tool", "fixed", above, f"tool{a}", "0.1 0 0", "1 0 0"),
        ]
    return "".join([*parts, "</robot>"])


def _link(name: str, mass: float) -> str:
    turn = f"ixx='{0.1 * mass}' iyy='{0.1 * mass}' izz='{0.1 * mass}' ixy='0' ixz='0' iyz='0'"
    return (
        f"<link name='{name}'><inertial><mass value='{mass}'/><inertia {turn}/></inertial></link>"
    )


def _joint(name: str, kind: str, above: str, below: str, place: str, axis: str) -> str:
    limit = ""
    if kind == "revolute":
        limit = "<limit lower='-2.5' upper='2.5' velocity='1' effort='20'/>"
    ends = f"<parent link='{above}'/><child link='{below}'/>"
    frame = f"<origin xyz='{place}'/><axis xyz='{axis}'/>"
    return f"<joint name='{name}' type='{kind}'>{ends}{frame}{limit}</joint>"


def _ticks(scenario: Scenario) -> Spent:
    """The second run: the layer of velocities, which is where sizes count."""
    scenario.run()
    return {"time_s": float(np.median(scenario.run()["tick_time"]))}


WORKS: dict[str, tuple[Callable[[int], Spent], Sequence[int]]] = {
    "plan, an iteration": (plan, (20, 40, 80, 200, 500, 640, 800, 1000, 2000)),
    "hierarchy": (hierarchy, (20, 40, 80, 160)),
    "hierarchy of a humanoid": (humanoid, (88,)),
    "cascade, random": (cascade, (13, 60)),
    "cascade, dependent rows": (dependent, (13,)),
    "cascade, control": (control, (16,)),
    "campaign of short runs": (campaign, (10, 100, 1000)),
    "set-up of runs": (setup, (10, 100, 1000)),
    "tick, obstacles": (obstacles, (3, 30, 300, 3000)),
    "tick, arms of seven joints": (arms, (1, 2, 3, 4)),
}
"""What is measured, at which sizes."""

if __name__ == "__main__":
    spent = WORKS[sys.argv[1]][0](int(sys.argv[2]))
    Path("spent").write_text(json.dumps(spent), encoding="utf-8")
