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

AXES = ("level", "all", "joints")
"""Planned axes: all but roll and pitch, all, or the joints alone."""
_SAME_PLACE = 1e-9  # [m or rad] difference between a goal and a start that is none
_FARTHEST = 1e4  # [m] from the start that a goal may be
_MOST_TURN = 4 * np.pi  # [rad] of an angle of a goal
_VELOCITY_SAMPLES = 1000
"""Samples of velocities along a curve, whose peak is 1e-4 higher at most."""
_REGULAR = 1e-12  # added to the diagonal of the normal matrix, which is singular without

Triple: TypeAlias = tuple[float, float, float]
FiniteTriple: TypeAlias = tuple[Finite, Finite, Finite]


@checked_dataclass()
class ToolGoalOptions:
    """Settings of ``tool_goal``."""

    tolerance: float = 1e-6
    """[m, rad] error that counts as reached."""
    iterations: int = 100
    """Steps of a search from one guess, at most."""
    attempts: int = 80
    """Guesses: the one of the caller, then random ones around it, farther and farther."""
    spread: float = 0.5
    """[m or rad] Spread of the first random guesses; the last are five times as far, to come from
    another side.
    """
    clearance: float = 0.005
    """[m] Distance that the goal keeps from everything."""
    damping: float = 1e-3
    """With lengths in m: added to the diagonal of the normal matrix, times the squared error where
    that is less than 1.
    """
    seed: Count = 0
    """Seed of the random guesses."""


@checked
def tool_goal(
    distances: PairDistances,
    frame: str,
    goal: pin.SE3 | ArrayLike,
    guess: ArrayLike,
    options: ToolGoalOptions | None = None,
) -> Array | None:
    """Find coordinates (n_axes,) [m, rad] within limits and clear of collision with the frame at its
    goal; None where there are none.

    The goal is a pose X_WF, or a position p_WF (3,) [m] with any orientation; guess (n_axes,) [m,
    rad]: where the search begins. Plan without roll and pitch (``coordinates(robot, axes=...)``) to
    keep the vehicle level. Raises `FrameNotFound` where the robot has no such frame, `InvalidInput`
    for a guess or goal of the wrong shape or not finite.
    """
    options = options or ToolGoalOptions()
    planned = distances.scene.coordinates
    frame_id = planned.robot.frame_id(frame)
    start = finite_array("guess", guess, (planned.n_axes,))
    if isinstance(goal, pin.SE3):
        target = goal
    else:
        target = finite_array("goal, a pose (pin.SE3) or a position", goal, (3,))
    rng = np.random.default_rng(options.seed)
    for attempt in range(options.attempts):
        if attempt == 0:
            spread = 0.0
        else:
            spread = options.spread * (1.0 + 4.0 * attempt / options.attempts)
        random_start = start + spread * rng.normal(size=start.size)
        x = _inverse_kinematics(planned, frame_id, target, random_start, options)
        if x is not None and distances.distances(x[None]).min(initial=np.inf) > options.clearance:
            return x
    return None


def _inverse_kinematics(
    planned: Coordinates,
    frame_id: int,
    goal: pin.SE3 | Array,
    start: Array,
    options: ToolGoalOptions,
) -> Array | None:
    """Reach the goal by damped Gauss-Newton on the logarithm of the error, clipped to the limits at
    every step; None where it is not reached.
    """
    lower, upper = planned.limits()
    x = start
    for _ in range(options.iterations):
        x = np.clip(x, lower, upper)
        error, jacobian = _error(planned, frame_id, goal, x)
        if np.abs(error).max() <= options.tolerance:
            return x
        identity = np.eye(error.size)
        damping = options.damping * min(1.0, float(error @ error))
        normal = jacobian @ jacobian.T + damping * identity + _REGULAR * identity
        x = x + jacobian.T @ np.linalg.solve(normal, error)
    return None


