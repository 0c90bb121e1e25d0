"""Terms of a mission plan: what phases ask, energy, and distances to floor and obstacles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import casadi as ca
import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.mission import Below, Condition, Mission, Phase
from uvms_ocp.mission_plan import segments as mission_segments
from uvms_ocp.mission_plan.segments import HorizonSegment, Margins
from uvms_ocp.ocp import OcpLevel, Trajectory
from uvms_ocp.ocp.clearance_certificate import SteppedMotion, certificate, shortfall
from uvms_ocp.ocp.shape_clearance import ShapeClearance
from uvms_ocp.ocp.terms import (
    At,
    Duration,
    Effort,
    Energy,
    Smoothness,
    StageSymbols,
    TaskRows,
    TaskTerm,
    Term,
)
from uvms_ocp.planning.conservative_advancement import ClearanceReport
from uvms_ocp.planning.planned_axes import coordinates
from uvms_ocp.planning.scene import CollisionScene, collision_scene
from uvms_ocp.robot.link_boxes import box_corners
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.hull import skid_points
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.tasks import Clearance, JointTracking, LandingAltitude, MinimumAltitude, attitude
from uvms_ocp.tasks.pose import NullVelocity, PoseTask, ToolPosition
from uvms_ocp.tasks.task import Residual, Task, TaskClass, bounded_residual, zero_residual
from uvms_ocp.types import Bound, Mask

_ROWS: dict[tuple[type[Task], str], tuple[int, ...]] = {
    (PoseTask, "position_error"): (0, 1, 2),
    (PoseTask, "orientation_error"): (3, 4, 5),
    (PoseTask, "horizontal_error"): (0, 1),
    (ToolPosition, "position_error"): (0, 1, 2),
}
"""Rows of residuals whose norm is the quantity."""

_SMOOTHNESS_WEIGHT = 0.3  # what is free to swing would ring from node to node
_PREFERENCE_WEIGHT = 3e-4  # 0.3 W for 1 rad
_ROUNDING = 1e-6  # keeps the root of a sine differentiable where a cylinder stands upright
_LEVEL = 0.05  # [m] by which the height of a floor may differ along the way
_MISSED = 2e-3  # [m] of a margin that a plan may miss
_NEAR = 0.01  # [m] beyond its margin, within which a pair gets rows
_PAIR_ROWS = 4  # rows per node and pair of links


@checked_dataclass(eq=False)
class BoundedRows(TaskRows):
    """The residual of a task, of which some rows are looked at."""

    rows: tuple[int, ...]
    """Indices into the residual."""
    lower: Bound = -np.inf
    """[unit of the rows]"""
    upper: Bound = np.inf
    """[unit of the rows]"""

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        value = self.task.residual(stage.tick, parameters).value[list(self.rows)]
        return bounded_residual(value, lower=self.lower, upper=self.upper)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TaskPreference(TaskRows):
    """The residual of a task as a cost, not as something to be reached."""

    is_goal: ClassVar[bool] = False

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        return self.task.residual(stage.tick, parameters)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ZeroVelocities(Term):
    """Velocities are zero that nothing else keeps at zero."""

    name = "at rest"
    axes: tuple[int, ...]
    """Indices in v."""

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        return zero_residual(stage.tick.velocity[list(self.axes)])


@dataclass(frozen=True, kw_only=True, slots=True)
class ConditionPlacement:
    """Phase and segment in which a condition applies."""

    phase: str
    """Phase of the mission, for errors."""
    segment: str
    """Segment of the horizon."""
    at: At

    def rows(
        self, task: Task, rows: tuple[int, ...], lower: float = -np.inf, upper: float = np.inf
    ) -> BoundedRows:
        """Bound rows of the residual of a task, at least `lower` and at most `upper` [unit of the
        rows].
        """
        return BoundedRows(
            task=task, rows=rows, lower=lower, upper=upper, at=self.at, phase=self.segment
        )


def condition_term(
    tasks: Sequence[Task],
    condition: Condition,
    place: ConditionPlacement,
    margins: Margins,
    *,
    met: bool,
) -> Term:
    """Rows that make a condition hold, or where it is not to be `met`, fail.

    tasks: with the goals that they have in the phase. Raises `InvalidInput` where no residual
    states the quantity.
    """
    name, _, quantity = condition.quantity.rpartition(".")
    task = next((task for task in tasks if task.name == name), None)
    if task is None:
        raise _refused(condition, place, isinstance(condition, Below) is met)
    limit = condition.limit
    below = isinstance(condition, Below) is met
    if isinstance(task, attitude.AngleTask) and quantity in mission_segments.ANGLES and below:
        aim = mission_segments.tightened_limit(limit, margins.angle)
        return TaskTerm(task=replace(task, aim=aim), at=place.at, phase=place.segment)
    if isinstance(task, (LandingAltitude, MinimumAltitude)) and quantity == "altitude":
        return place.rows(task, (0,), *_heights(task, limit, margins.altitude, below))
    rows = _rows_of(task, quantity)
    if not (rows and below):
        raise _refused(condition, place, below)
    margin = margins.angle if quantity == "orientation_error" else margins.position
    # A box inside the ball that the condition asks for.
    half_width = mission_segments.tightened_limit(limit, margin) / np.sqrt(len(rows))
    return place.rows(task, rows, -half_width, half_width)


def _refused(condition: Condition, place: ConditionPlacement, below: bool) -> InvalidInput:
    request = (
        f"{condition.quantity} {'<' if below else '>'} {condition.limit:g}, which no residual"
        " states"
    )
    allowed = (
        "fly this mission without a plan, or look at the error of a pose, an angle or an altitude"
    )
    return InvalidInput(f"phase {place.phase!r} looks at {request}; {allowed}")


def _heights(
    task: LandingAltitude | MinimumAltitude, limit: float, margin: float, below: bool
) -> tuple[float, float]:
    """Return the range of the residual [m] for an altitude below the limit [m], or above."""
    if below:
        altitudes = (-np.inf, mission_segments.tightened_limit(limit, margin))
    else:
        altitudes = (limit + margin, np.inf)
    if isinstance(task, LandingAltitude):
        # Its residual is the altitude of rest less the altitude.
        lowest, highest = altitudes
        return (task.rest_altitude - highest, task.rest_altitude - lowest)
    return altitudes


def _rows_of(task: Task, quantity: str) -> tuple[int, ...]:
    """Return the rows of a task's residual whose norm is the quantity; none where there are none."""
    if isinstance(task, JointTracking) and quantity == "posture_error":
        return tuple(range(len(task.joints)))
    for (kind, name), rows in _ROWS.items():
        if isinstance(task, kind) and name == quantity:
            return rows
    return ()


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MissionTerms:
    """Terms of a whole mission."""

    goals: tuple[tuple[TaskClass, Term], ...]
    """Conditions that transitions wait for, with the class of the task that reaches them."""
    constraints: tuple[Term, ...]
    """Constraints that tasks of constraints and safety keep all along their phases."""
    preferences: tuple[Term, ...]
    """Preferences of tasks of optimization, for a small share of the last level."""


