"""Plans among obstacles: how long they take, how many are free of collision, and whether any is so
called falsely.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from recording.report import Row
from recording.timing import Timed, once

from curves.capsules import capsule_robot
from curves.closed_forms import ClosedFormDistances
from curves.figure import figure
from curves.scenes import Problem, problem
from uvms_ocp.planning.distances import CoalDistances
from uvms_ocp.planning.soft_collision import CollisionPlan, plan_soft_collision
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.trajectories.segment_times import MotionLimits

COAL = "coal"
CLOSED_FORMS = "closed forms"
TARGETS = {COAL: ("0.3", "0.6"), CLOSED_FORMS: ("0.15", "")}
"""[s] targets of the median and of the largest time; empty for none."""


def plan_rows(n_scenes: int, solver: str) -> list[Row]:
    """Plan once in each scene, with distances by coal or in closed form; return the figures."""
    robot = load_robot("girona_maris7")
    if solver == CLOSED_FORMS:
        robot = capsule_robot(robot)
    problems = []
    timed_plans = []
    n_pairs = []
    for seed in range(n_scenes):
        item = problem(seed, robot=robot)
        problems.append(item)
        timed_plans.append(_planned(item, solver))
        n_pairs.append(item.scene.n_pairs)
    name = f"{n_scenes} scenes, 13 axes, 10 pieces"
    plans = [timed_plan.value for timed_plan in timed_plans]
    return [
        figure(name, solver, "median pairs", np.median(n_pairs), "30"),
        *_times(name, solver, timed_plans),
        *_outcomes(name, solver, problems, plans),
    ]


def _planned(item: Problem, solver: str) -> Timed[CollisionPlan]:
    """Plan in one scene and take the time."""
    robot = item.scene.coordinates.robot
    limits = MotionLimits(velocity=robot.limits.velocity, acceleration=robot.limits.acceleration)
    distances = ClosedFormDistances(item.scene) if solver == CLOSED_FORMS else None
    return once(
        lambda: plan_soft_collision(item.scene, item.ends, limits=limits, distances=distances)
    )


def _times(name: str, solver: str, plans: Sequence[Timed[CollisionPlan]]) -> Iterator[Row]:
    walls = [plan.wall for plan in plans]
    cpus = [plan.cpu for plan in plans]
    median, largest = TARGETS[solver]
    yield figure(name, solver, "median time [s]", float(np.median(walls)), median)
    yield figure(name, solver, "largest time [s]", max(walls), largest)
    yield figure(name, solver, "median processor time [s]", float(np.median(cpus)))
    yield figure(name, solver, "largest processor time [s]", max(cpus))


def _outcomes(
    name: str, solver: str, problems: Sequence[Problem], plans: Sequence[CollisionPlan]
) -> Iterator[Row]:
    n_free = 0
    n_false = 0
    n_at_first = 0
    for item, plan in zip(problems, plans, strict=True):
        n_at_first += plan.attempts == 1
        if plan.collision_free:
            n_free += 1
            n_false += _collides(item, plan)
    yield figure(name, solver, "success", n_free / len(plans), "0.95")
    yield figure(name, solver, "falsely free", n_false, "0")
    yield figure(name, solver, "success at first attempt", n_at_first / len(plans))


def _collides(item: Problem, plan: CollisionPlan) -> bool:
    """Check for collisions at samples ten times denser than those of the optimisation."""
    t = np.linspace(plan.trajectory.start, plan.trajectory.end, 1501)
    return bool(CoalDistances(item.scene).distances(plan.trajectory.evaluate(t)).min() <= 0.0)