def _error(
    planned: Coordinates, frame_id: int, goal: pin.SE3 | Array, x: Array
) -> tuple[Array, Array]:
    """Compute the twist (6,), or velocity (3,), that takes the frame to the goal in one second, and
    its Jacobian, in the frame.
    """
    model = planned.robot.model
    data = model.createData()
    q = planned.configurations(x[None])[0]
    pin.framesForwardKinematics(model, data, q)
    X_WF = data.oMf[frame_id]
    by_velocity = pin.computeFrameJacobian(model, data, q, frame_id, pin.LOCAL)
    # Pinocchio returns a vector for a single joint.
    by_velocity = np.reshape(by_velocity, (6, model.nv))
    jacobian: Array = by_velocity @ planned.velocity_map(x[None])[0]
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
    """Name of the frame."""

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
        """Find planned axes (n_axes,) [m, rad] with the frame at its goal and nothing touching; None
        where no posture does.

        Raises `FrameNotFound` where the robot has no such frame.
        """
        planned = distances.scene.coordinates
        start = planned.reference[planned.planned]
        goal = tool_goal(distances, self.frame, self.target, start, ToolGoalOptions(seed=seed))
        if goal is None:
            return None
        return planned.shortest_turn(goal, start)

    def as_tasks(self, robot: Robot, start: Array) -> tuple[Task, ...]:
        """Return the task of the frame with this goal, wherever the start (n_q,) [m, rad] is.

        Raises `FrameNotFound` where the robot has no such frame.
        """
        robot.frame_id(self.frame)
        target = self.target
        if isinstance(target, pin.SE3):
            return (ToolPose(frame=self.frame, goal=target),)
        return (ToolPosition(frame=self.frame, goal=pin.SE3(np.eye(3), target)),)


@checked_dataclass()
class PostureGoal:
    """A posture of the vehicle and joints; what is left out stays as at the start.

    Raises `InvalidInput` for angles beyond two turns.
    """

    position: FiniteTriple | None = None
    """[m] p_WB of the vehicle."""
    rpy: FiniteTriple | None = None
    """[rad] Roll, pitch, yaw of the vehicle."""
    joints: Mapping[str, float] = field(default_factory=dict)
    """[m or rad] Positions of joints by name."""

    def __post_init__(self) -> None:
        _check_turn(self.rpy)

    def as_coordinates(self, distances: PairDistances, *, seed: int) -> Array:
        """Return planned axes (n_axes,) [m, rad] at the goal.

        Raises `NameNotFound` for an axis that the robot does not have, `InvalidInput` for a number
        that is not finite, for a goal of the vehicle where there is none, and for a goal away from
        the start on an axis that is not planned.
        """
        planned = distances.scene.coordinates
        # On a fixed base, joints may have the names of a vehicle's axes.
        planned.robot.configuration(position=self.position, rpy=self.rpy)
        all_axes = coordinates(planned.robot)
        goal = planned.reference.copy()
        for name, value in self._values(planned.robot).items():
            require_known("axis", name, all_axes.names)
            if not np.isfinite(value):
                raise InvalidInput(f"the goal has {name} = {value}; give a finite number.")
            goal[all_axes.names.index(name)] = value
        goal = all_axes.shortest_turn(goal, planned.reference)
        for name, begin, end in zip(all_axes.names, planned.reference, goal, strict=True):
            if name not in planned.names and abs(end - begin) > _SAME_PLACE:
                change = (
                    f"the goal moves {name} from {begin:.6g} to {end:.6g}, but the planned axes are"
                )
                raise InvalidInput(
                    f"{change} {', '.join(planned.names)}; leave it where it is, or plan all axes."
                )
        return np.asarray(goal[planned.planned])

    def _values(self, robot: Robot) -> dict[str, float]:
        """Return values of the axes that the goal names; of an attitude those with a pitch within a
        quarter turn.
        """
        values = dict(zip(VEHICLE_AXES[:3], self.position or (), strict=False))
        rpy = self.rpy
        if rpy is not None and np.isfinite(rpy).all():
            rpy = pin.rpy.matrixToRpy(pin.rpy.rpyToMatrix(np.array(rpy))).tolist()
        values |= zip(VEHICLE_AXES[3:], rpy or (), strict=False)
        for name, value in self.joints.items():
            values[joint_axis(robot, name)] = value
        return values

    def as_tasks(self, robot: Robot, start: Array) -> tuple[Task, ...]:
        """Return tasks of the vehicle and of the joints that the goal names; start (n_q,) [m, rad]:
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
            rotation = start_pose.rotation if self.rpy is None else goal_pose.rotation
            tasks.append(VehiclePose(goal=pin.SE3(rotation, position)))
        if self.joints:
            values = np.array(list(self.joints.values()))
            tasks.append(JointTracking(joints=tuple(self.joints), goal=values))
        return tuple(tasks)


Goal: TypeAlias = ToolGoal | PostureGoal


def check_goal_distance(robot: Robot, start: Array, goal: Goal) -> None:
    """Raise `InvalidInput` for a goal that is very far from the start (n_q,) [m, rad]: plans are
    sampled densely.
    """
    # A number that is not finite is refused with its axis, where the goal is used.
    if goal.position is None or not np.isfinite(goal.position).all():
        return
    if robot.n_vehicle:
        start_position = start[:3]
    else:
        start_position = np.zeros(3)
    # Within what can be squared.
    difference = np.clip(goal.position, -1e99, 1e99) - np.clip(start_position, -1e99, 1e99)
    distance = float(np.linalg.norm(difference))
    if distance > _FARTHEST:
        text = (
            f"the goal {tuple(goal.position)} m is {distance:.3g} m from the start; give one within"
            f" {_FARTHEST:g} m"
        )
        raise InvalidInput(f"{text}: a plan is proven clear every few centimetres, in memory")


def _check_turn(rpy: Triple | None) -> None:
    """Raise `InvalidInput` for roll, pitch or yaw [rad] beyond two turns."""
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
    """Planned axes, one of `AXES`."""
    clearance: Positive = 0.06
    """[m] wanted from obstacles, and between links; what is verified is that nothing touches."""
    link_clearance: Positive | None = None
    """[m] wanted between links instead."""
    seed: Count = 0
    """Seed of random goals and samples."""


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
    if request.robot.n_vehicle and request.axes != "joints":
        yaw = float(planned.reference[5])
    else:
        yaw = 0.0
    if yaw == 0.0:
        return _plan_in_world(request)
    # The optimiser and its random numbers know the axes of the world: in one that looks ahead with
    # the vehicle, north is nothing.
    plan = _plan_in_world(_turned(request, yaw)).plan
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
    start[:7] = pin.SE3ToXYZQUAT(X_NW * pin.XYZQUATToSE3(start[:7]))
    goal = request.goal
    if goal.position is not None:
        position = X_NW.act(np.array(goal.position)).tolist()
        goal = replace(goal, position=tuple(position))
    if goal.rpy is not None:
        roll, pitch, goal_yaw = goal.rpy
        goal = replace(goal, rpy=(roll, pitch, remainder(goal_yaw - yaw, 2.0 * np.pi)))
    obstacles = [replace(obstacle, X_WO=X_NW * obstacle.X_WO) for obstacle in request.obstacles]
    return replace(request, start=start, goal=goal, obstacles=tuple(obstacles))


def _plan_in_world(request: PlanRequest) -> PlanResult:
    """Plan along the axes of the world, whatever the vehicle's yaw."""
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
    """Limits of the robot along the vehicle's axes, checked over the whole curve; the optimiser takes
    those of planned axes at the start.
    """

    planned: Coordinates

    def ratios(self, trajectory: PiecewisePolynomial) -> Array:
        """Return peaks (3, n_v) of velocities and accelerations as shares of the robot's limits;
        jerks have none.
        """
        t = np.linspace(trajectory.start, trajectory.end, _VELOCITY_SAMPLES)
        maps = self.planned.velocity_map(trajectory.evaluate(t))
        v = (maps @ trajectory.evaluate(t, 1)[:, :, None])[:, :, 0]
        a = np.gradient(v, t, axis=0)
        limits = self.planned.robot.limits
        velocity_shares = np.abs(v).max(axis=0) / limits.velocity
        acceleration_shares = np.abs(a).max(axis=0) / limits.acceleration
        return np.stack([velocity_shares, acceleration_shares, np.zeros(v.shape[1])])