def mission_terms(
    robot: Robot,
    mission: Mission,
    way: Sequence[int],
    segments: Sequence[HorizonSegment],
    margins: Margins,
) -> MissionTerms:
    """Collect the terms of all phases. Raises `InvalidInput` for tasks and conditions that no
    residual states, by their names.
    """
    goals: list[tuple[TaskClass, Term]] = []
    constraints: list[Term] = []
    preferences: list[Term] = []
    established: set[str] = set()
    starts = np.cumsum([0.0, *(segment.ocp.nominal for segment in segments)])
    for k, index in enumerate(way):
        indices = [i for i, segment in enumerate(segments) if segment.phase == index]
        phase = _Phase(
            mission, way, k, [segments[i] for i in indices], float(starts[indices[0]]), margins
        )
        goals += phase.goals()
        constraints += [*phase.kept(established), *phase.not_triggered()]
        preferences += phase.preferences()
        established = phase.reached
    constraints += _rest(robot, phase.on)
    return MissionTerms(
        goals=tuple(goals), constraints=tuple(constraints), preferences=tuple(preferences)
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class MissionWeights:
    """Weights of the last level."""

    energy: float = 1.0
    """[1/kW]"""
    effort: float = 0.2
    """Weight of thrust and torque, in shares of their limits."""
    price: float = 1e-6
    """[kW] price of time."""


def mission_levels(
    robot: Robot, terms: MissionTerms, weights: MissionWeights
) -> tuple[OcpLevel, ...]:
    """Goals in the order of the classes of their tasks, then energy with a little smoothness, as
    far as it is known.
    """
    classes = sorted({kind for kind, _ in terms.goals})
    goal_levels = []
    for kind in classes:
        goals = [term for task_class, term in terms.goals if task_class is kind]
        goal_levels.append(OcpLevel(name=kind.name.lower(), terms=tuple(goals)))
    powers = [thruster.power for thruster in robot.description.thrusters]
    energy_terms: tuple[Term, ...] = () if None in powers else (Energy(weight=weights.energy),)
    spent = (
        *energy_terms,
        Effort(weight=weights.effort),
        Smoothness(weight=_SMOOTHNESS_WEIGHT),
        Duration(weight=weights.price),
    )
    return (*goal_levels, OcpLevel(name="energy", terms=(*spent, *terms.preferences)))


class _Phase:
    """One phase on the way, with its parts of the horizon."""

    def __init__(
        self,
        mission: Mission,
        way: Sequence[int],
        k: int,
        parts: Sequence[HorizonSegment],
        begin: float,
        margins: Margins,
    ) -> None:
        self._phase: Phase = mission.phases[way[k]]
        self._out = mission_segments.exit_transition(mission.phases, way, k)
        self._parts = parts
        self._margins = margins
        self._last = k + 1 == len(way)
        self.tasks = tuple(
            mission_segments.delay_task(task, self._phase, begin)
            for task in mission.tasks_of(way[k])
        )
        self.on = mission_segments.active_tasks(self._phase, self.tasks)
        self._asked = {condition.quantity.rpartition(".")[0] for condition in self._out.when}
        self.reached = {task.name for task in self.on if mission_segments.is_prerequisite(task)}

    def goals(self) -> Iterator[tuple[TaskClass, Term]]:
        """Yield the goals at the end of the phase, or all along what has to be held."""
        class_of_task = {task.name: task.task_class for task in self.tasks}
        for condition in self._out.when:
            name = condition.quantity.rpartition(".")[0]
            kind = class_of_task.get(name, TaskClass.ACTION)
            for part in self._parts:
                if part.holds:
                    yield kind, self._term(condition, part, At.PATH, met=True)
                if part.ends and not (part.holds and self._last):
                    yield kind, self._term(condition, part, At.END, met=True)

    def kept(self, established: set[str]) -> Iterator[Term]:
        """Yield the constraints of tasks all along the phase. established: names of prerequisites
        that the phase before has reached.
        """
        constraints = mission_segments.active_constraints(
            self._phase, self.on, self._out, established, self._margins
        )
        for task in constraints:
            for part in self._parts:
                is_held_by_goal = part.holds and task.name in self._asked
                if task.name not in part.waits_for and not is_held_by_goal:
                    yield TaskTerm(task=task, at=At.PATH, phase=part.ocp.name)

    def preferences(self) -> Iterator[Term]:
        """Yield the preferences of equality tasks of the lowest class that no transition waits
        for.
        """
        for task in self.on:
            is_preference = task.task_class is TaskClass.OPTIMIZATION and task.equality
            if not is_preference or task.name in self._asked:
                continue
            for part in self._parts:
                yield TaskPreference(
                    task=task, at=At.PATH, phase=part.ocp.name, weight=_PREFERENCE_WEIGHT
                )

    def not_triggered(self) -> Iterator[Term]:
        """Yield for every other way out of the phase the constraint that one of its conditions
        fails all along.
        """
        for transition in self._phase.transitions:
            if transition is not self._out:
                yield from self._prevented(transition.when)

    def _prevented(self, conditions: Sequence[Condition]) -> Iterator[Term]:
        refused = None
        for condition in conditions:
            try:
                terms = [self._term(condition, part, At.PATH, met=False) for part in self._parts]
            except InvalidInput as error:
                refused = error
                continue
            yield from terms
            return
        assert refused is not None
        raise refused

    def _term(self, condition: Condition, part: HorizonSegment, at: At, *, met: bool) -> Term:
        place = ConditionPlacement(phase=self._phase.name, segment=part.ocp.name, at=at)
        return condition_term(self.tasks, condition, place, self._margins, met=met)


def _rest(robot: Robot, tasks: Sequence[Task]) -> Iterator[Term]:
    """Yield the rest at the very end, but for what a task keeps at rest anyway."""
    resting_axes = {axis for task in tasks if isinstance(task, NullVelocity) for axis in task.axes}
    axes = tuple(axis for axis in range(robot.n_v) if axis not in resting_axes)
    if axes:
        yield ZeroVelocities(axes=axes)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rim:
    """A point, or a circle around it, fixed to a joint: the end of a shape."""

    joint: int
    centre: np.ndarray
    """(3,) [m] centre in the frame of the joint."""
    axis: np.ndarray
    """(3,) normal of the circle, in the same frame."""
    radius: float = 0.0
    """[m] radius of the circle."""
    rounding: float = 0.0
    """[m] radius of a ball around the point."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FloorClearance(Term):
    """One row per rim: its lowest point above `height` [m]."""

    name = "floor"
    at: At = At.PATH
    rims: tuple[Rim, ...]
    height: float
    """[m] height in W of the floor and the margin above it."""

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        rows = []
        for rim in self.rims:
            pose = stage.tick.kinematics.joint_poses[rim.joint]
            upright = (pose.R @ ca.DM(rim.axis))[2]
            sag = rim.radius * ca.sqrt(ca.fmax(1 - upright**2, 0) + _ROUNDING)
            rows.append((pose.p + pose.R @ ca.DM(rim.centre))[2] - sag - rim.rounding)
        return bounded_residual(ca.vertcat(ca.SX(0, 1), *rows), lower=self.height)


def rims_of(robot: Robot) -> tuple[Rim, ...]:
    """Return the rims of the lower side of the hull, and of every shape of the arm."""
    rims = [Rim(joint=1, centre=point, axis=np.zeros(3)) for point in skid_points(robot)]
    first_arm_joint = 2 if robot.n_vehicle else 1
    for shape in robot.collision_model.geometryObjects:
        if shape.parentJoint >= first_arm_joint:
            rims += _rims(shape)
    return tuple(rims)


def _rims(shape: pin.GeometryObject) -> list[Rim]:
    """Return the ends of a shape: of a box its corners."""
    geometry = shape.geometry
    joint = shape.parentJoint
    X = shape.placement
    no_axis = np.zeros(3)
    if isinstance(geometry, coal.Sphere):
        return [Rim(joint=joint, centre=X.translation, axis=no_axis, rounding=geometry.radius)]
    if isinstance(geometry, coal.Cylinder | coal.Capsule):
        is_rounded = isinstance(geometry, coal.Capsule)
        rims = []
        for side in (-1, 1):
            rim = Rim(
                joint=joint,
                centre=X.act(np.array([0.0, 0.0, side * geometry.halfLength])),
                axis=X.rotation[:, 2],
                radius=0.0 if is_rounded else geometry.radius,
                rounding=geometry.radius if is_rounded else 0.0,
            )
            rims.append(rim)
        return rims
    corners = box_corners(geometry)
    return [Rim(joint=joint, centre=X.act(corner), axis=no_axis) for corner in corners]


def floor_along(scenario: Scenario, way: mission_segments.GreedyRollout) -> float:
    """Return the height [m] of the floor below the way; raises `InvalidInput` where it is not
    level.
    """
    if not scenario.robot.n_vehicle:
        return -np.inf
    heights = [scenario.environment.seafloor.height(float(x), float(y)) for x, y in way.q[:, :2]]
    low = min(heights)
    high = max(heights)
    if high - low > _LEVEL:
        problem = f"the floor rises by {high - low:.2g} m along the way"
        raise InvalidInput(f"{problem}; a plan needs one that is level within {_LEVEL:g} m")
    return high


def floor_terms(
    scenario: Scenario, segments: Sequence[HorizonSegment], floor: float, margins: Margins
) -> list[Term]:
    """Keep hull and arm above the floor [m] wherever no task on altitude keeps the robot far from
    it.
    """
    if not np.isfinite(floor):
        return []
    rims = rims_of(scenario.robot)
    terms = list[Term]()
    for segment in segments:
        phase = scenario.mission.phases[segment.phase]
        on = mission_segments.active_tasks(phase, scenario.mission.hierarchy.tasks)
        keeps_altitude = any(
            isinstance(task, MinimumAltitude) and task.name not in segment.waits_for for task in on
        )
        if not keeps_altitude:
            height = floor + margins.altitude
            terms.append(FloorClearance(rims=rims, height=height, phase=segment.ocp.name))
    return terms


def clearance(scenario: Scenario, margins: Margins) -> ShapeClearance | None:
    """Keep the robot away from obstacles and from itself, each pair by as much as tasks of the
    mission ask for it.

    Links that are near each other by design keep half of what they have at rest, and at the start
    what they have there.
    """
    scene = collision_scene(
        coordinates(scenario.robot, reference=scenario.start), scenario.environment.obstacles
    )
    if not scene.pairs:
        return None
    largest_threshold: dict[str, float] = {}
    for task in scenario.mission.hierarchy.tasks:
        if isinstance(task, Clearance):
            for name in task.model.pair_names:
                known = largest_threshold.get(name, -np.inf)
                largest_threshold[name] = max(task.threshold, known)
    thresholds = [largest_threshold.get(pair.name, 0.0) for pair in scene.pairs]
    minimum_margins = np.where(_links(scene), margins.links, margins.position)
    pair_margins = np.minimum(np.maximum(minimum_margins, thresholds), scene.room)
    return ShapeClearance(scene=scene, margins=pair_margins)


def _links(scene: CollisionScene) -> Mask:
    """Return True for pairs (n_pairs,) of two links."""
    return np.isfinite(scene.room)


def obstacle_pairs(shapes: ShapeClearance) -> ShapeClearance:
    """Select the pairs with obstacles."""
    return _among(shapes, ~_links(shapes.scene))


def link_pairs(shapes: ShapeClearance, pairs: Mask) -> ShapeClearance:
    """Select the chosen (n_pairs,) pairs of links, with rows of their own."""
    return replace(_among(shapes, pairs), n_pair_rows=_PAIR_ROWS)


def _among(shapes: ShapeClearance, pairs: Mask) -> ShapeClearance:
    return replace(
        shapes,
        scene=shapes.scene.among(np.flatnonzero(pairs).tolist()),
        margins=shapes.margins[pairs],
    )


def violated_links(shapes: ShapeClearance, way: Trajectory) -> Mask:
    """Return True for pairs (n_pairs,) of links that do not keep their margins along a way, at its
    nodes and between them.
    """
    return (shortfall(shapes, way, 0.0).max(axis=0) > _MISSED) & _links(shapes.scene)


def near_links(shapes: ShapeClearance, way: Trajectory) -> Mask:
    """Return True for pairs (n_pairs,) of links that nearly miss their margins along a way."""
    return violated_links(replace(shapes, margins=shapes.margins + _NEAR), way)


def certify_along(shapes: ShapeClearance, way: Trajectory) -> ClearanceReport:
    """Certify that all pairs stay apart along a way, with the smallest distance that is met, at its
    nodes too.
    """
    report = certificate(shapes, way)
    sampled = SteppedMotion(term=shapes, trajectory=way).nearest()
    if sampled.distance < report.nearest.distance:
        return replace(report, nearest=sampled)
    return report
