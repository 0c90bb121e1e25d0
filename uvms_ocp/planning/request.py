"""Plan a motion among obstacles from a request: start, goal (a tool pose by inverse kinematics, or
a posture), obstacles.

A goal says itself what it means for a path in planned axes, and for optimal control with tasks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from math import remainder
from typing import Annotated, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked, checked_dataclass, finite_array
from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.planning.conservative_advancement import PairDistances
from uvms_ocp.planning.distances import CoalDistances
from uvms_ocp.planning.path_cost import CostWeights
from uvms_ocp.planning.planned_axes import VEHICLE_AXES, Coordinates, coordinates, joint_axis
from uvms_ocp.planning.rrt_connect import SamplingOptions
from uvms_ocp.planning.scene import CollisionScene, collision_scene
from uvms_ocp.planning.soft_collision import (
    CollisionPlan,
    SoftCollisionOptions,
    plan_soft_collision,
)
from uvms_ocp.robot import Kinematics, Obstacle, Robot
from uvms_ocp.robot.limits import held_joints
from uvms_ocp.tasks import JointTracking, Task, ToolPose, ToolPosition, VehiclePose
from uvms_ocp.trajectories import MotionLimits, PiecewisePolynomial
from uvms_ocp.types import Array, Count, Finite, Mask, Positive, Range, Shape

Triple: TypeAlias = tuple[float, float, float]
FiniteTriple: TypeAlias = tuple[Finite, Finite, Finite]
_SAME_PLACE = 1e-9  # [m or rad] difference between a goal and a start that is none
_FARTHEST = 1e4  # [m] from the start that a goal may be
_MOST_TURN = 4 * np.pi  # [rad]
AXES = ("level", "all", "joints")
"""Planned axes: all but roll and pitch, all, or the joints alone."""
# Velocities along a curve are sampled so often; their peak is 1e-4 higher at most.
_VELOCITY_SAMPLES = 1000


@checked_dataclass()
class ToolGoalOptions:
    """Settings of ``tool_goal``."""

    tolerance: float = 1e-6
    """[m, rad] error that counts as reached."""
    iterations: int = 100
    attempts: int = 80
    """The guess given, then random ones around it, farther and farther."""
    spread: float = 0.5
    """[m or rad] of the first random guesses; the last are five times as far, to come from another
    side.
    """
    clearance: float = 0.005
    """[m] that the goal keeps from everything."""
    damping: float = 1e-3
    """With lengths in m: added to the diagonal of the normal matrix, times the squared error where
    that is less than 1.
    """
    seed: Count = 0


@checked
def tool_goal(
    distances: PairDistances,
    frame: str,
    goal: pin.SE3 | ArrayLike,
    guess: ArrayLike,
    options: ToolGoalOptions | None = None,
) -> Array | None:
    """Coordinates (n_axes,) [m, rad] within limits and clear of collision with the frame at its
    goal, or None if none found.

    The goal is a pose X_WF, or a position p_WF (3,) [m] with any orientation; guess (n_axes,) [m,
    rad]: where the search begins. Plan without roll and pitch (``coordinates(robot, axes=...)``) to
    keep the vehicle level. Raises `FrameNotFound` where the robot has no such frame, `InvalidInput`
    for a guess or goal of the wrong shape or not finite.
    """
    settings = options or ToolGoalOptions()
    planned = distances.scene.coordinates
    frame_id = planned.robot.frame_id(frame)
    first = finite_array("guess", guess, (planned.n_axes,))
    if isinstance(goal, pin.SE3):
        target = goal
    else:
        target = finite_array("goal, a pose (pin.SE3) or a position", goal, (3,))
    rng = np.random.default_rng(settings.seed)
    for attempt in range(settings.attempts):
        spread = settings.spread * (1.0 + 4.0 * attempt / settings.attempts) if attempt else 0.0
        x = _reached(
            planned, frame_id, target, first + spread * rng.normal(size=first.size), settings
        )
        if x is not None and distances.distances(x[None]).min(initial=np.inf) > settings.clearance:
            return x
    return None


def _reached(
    planned: Coordinates,
    frame_id: int,
    goal: pin.SE3 | Array,
    start: Array,
    options: ToolGoalOptions,
) -> Array | None:
    """Damped Gauss-Newton on the logarithm of the error, clipped to the limits at every step."""
    (lower, upper) = planned.limits()
    x = start
    for _ in range(options.iterations):
        x = np.clip(x, lower, upper)
        error, jacobian = _error(planned, frame_id, goal, x)
        if np.abs(error).max() <= options.tolerance:
            return x
        normal = jacobian @ jacobian.T + options.damping * min(1.0, float(error @ error)) * np.eye(
            error.size
        )
        x = x + jacobian.T @ np.linalg.solve(normal + 1e-12 * np.eye(error.size), error)
    return None


def _error(
    planned: Coordinates, frame_id: int, goal: pin.SE3 | Array, x: Array
) -> tuple[Array, Array]:
    """Twist (6,), or velocity (3,), that takes the frame to the goal in one second, and its
    Jacobian, in the frame.
    """
    model = planned.robot.model
    data = planned.robot.model.createData()
    q = planned.configurations(x[None])[0]
    pin.framesForwardKinematics(model, data, q)
    jacobian: Array = (
        pin.computeFrameJacobian(model, data, q, frame_id, pin.LOCAL)
        @ planned.velocity_map(x[None])[0]
    )
    X_WF = data.oMf[frame_id]
    if isinstance(goal, pin.SE3):
        return pin.log6(X_WF.actInv(goal)).vector, jacobian
    return X_WF.actInv(goal), jacobian[:3]


@checked_dataclass()
class ToolGoal:
    """A frame of the robot at a place. Raises `InvalidInput` for numbers that are not finite."""

    position: FiniteTriple
    """[m] p_WF."""
    rpy: FiniteTriple | None = None
    """[rad] Roll, pitch, yaw of R_WF; None for any orientation."""
    frame: str = "tool"

    def __post_init__(self) -> None:
        _check_turn(self.rpy)

    @property
    def target(self) -> pin.SE3 | Array:
        """X_WF, or p_WF (3,) [m]."""
        p = np.array(self.position)
        if self.rpy is None:
            return p
        return pin.SE3(pin.rpy.rpyToMatrix(np.array(self.rpy)), p)

    def as_coordinates(self, distances: PairDistances, *, seed: int) -> Array | None:
        """Planned axes (n_axes,) [m, rad] with the frame at its goal and nothing touching, or None
        where no posture was found.

        Raises `FrameNotFound` where the robot has no such frame.
        """
        planned = distances.scene.coordinates
        start = planned.reference[planned.planned]
        goal = tool_goal(distances, self.frame, self.target, start, ToolGoalOptions(seed=seed))
        if goal is None:
            return None
        return planned.shortest_turn(goal, start)

    def as_tasks(self, robot: Robot, start: Array) -> tuple[Task, ...]:
        """The task that has the goal as its own, wherever the start (n_q,) [m, rad] is.

        Raises `FrameNotFound` where the robot has no such frame.
        """
        robot.frame_id(self.frame)
        if isinstance(self.target, pin.SE3):
            return (ToolPose(frame=self.frame, goal=self.target),)
        return (ToolPosition(frame=self.frame, goal=pin.SE3(np.eye(3), self.target)),)


@checked_dataclass()
class PostureGoal:
    """A posture of the vehicle and joints; what is left out stays as at the start.

    Raises `InvalidInput` for angles beyond two turns.
    """

    position: FiniteTriple | None = None
    """[m] of the vehicle."""
    rpy: FiniteTriple | None = None
    """[rad] Roll, pitch, yaw of the vehicle."""
    joints: Mapping[str, float] = field(default_factory=dict)
    """[m or rad] by name."""

    def __post_init__(self) -> None:
        _check_turn(self.rpy)

    def as_coordinates(self, distances: PairDistances, *, seed: int) -> Array:
        """Planned axes (n_axes,) [m, rad] at the goal.

        Raises `NameNotFound` for an axis that the robot does not have, `InvalidInput` for a number
        that is not finite and for a goal away from the start on an axis that is not planned.
        """
        planned = distances.scene.coordinates
        all_axes = coordinates(planned.robot)
        goal = planned.reference.copy()
        for name, value in self._axes(planned.robot).items():
            require_known("axis", name, all_axes.names)
            if not np.isfinite(value):
                raise InvalidInput(f"the goal has {name} = {value}; give a finite number.")
            goal[all_axes.names.index(name)] = value
        goal = all_axes.shortest_turn(goal, planned.reference)
        for name, was, value in zip(all_axes.names, planned.reference, goal, strict=True):
            if name not in planned.names and abs(value - was) > _SAME_PLACE:
                change = (
                    f"the goal moves {name} from {was:.6g} to {value:.6g}, but the planned axes are"
                )
                raise InvalidInput(
                    f"{change} {', '.join(planned.names)}; leave it where it is, or plan all axes."
                )
        return np.asarray(goal[planned.planned])

    def _axes(self, robot: Robot) -> dict[str, float]:
        """Values of the axes that the goal names; of an attitude those with a pitch within a
        quarter turn.
        """
        place = dict(zip(VEHICLE_AXES[:3], self.position or (), strict=False))
        rpy = self.rpy
        if rpy is not None and np.isfinite(rpy).all():
            rpy = pin.rpy.matrixToRpy(pin.rpy.rpyToMatrix(np.array(rpy))).tolist()
        attitude = dict(zip(VEHICLE_AXES[3:], rpy or (), strict=False))
        return {
            **place,
            **attitude,
            **{joint_axis(robot, name): value for name, value in self.joints.items()},
        }

    def as_tasks(self, robot: Robot, start: Array) -> tuple[Task, ...]:
        """Tasks of the vehicle and of the joints that the goal names; start (n_q,) [m, rad]:
        configuration.

        Raises `NameNotFound` for a joint that the robot does not have, `InvalidInput` for values
        outside limits and for a goal of the vehicle where there is none.
        """
        q = robot.configuration(position=self.position, rpy=self.rpy, joints=dict(self.joints))
        tasks: list[Task] = []
        if self.position is not None or self.rpy is not None:
            start_pose = Kinematics(robot, start).pose("base_link")
            goal_pose = Kinematics(robot, q).pose("base_link")
            position = start_pose.translation if self.position is None else goal_pose.translation
            tasks.append(
                VehiclePose(
                    goal=pin.SE3((start_pose if self.rpy is None else goal_pose).rotation, position)
                )
            )
        if self.joints:
            tasks.append(
                JointTracking(joints=tuple(self.joints), goal=np.array(list(self.joints.values())))
            )
        return tuple(tasks)


Goal: TypeAlias = ToolGoal | PostureGoal


def check_goal_distance(robot: Robot, start: Array, goal: Goal) -> None:
    """Raise `InvalidInput` for a goal that is very far from the start (n_q,) [m, rad]: plans are
    sampled densely.
    """
    if goal.position is None or not np.isfinite(goal.position).all():
        return  # said by others, with the axis
    if robot.n_vehicle:
        start_position = start[:3]
    else:
        start_position = np.zeros(3)
    # Within what can be squared.
    way = float(
        np.linalg.norm(np.clip(goal.position, -1e99, 1e99) - np.clip(start_position, -1e99, 1e99))
    )
    if way > _FARTHEST:
        text = (
            f"the goal {tuple(goal.position)} m is {way:.3g} m from the start; give one within"
            f" {_FARTHEST:g} m"
        )
        raise InvalidInput(f"{text}: a plan is proven clear every few centimetres, in memory")


def _check_turn(rpy: Triple | None) -> None:
    if rpy is not None and np.isfinite(rpy).all() and np.abs(rpy).max() > _MOST_TURN:
        raise InvalidInput(
            f"roll, pitch and yaw of the goal are {rpy} rad; give angles within two turns,"
            f" {_MOST_TURN:.4g} rad"
        )


@checked_dataclass(eq=False)
class PlanRequest:
    """Request for a path: start, goal, obstacles and options."""

    robot: Robot
    start: Annotated[Array, Shape("robot.n_q"), Range(open=True)]
    """(n_q,) [m, rad] configuration."""
    goal: Goal
    obstacles: tuple[Obstacle, ...] = ()
    axes: str = AXES[0]
    clearance: Positive = 0.06
    """[m] wanted from obstacles, and between links; what is verified is that nothing touches."""
    link_clearance: Positive | None = None
    """[m] wanted between links instead."""
    seed: Count = 0


@checked_dataclass(eq=False)
class PlanResult:
    """The scene that was built, and the plan; None where no posture reaches the tool's goal."""

    request: PlanRequest
    scene: CollisionScene
    plan: CollisionPlan | None

    @property
    def collision_free(self) -> bool:
        return self.plan is not None and self.plan.collision_free


