"""Find what no plan could mend before anything is solved: starts from which limits cannot be kept,
and starts or goals that hold shapes inside one another.
"""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.shape_clearance import ShapeClearance
from uvms_ocp.planning import CoalDistances, CollisionScene
from uvms_ocp.planning.request import Goal, PostureGoal, ToolGoal
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.signed_distance import Body, signed_contact

_ROUNDING = 1e-9
_POINT = 1e-6  # [m] radius of a ball that stands for a point


# What no input can bring within the limits in the first step: a proof, before any NLP, that a start
# is impossible.


def impossible_start(problem: OcpProblem) -> str | None:
    """An axis whose limits the second node cannot keep, in words; None where every axis can.

    Velocity changes by at most the acceleration limit times the step, and a joint goes on
    meanwhile. These are limits of single axes: where they can be kept, forces, constraints or goals
    may still be out of reach. A free duration counts as impossible only if every step in its range
    is.
    """
    if not (problem.limited and problem.fixed_start):
        return None
    phase = problem.phases[0]
    shortest, longest = (duration / phase.n_steps for duration in phase.range)
    return _too_fast(problem, longest) or _too_near(problem, shortest, longest)


def _too_fast(problem: OcpProblem, h: float) -> str | None:
    """After the longest step, which leaves the most time to slow down."""
    limits = problem.robot.limits
    v = problem.start.v
    excess = np.abs(v) - limits.acceleration * h - limits.velocity
    i = int(np.argmax(excess))
    if excess[i] <= _ROUNDING:
        return None
    return (
        f"{_axes(problem)[i]} starts at {v[i]:.4g} and must not exceed {limits.velocity[i]:.4g}"
        f" after the first step: in {h:.3g} s it changes by {limits.acceleration[i] * h:.4g} at"
        " most"
    )


def _too_near(problem: OcpProblem, shortest: float, longest: float) -> str | None:
    """After the best step: a short one does not get to the limit, a long one may have turned
    back.
    """
    robot = problem.robot
    limits = problem.robot.limits
    lower, upper = robot.configuration_bounds
    for joint in robot.joints:
        for i in range(joint.n_v):
            q = float(problem.start.q[joint.q][i])
            v = float(problem.start.v[joint.idx_v + i])
            a = limits.acceleration[joint.idx_v + i]
            speed = limits.velocity[joint.idx_v + i]
            least = q + _least_way(v, a, speed, shortest, longest)
            most = q - _least_way(-v, a, speed, shortest, longest)
            low = lower[joint.q][i]
            high = upper[joint.q][i]
            if least > high + _ROUNDING or most < low - _ROUNDING:
                if shortest == longest:
                    span = f"{longest:.3g}"
                else:
                    span = f"{shortest:.3g} to {longest:.3g}"
                return (
                    f"joint {joint.name!r} starts at {q:.4g} with {v:.4g} per second and cannot"
                    f" stay between {low:.4g} and {high:.4g} in the first step of {span} s"
                )
    return None


def _least_way(v: float, a: float, speed: float, shortest: float, longest: float) -> float:
    """Smallest displacement after any step in the range; concave in the step but for where the
    speed limit is met.
    """
    kink = (v + speed) / a if np.isfinite(a) else 0.0
    return min(
        h * (v + max(v - a * h, -speed)) / 2
        for h in (shortest, longest, min(max(kink, shortest), longest))
    )


def _axes(problem: OcpProblem) -> list[str]:
    vehicle = ("surge", "sway", "heave", "roll rate", "pitch rate", "yaw rate")[
        : problem.robot.n_vehicle
    ]
    return [*vehicle, *(f"rate of {name!r}" for name in problem.robot.joint_names)]


# Which shapes are nearer at the start than a constraint allows, in words.


def describe_crowded_start(problem: OcpProblem, constraint: str) -> str:
    """The pair that a constraint of that name finds nearest for its margin, as a bracket; empty for
    one without shapes.
    """
    terms = [
        term
        for term in problem.constraints
        if isinstance(term, ShapeClearance) and term.name == constraint
    ]
    return max((_lack(term, problem) for term in terms), default=(0.0, ""))[1]


