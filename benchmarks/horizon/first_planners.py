"""Planners of one robot built and asked one after the other in a process of their own, each once
nothing is compiled any more.

    python first_planners.py STEPS RESULT.json

The cache is that of ``UVMS_OCP_CACHE``, empty at first. Spheres, goals and their words are those of
`first_answer`.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
import pinocchio as pin
from first_answer import GOAL, SPHERES, START, TURN, seconds_until_quiet

from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.shape_clearance import ShapeClearance
from uvms_ocp.ocp.terms import AtRest, Effort, Posture, Smoothness, TaskTerm, residual_term
from uvms_ocp.planning.distances import CoalDistances
from uvms_ocp.planning.planned_axes import coordinates
from uvms_ocp.planning.scene import collision_scene
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.obstacles import parse_obstacle
from uvms_ocp.robot.signals import State
from uvms_ocp.tasks.pose import ToolPose, ToolPosition

_CLEARANCE = 0.06  # [m] that is kept, where start and goal have so much
_KEPT = 0.7  # share of the clearance of the start that is kept, where it has less
_LEVEL = "no lean at the end"
_LEAN = 0.1  # [-] of the quaternion's components that lean


def problems(robot: Robot, steps: int) -> Iterator[tuple[str, OcpProblem]]:
    """One after the other, each with what it has that was not there before."""
    last = _reach(robot, steps, 2, TURN)
    yield "first problem of the robot", _reach(robot, steps, 1, None)
    yield "one more sphere", _reach(robot, steps, 2, None)
    yield "another term", last
    lean = residual_term(_LEVEL, lambda stage: stage.tick.q[3:5], lower=-_LEAN, upper=_LEAN)
    yield "and a term of one's own", replace(last, constraints=(*last.constraints, lean))
    yield "the same again", _reach(robot, steps, 2, TURN)


def _reach(
    robot: Robot, steps: int, n_spheres: int, turn: tuple[float, float, float] | None
) -> OcpProblem:
    q = robot.configuration(position=START)
    spheres = []
    for i, words in enumerate(SPHERES[:n_spheres], 1):
        spheres.append(parse_obstacle("sphere", words, f"sphere{i}"))
    scene = collision_scene(coordinates(robot, reference=q), spheres)
    margins = np.minimum(_CLEARANCE, _KEPT * CoalDistances(scene).distances_at(q[None])[0])
    task: ToolPosition | ToolPose
    if turn is None:
        task = ToolPosition(goal=pin.SE3(np.eye(3), np.array(GOAL)))
    else:
        task = ToolPose(goal=pin.SE3(pin.rpy.rpyToMatrix(*turn), np.array(GOAL)))
    return single_phase(
        robot=robot,
        start=State(q=q, v=np.zeros(robot.n_v)),
        duration=8.0,
        n_steps=steps,
        levels=[
            OcpLevel(name="goal", terms=(TaskTerm(task=task),)),
            OcpLevel(
                name="effort", terms=(Effort(), Smoothness(weight=0.09), Posture(q=q, weight=4.0))
            ),
        ],
        constraints=(AtRest(), ShapeClearance(scene=scene, margins=margins)),
    )


def main() -> None:
    """Measure, and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("steps", type=int)
    parser.add_argument("result", type=Path)
    arguments = parser.parse_args()
    cache = Path(os.environ["UVMS_OCP_CACHE"])
    rows = []
    for step, problem in problems(load_robot("girona_maris7_full"), arguments.steps):
        before = set(cache.glob("*.so"))
        begin = perf_counter()
        processor = process_time()
        planner = Planner(problem)
        built = perf_counter()
        processor = process_time() - processor
        plan = planner.plan(diagnose=False)
        solved = perf_counter()
        rows.append(
            {
                "step": step,
                "status": plan.status.value,
                "build_s": built - begin,
                "build_processor_s": processor,
                "solve_s": solved - built,
                "behind_s": seconds_until_quiet(cache),
                "libraries": len(set(cache.glob("*.so")) - before),
            }
        )
    arguments.result.write_text(json.dumps(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