@checked
def plan_path(request: PlanRequest) -> PlanResult:
    """Find the goal in planned axes, then a collision-free path to it.

    Raises `NameNotFound` for unknown axes, joints or frames, `InvalidInput` for a start or goal in
    collision or outside limits, a goal on axes that are not planned or have no limits, a start that
    is the goal, and two obstacles of one name.
    """
    check_goal_distance(request.robot, request.start, request.goal)
    planned = _planned_axes(request)
    if request.robot.n_vehicle and request.axes != AXES[2]:
        yaw = float(planned.reference[5])
    else:
        yaw = 0.0
    if yaw == 0.0:
        return _planned(request)
    # The optimiser and its random numbers know the axes of the world: in one that looks ahead with
    # the vehicle, north is nothing.
    plan = _planned(_turned(request, yaw)).plan
    scene = collision_scene(planned, request.obstacles)
    if plan is None:
        return PlanResult(request=request, scene=scene, plan=None)
    coefficients = plan.trajectory.coefficients.copy()
    coefficients[..., :2] @= pin.rpy.rpyToMatrix(0.0, 0.0, -yaw)[:2, :2]
    coefficients[0, :, planned.names.index("yaw")] += yaw
    curve = PiecewisePolynomial(breaks=plan.trajectory.breaks, coefficients=coefficients)
    return PlanResult(request=request, scene=scene, plan=replace(plan, trajectory=curve))