def _differ(ends: Array) -> Mask:
    """Return which axes differ between the ends (2, n_axes) by more than rounding."""
    return np.abs(ends[1] - ends[0]) > _SAME_PLACE


def curve_limits(planned: Coordinates, ends: Array) -> MotionLimits:
    """Return the motion limits of the planned axes of a robot. Raises `InvalidInput` for axes that
    differ between the ends (2, n_axes) and have none.
    """
    velocity, acceleration = planned.rate_limits(ends[:1], shared=True)
    is_unlimited = _differ(ends) & np.isinf(velocity) & np.isinf(acceleration)
    if is_unlimited.any():
        unlimited = [planned.names[k] for k in np.flatnonzero(is_unlimited)]
        advice = (
            "give vehicle_limits and joints in hydrodynamics.yaml, or velocity in <limit> of the"
            " URDF"
        )
        raise InvalidInput(
            f"{', '.join(unlimited)}: no limit of velocity or acceleration, which a curve is as"
            f" fast as; {advice}"
        )
    return _RobotLimits(velocity=velocity, acceleration=acceleration, planned=planned)


def _planned_axes(request: PlanRequest) -> Coordinates:
    """Return the coordinates of the axes of a request; joints without range stay where they are."""
    require_known("axes", request.axes, AXES)
    robot = request.robot
    axes = []
    if robot.n_vehicle and request.axes != "joints":
        for axis in VEHICLE_AXES:
            if request.axes == "all" or axis not in ("roll", "pitch"):
                axes.append(axis)
    held = held_joints(robot.model, robot.joints)
    for name in robot.joint_names:
        if name not in held:
            axes.append(joint_axis(robot, name))
    return coordinates(robot, reference=request.start, axes=axes)
