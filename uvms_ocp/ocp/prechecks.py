"""Check before solving: an impossible first step, a crowded start, a goal inside an obstacle."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.clearance import ShapeClearance
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.planning import CoalDistances, CollisionScene
from uvms_ocp.planning.request import Goal, PostureGoal, ToolGoal
from uvms_ocp.robot.robot import Robot

# Which shapes are nearer at the start than a constraint allows, in words.


def describe_crowded_start(problem: OcpProblem, constraint: str) -> str:
    """The pair that a constraint of that name finds nearest for its margin, as a bracket; empty for one without shapes."""
    terms = [term for term in problem.constraints if isinstance(term, ShapeClearance) and term.name == constraint]
    return max((_lack(term, problem) for term in terms), default=(0.0, ""))[1]


def _lack(term: ShapeClearance, problem: OcpProblem) -> tuple[float, str]:
    distances = term.distances([0.0], problem.start.q[None])[0]
    lack = term.margins - distances
    k = int(lack.argmax())
    pair, margin = term.scene.pairs[k], term.margins[k]
    return float(lack[k]), f" ({pair.name}: {distances[k]:.4g} m apart, margin {margin:.4g} m)"


# What no input can bring within the limits in the first step: a proof, before any NLP, that a start is impossible.

_ROUNDING = 1e-9


def impossible_start(problem: OcpProblem) -> str | None:
    """An axis whose limits the second node cannot keep, in words; None where every axis can.

    Velocity changes by at most the acceleration limit times the step, and a joint goes on meanwhile. These are limits
    of single axes: where they can be kept, forces, constraints or goals may still be out of reach. A free duration
    counts as impossible only if every step in its range is.
    """
    if not (problem.limited and problem.fixed_start):
        return None
    phase = problem.phases[0]
    shortest, longest = (duration / phase.n_steps for duration in phase.range)
    return _too_fast(problem, longest) or _too_near(problem, shortest, longest)


def _too_fast(problem: OcpProblem, h: float) -> str | None:
    """After the longest step, which leaves the most time to slow down."""
    limits, v = problem.robot.limits, problem.start.v
    excess = np.abs(v) - limits.acceleration * h - limits.velocity
    i = int(np.argmax(excess))
    if excess[i] <= _ROUNDING:
        return None
    return (
        f"{_axes(problem)[i]} starts at {v[i]:.4g} and must not exceed {limits.velocity[i]:.4g} after the first step: in "
        f"{h:.3g} s it changes by {limits.acceleration[i] * h:.4g} at most"
    )


def _too_near(problem: OcpProblem, shortest: float, longest: float) -> str | None:
    """After the best step: a short one does not get to the limit, a long one may have turned back."""
    robot, limits = problem.robot, problem.robot.limits
    for joint in robot.joints:
        if joint.n_q != joint.n_v:
            continue
        for i in range(joint.n_v):
            q, v = float(problem.start.q[joint.q][i]), float(problem.start.v[joint.idx_v + i])
            a, speed = limits.acceleration[joint.idx_v + i], limits.velocity[joint.idx_v + i]
            own = joint.idx_v - robot.n_vehicle + i
            least = q + _least_way(v, a, speed, shortest, longest)
            most = q - _least_way(-v, a, speed, shortest, longest)
            low, high = limits.position_lower[own], limits.position_upper[own]
            if least > high + _ROUNDING or most < low - _ROUNDING:
                return (
                    f"joint {joint.name!r} starts at {q:.4g} with {v:.4g} per second and cannot stay between {low:.4g} "
                    f"and {high:.4g} in the first step of {_range(shortest, longest)} s"
                )
    return None


def _least_way(v: float, a: float, speed: float, shortest: float, longest: float) -> float:
    """Smallest displacement after any step in the range; concave in the step but for where the speed limit is met."""
    kink = (v + speed) / a if np.isfinite(a) else 0.0
    steps = (shortest, longest, min(max(kink, shortest), longest))
    return min(h * (v + max(v - a * h, -speed)) / 2 for h in steps)


def _range(shortest: float, longest: float) -> str:
    return f"{longest:.3g}" if shortest == longest else f"{shortest:.3g} to {longest:.3g}"


def _axes(problem: OcpProblem) -> list[str]:
    vehicle = ("surge", "sway", "heave", "roll rate", "pitch rate", "yaw rate")[: problem.robot.n_vehicle]
    return [*vehicle, *(f"rate of {name!r}" for name in problem.robot.joint_names)]


# A goal that only a robot inside something could reach is said so before anything is solved.


def check_goal(scene: CollisionScene, goal: Goal, start: np.ndarray) -> None:
    """Raise `InvalidInput` where shapes that a goal leaves no choice would touch; start (n_q,) [m, rad].

    It names the shapes and their depth: of a posture those of the vehicle and the joints that it says; of a tool in a pose those
    on its link; of a tool at a place the point itself.
    """
    if isinstance(goal, ToolGoal):
        _check_tool(scene, goal)
    scene.check_no_overlap(goal_distances(scene, goal, start), "the goal")


def start_distances(scene: CollisionScene, start: np.ndarray) -> np.ndarray:
    """(n_pairs,) [m] at the start (n_q,) [m, rad]."""
    return CoalDistances(scene).distances_at(start[None])[0]


def goal_distances(scene: CollisionScene, goal: Goal, start: np.ndarray) -> np.ndarray:
    """(n_pairs,) [m] of the pairs whose places a posture decides, infinite for others; start (n_q,) [m, rad]."""
    if isinstance(goal, ToolGoal):
        return np.full(scene.n_pairs, np.inf)
    robot = scene.coordinates.robot
    q = robot.configuration(position=goal.position, rpy=goal.rpy, joints=dict(goal.joints)).copy()
    if robot.n_vehicle:
        q[:3] = start[:3] if goal.position is None else q[:3]
        q[3:7] = start[3:7] if goal.rpy is None else q[3:7]
    known = _determined_joints(robot, goal)
    pairs = [{pair.first_joint, pair.second_joint} <= known for pair in scene.pairs]
    return np.where(pairs, start_distances(scene, q), np.inf)


def _determined_joints(robot: Robot, goal: PostureGoal) -> set[int]:
    """Joints whose places the goal decides, the world among them: those behind joints that it all names."""
    known, model = {0}, robot.model
    for joint in range(1, model.njoints):
        vehicle = model.joints[joint].nv == 6
        named = goal.position is not None or goal.rpy is not None if vehicle else model.names[joint] in goal.joints
        if named and model.parents[joint] in known:
            known.add(joint)
    return known


def _check_tool(scene: CollisionScene, goal: ToolGoal) -> None:
    robot, shapes = scene.coordinates.robot, scene.geometry.geometryObjects
    frame = robot.model.frames[robot.frame_id(goal.frame)]
    placed: list[tuple[str, coal.CollisionGeometry, pin.SE3]] = []
    if isinstance(goal.target, pin.SE3):
        X_WJ = goal.target * frame.placement.inverse()
        own = [k for k, shape in enumerate(shapes) if shape.parentJoint == frame.parentJoint]
        placed = [(shapes[k].name, shapes[k].geometry, X_WJ * shapes[k].placement) for k in own if k < _first(scene)]
    else:
        placed = [(goal.frame, coal.Sphere(_POINT), pin.SE3(np.eye(3), goal.target))]
    for k in range(_first(scene), scene.geometry.ngeoms):
        for name, shape, X in placed:
            depth = -_distance(shapes[k].geometry, shapes[k].placement, shape, X)
            if depth >= 0.0:
                pair = f"{shapes[k].name} - {name}"
                text = f"the goal is in collision: {pair} overlap by {depth:.3g} m"
                raise InvalidInput(f"{text}; move it or the obstacle")


_POINT = 1e-6  # [m] radius of a ball that stands for a point


def _first(scene: CollisionScene) -> int:
    """Index of the first obstacle."""
    return int(scene.coordinates.robot.collision_model.ngeoms)


def _distance(
    first: coal.CollisionGeometry, X_first: pin.SE3, second: coal.CollisionGeometry, X_second: pin.SE3
) -> float:
    places = [coal.Transform3s(X.rotation, X.translation) for X in (X_first, X_second)]
    result = coal.DistanceResult()
    return float(coal.distance(first, places[0], second, places[1], coal.DistanceRequest(), result))