def _lack(term: ShapeClearance, problem: OcpProblem) -> tuple[float, str]:
    distances = term.distances([0.0], problem.start.q[None])[0]
    lack = term.margins - distances
    k = int(lack.argmax())
    return float(
        lack[k]
    ), f" ({term.scene.pairs[k].name}: {distances[k]:.4g} m apart, margin {term.margins[k]:.4g} m)"


# A goal that only a robot inside something could reach is said so before anything is solved.


def check_goal(scene: CollisionScene, goal: Goal, start: np.ndarray) -> None:
    """Raise `InvalidInput` where shapes that a goal leaves no choice would touch; start (n_q,) [m,
    rad].

    It names the shapes and their depth: of a posture those of the vehicle and the joints that it
    says; of a tool in a pose those on its link; of a tool at a place the point itself.
    """
    if isinstance(goal, ToolGoal):
        _check_tool(scene, goal)
    scene.check_no_overlap(goal_distances(scene, goal, start), "the goal")


def start_distances(scene: CollisionScene, start: np.ndarray) -> np.ndarray:
    """(n_pairs,) [m] at the start (n_q,) [m, rad]."""
    return CoalDistances(scene).distances_at(start[None])[0]


def goal_distances(scene: CollisionScene, goal: Goal, start: np.ndarray) -> np.ndarray:
    """(n_pairs,) [m] of the pairs whose places a posture decides, infinite for others; start (n_q,)
    [m, rad].
    """
    if isinstance(goal, ToolGoal):
        return np.full(scene.n_pairs, np.inf)
    robot = scene.coordinates.robot
    q = robot.configuration(position=goal.position, rpy=goal.rpy, joints=dict(goal.joints)).copy()
    if robot.n_vehicle:
        q[:3] = start[:3] if goal.position is None else q[:3]
        q[3:7] = start[3:7] if goal.rpy is None else q[3:7]
    known = _determined_joints(robot, goal)
    return np.where(
        [{pair.first_joint, pair.second_joint} <= known for pair in scene.pairs],
        start_distances(scene, q),
        np.inf,
    )


def _determined_joints(robot: Robot, goal: PostureGoal) -> set[int]:
    """Joints whose places the goal decides, the world among them: those behind joints that it all
    names.
    """
    known = {0}
    model = robot.model
    for joint in range(1, model.njoints):
        vehicle = model.joints[joint].nv == 6
        if vehicle:
            named = goal.position is not None or goal.rpy is not None
        else:
            named = model.names[joint] in goal.joints
        if named and model.parents[joint] in known:
            known.add(joint)
    return known


def _check_tool(scene: CollisionScene, goal: ToolGoal) -> None:
    robot = scene.coordinates.robot
    shapes = list(scene.geometry.geometryObjects)
    links = shapes[: robot.collision_model.ngeoms]
    obstacles = shapes[robot.collision_model.ngeoms :]
    frame = robot.model.frames[robot.frame_id(goal.frame)]
    placed: list[tuple[str, coal.CollisionGeometry, pin.SE3]] = []
    if isinstance(goal.target, pin.SE3):
        X_WJ = goal.target * frame.placement.inverse()
        own = [shape for shape in links if shape.parentJoint == frame.parentJoint]
        placed = [(shape.name, shape.geometry, X_WJ * shape.placement) for shape in own]
    else:
        placed = [(goal.frame, coal.Sphere(_POINT), pin.SE3(np.eye(3), goal.target))]
    for obstacle in obstacles:
        for name, geometry, X in placed:
            depth = -_distance(obstacle.geometry, obstacle.placement, geometry, X)
            if depth >= 0.0:
                text = (
                    f"the goal is in collision: {obstacle.name} - {name} overlap by {depth:.3g} m"
                )
                raise InvalidInput(f"{text}; move it or the obstacle")


def _distance(
    first: coal.CollisionGeometry,
    X_first: pin.SE3,
    second: coal.CollisionGeometry,
    X_second: pin.SE3,
) -> float:
    places = [coal.Transform3s(X.rotation, X.translation) for X in (X_first, X_second)]
    result = coal.DistanceResult()
    coal.distance(first, places[0], second, places[1], coal.DistanceRequest(), result)
    bodies = (Body(first), Body(second))
    return signed_contact(bodies, (X_first, X_second), result).distance