def _turned(request: PlanRequest, yaw: float) -> PlanRequest:
    """Return the request in a world whose x axis is at that yaw."""
    X_NW = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, -yaw), np.zeros(3))
    start = request.start.copy()
    goal = request.goal
    start[:7] = pin.SE3ToXYZQUAT(X_NW * pin.XYZQUATToSE3(start[:7]))
    if goal.position is None:
        position = None
    else:
        position = X_NW.act(np.array(goal.position)).tolist()
    if goal.rpy is None:
        rpy = None
    else:
        rpy = (*goal.rpy[:2], remainder(goal.rpy[2] - yaw, 2.0 * np.pi))
    obstacles = tuple(
        replace(obstacle, X_WO=X_NW * obstacle.X_WO) for obstacle in request.obstacles
    )
    if position is None:
        goal = replace(goal, rpy=rpy)
    else:
        goal = replace(goal, position=tuple(position), rpy=rpy)
    return replace(request, start=start, goal=goal, obstacles=obstacles)


def _planned(request: PlanRequest) -> PlanResult:
    planned = _planned_axes(request)
    scene = collision_scene(planned, request.obstacles)
    goal = request.goal.as_coordinates(CoalDistances(scene), seed=request.seed)
    if goal is None:
        return PlanResult(request=request, scene=scene, plan=None)
    ends = np.stack([planned.x(request.start), goal])
    ends[1] = np.where(_differ(ends), ends[1], ends[0])
    weights = CostWeights(clearance=request.clearance, link_clearance=request.link_clearance)
    options = SoftCollisionOptions(
        weights=weights, sampling=SamplingOptions(seed=request.seed), seed=request.seed
    )
    plan = plan_soft_collision(scene, ends, limits=curve_limits(planned, ends), options=options)
    return PlanResult(request=request, scene=scene, plan=plan)


