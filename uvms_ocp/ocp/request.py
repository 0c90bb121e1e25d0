"""Plan by optimal control from a request: with water, thrusters and torques, among obstacles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Annotated

import numpy as np

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.interrupts import Interrupted
from uvms_ocp.ocp.motion_record import sample_times
from uvms_ocp.ocp.plan import OcpStatus, Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.shape_clearance import ShapeClearance
from uvms_ocp.ocp.start_checks import check_goal, goal_distances, start_distances
from uvms_ocp.ocp.terms import AtRest, Effort, Posture, Smoothness, TaskTerm, Term
from uvms_ocp.ocp.trajectory import Trajectory, admissible_configurations, guess_through, hold_guess
from uvms_ocp.planning.distances import CoalDistances
from uvms_ocp.planning.planned_axes import Coordinates, coordinates
from uvms_ocp.planning.request import (
    FiniteTriple,
    Goal,
    PlanRequest,
    PostureGoal,
    check_goal_distance,
    plan_path,
)
from uvms_ocp.planning.scene import CollisionScene, NearestPair, collision_scene
from uvms_ocp.robot import Robot, State
from uvms_ocp.robot.shapes.obstacles import Obstacle, seafloor
from uvms_ocp.solvers.nlp.options import AUTO, NlpOptions
from uvms_ocp.solvers.nlp.solve_monitor import Progress
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial
from uvms_ocp.types import DAY, Array, AtLeastOne, Bound, Magnitude, Positive, Range, Shape

_CURVE_SAMPLES = 200
# of IPOPT, which leaves the curve behind with more of it: plans roll over on their way
_BARRIER = 1e-4
# Shares of the distances at start and goal that are kept where more is asked; arms are stowed close
# by design.
_SHARE_OF_LINKS = 0.75
_SHARE_OF_OBSTACLES = 0.99


@checked_dataclass(eq=False)
class OcpRequest:
    """Request for a motion: first the goal, at rest and within all limits, then little effort on
    smooth paths.
    """

    robot: Robot
    start: Annotated[Array, Shape("robot.n_q"), Range(open=True)]
    """(n_q,) [m, rad] configuration."""
    goal: Goal
    obstacles: tuple[Obstacle, ...] = ()
    clearance: Magnitude = 0.06
    """[m] kept from obstacles, and between links. What is nearer at start or goal keeps what it has
    there, of the robot's own links three quarters.
    """
    link_clearance: Magnitude | None = None
    """[m] kept between links instead."""
    seabed: Bound = -np.inf
    """[m] height in W of a level floor to keep clear of; none by default."""
    duration: Positive = 8.0
    """[s] length of the motion."""
    n_steps: AtLeastOne = 40
    current: FiniteTriple = (0.0, 0.0, 0.0)
    """[m/s] Velocity of the water in W."""
    plugin: str = AUTO
    time_limit: Positive = DAY
    """[s] time limit of the solver; by default its iterations end it, however busy the machine is.
    """


@checked_dataclass(slots=False, eq=False)
class OcpResult:
    """The plan, and what its true shapes keep from each other; of a plan that is not usable that
    means nothing.
    """

    request: OcpRequest
    scene: CollisionScene
    plan: Plan

    @cached_property
    def samples(self) -> tuple[Array, Array]:
        """Times (n,) [s], and configurations (n, n_q) [m, rad] on their manifold, within the limits
        of the joints.
        """
        robot = self.request.robot
        t = sample_times(self.plan.duration)
        q, _, _ = self.plan.trajectory.states_at(robot.model, t)
        return t, admissible_configurations(robot, q)

    @cached_property
    def coordinates(self) -> Array:
        """(n, n_axes) [m, rad] coordinates of the scene at the samples."""
        _, configurations = self.samples
        return np.array([self.scene.coordinates.x_beyond_limits(q) for q in configurations])

    @cached_property
    def distances(self) -> Array:
        """(n, n_pairs) [m] of all pairs of shapes at the samples."""
        return CoalDistances(self.scene).distances(self.coordinates)

    @property
    def nearest(self) -> NearestPair:
        """The smallest distance at any sample."""
        t, _ = self.samples
        return self.scene.nearest(t, self.distances)

    @property
    def collision_free(self) -> bool:
        """True if it is proven that no two shapes touch, between samples and nodes too."""
        return not self.scene.pairs or self.plan.certified_free


@checked
def solve_ocp(request: OcpRequest, *, progress: Progress | None = None) -> OcpResult:
    """Plan by lexicographic optimal control, from a guess around the obstacles where there are
    some.

    progress is told every iteration of the solver. Ctrl-C raises `Interrupted`, whose `result` is
    the best so far.

    Raises `NameNotFound` for an unknown joint, frame or NLP solver, `InvalidInput` for a goal
    outside limits, a start or goal in collision, two obstacles of one name, and numbers out of
    their range.
    """
    check_goal_distance(request.robot, request.start, request.goal)
    planned = coordinates(request.robot, reference=request.start)
    floor: tuple[Obstacle, ...] = ()
    if np.isfinite(request.seabed):
        floor = (seafloor(request.seabed),)
    scene = collision_scene(planned, (*request.obstacles, *floor))
    problem = _problem(request, scene)
    scene.check_no_overlap(start_distances(scene, request.start), "the start")
    check_goal(scene, request.goal, request.start)
    try:
        plan = _planned(request, problem, progress)
    except Interrupted as stop:
        stop.result = OcpResult(request=request, scene=scene, plan=stop.result)
        raise
    return OcpResult(request=request, scene=scene, plan=plan)


def _planned(request: OcpRequest, problem: OcpProblem, progress: Progress | None) -> Plan:
    """Return the first plan that is solved and proven free, or else the best, of the guesses and
    then of shorter steps.
    """
    plans: list[Plan] = []
    options = NlpOptions()
    if request.obstacles:
        options = NlpOptions(barrier=_BARRIER)
    options = replace(options, plugin=request.plugin, time_limit=request.time_limit)
    for refinement in (1, 2):
        phase = replace(problem.phases[0], n_steps=refinement * request.n_steps)
        refined = replace(problem, phases=(phase,))
        planner = Planner(refined, options)
        for guess in _guesses(request, refined):
            try:
                plan = planner.plan(guess=guess, progress=progress)
            except Interrupted as stop:
                stop.result = _best([*plans, stop.result])
                raise
            plans.append(plan)
            if _is_proven(plan):
                return plan
        touches_between_nodes = any(plan.status.usable and not _is_free(plan) for plan in plans)
        if not touches_between_nodes:
            break  # shorter steps would mend nothing else
    return _best(plans)


def _best(plans: Sequence[Plan]) -> Plan:
    """Return the first of the best plans."""

    def rank(plan: Plan) -> tuple[bool, bool, bool]:
        usable = plan.status.usable
        return (usable and _is_free(plan), usable, _is_proven(plan))

    return max(plans, key=rank)


def _is_proven(plan: Plan) -> bool:
    return plan.status is OcpStatus.SOLVED and _is_free(plan)


def _is_free(plan: Plan) -> bool:
    return plan.clearance is None or plan.certified_free


def _guesses(request: OcpRequest, problem: OcpProblem) -> Iterator[Trajectory]:
    """Yield a curve around obstacles if there are any; then the start, held."""
    if request.obstacles:
        has_attitude = isinstance(request.goal, PostureGoal) and request.goal.rpy is not None
        curve_request = PlanRequest(
            robot=request.robot,
            start=request.start,
            goal=request.goal,
            obstacles=request.obstacles,
            clearance=request.clearance,
            link_clearance=request.link_clearance,
            axes="all" if has_attitude else "level",
        )
        curve = curve_guess(problem, curve_request)
        if curve is not None:
            yield curve
    yield hold_guess(problem)


def _problem(request: OcpRequest, scene: CollisionScene) -> OcpProblem:
    """Write the request as levels: the goal, then little effort on smooth paths."""
    robot = request.robot
    tasks = request.goal.as_tasks(request.robot, request.start)
    constraints: tuple[Term, ...] = (AtRest(),)
    if scene.pairs:
        constraints = (
            AtRest(),
            ShapeClearance(scene=scene, margins=_margins(request, scene)),
        )
    return single_phase(
        robot=robot,
        start=State(q=request.start, v=np.zeros(robot.n_v)),
        duration=request.duration,
        n_steps=request.n_steps,
        levels=[
            OcpLevel(name="goal", terms=tuple(TaskTerm(task=task) for task in tasks)),
            OcpLevel(
                name="effort",
                terms=(Effort(), Smoothness(weight=0.09), Posture(q=request.start, weight=4.0)),
            ),
        ],
        constraints=constraints,
        current=np.asarray(request.current, dtype=float),
        water=bool(robot.hydrodynamics),
    )


def _margins(request: OcpRequest, scene: CollisionScene) -> Array:
    """Return the margins (n_pairs,) [m] that are asked for, or less where start or goal have
    less.
    """
    requested = scene.per_pair(request.clearance, request.link_clearance)
    at_start = start_distances(scene, request.start)
    at_goal = goal_distances(scene, request.goal, request.start)
    shares = scene.per_pair(_SHARE_OF_OBSTACLES, _SHARE_OF_LINKS)
    return np.minimum(requested, np.minimum(at_start, at_goal) * shares)


@checked
def along_curve(
    problem: OcpProblem, coordinates: Coordinates, curve: PiecewisePolynomial
) -> Trajectory:
    """Guess along a curve of coordinates, at the pace that ends with the problem's nominal time."""
    t = np.linspace(curve.start, curve.end, _CURVE_SAMPLES)
    share = (t - curve.start) / (curve.end - curve.start)
    times = share * problem.nominal_times()[-1]
    return guess_through(problem, times, coordinates.configurations(curve.evaluate(t)))


def curve_guess(problem: OcpProblem, request: PlanRequest) -> Trajectory | None:
    """Guess along the curve that the request asks for; `None` where no curve is free of
    collision.
    """
    try:
        path = plan_path(request)
    except InvalidInput:
        # What a curve cannot do, such as a goal of some joints alone, is no mistake of the request.
        return None
    if path.plan is None or not path.plan.collision_free:
        return None
    return along_curve(problem, path.scene.coordinates, path.plan.trajectory)