@checked_dataclass(eq=False)
class _RobotLimits(MotionLimits):
    """The robot's limits along the vehicle's own axes, checked over the whole curve; the optimiser
    takes those of planned axes at the start.
    """

    planned: Coordinates

    def ratios(self, trajectory: PiecewisePolynomial) -> Array:
        """(3, n_v) peaks of velocities and accelerations as shares of the robot's limits; jerks
        have none.
        """
        t = np.linspace(trajectory.start, trajectory.end, _VELOCITY_SAMPLES)
        limits = self.planned.robot.limits
        v = (
            self.planned.velocity_map(trajectory.evaluate(t))
            @ trajectory.evaluate(t, 1)[:, :, None]
        )[:, :, 0]
        peaks = [np.abs(rate).max(axis=0) for rate in (v, np.gradient(v, t, axis=0), 0.0 * v)]
        return np.stack(peaks) / (limits.velocity, limits.acceleration, np.ones(v.shape[1]))


def _differ(ends: Array) -> Mask:
    """Return which axes differ between the ends (2, n_axes) by more than rounding."""
    return np.abs(ends[1] - ends[0]) > _SAME_PLACE


def curve_limits(planned: Coordinates, ends: Array) -> MotionLimits:
    """Return the motion limits of the planned axes of a robot. Raises `InvalidInput` for axes that
    differ between the ends (2, n_axes) and have none.
    """
    velocity, acceleration = planned.rate_limits(ends[:1], shared=True)
    endless = _differ(ends) & np.isinf(velocity) & np.isinf(acceleration)
    if endless.any():
        moving = ", ".join(
            name for name, unlimited in zip(planned.names, endless, strict=True) if unlimited
        )
        advice = (
            "give vehicle_limits and joints in hydrodynamics.yaml, or velocity in <limit> of the"
            " URDF"
        )
        raise InvalidInput(
            f"{moving}: no limit of velocity or acceleration, which a curve is as fast as; {advice}"
        )
    return _RobotLimits(velocity=velocity, acceleration=acceleration, planned=planned)


def _planned_axes(request: PlanRequest) -> Coordinates:
    require_known("axes", request.axes, AXES)
    robot = request.robot
    vehicle = VEHICLE_AXES if robot.n_vehicle else ()
    vehicle_axes = {
        "all": vehicle,
        "joints": (),
        "level": tuple(axis for axis in vehicle if axis not in ("roll", "pitch")),
    }
    joints = (
        joint_axis(robot, name)
        for name in robot.joint_names
        if name not in held_joints(robot.model, robot.joints)
    )
    return coordinates(robot, reference=request.start, axes=(*vehicle_axes[request.axes], *joints))
