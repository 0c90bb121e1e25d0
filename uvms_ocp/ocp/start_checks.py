"""Find starts and goals that no plan can have, before anything is solved: starts from which limits
cannot be kept, and starts or goals in which shapes overlap.
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

_ROUNDING = 1e-9  # [unit of the axis] excess over a limit that counts as none
_POINT = 1e-6  # [m] radius of a ball that stands for a point


def impossible_start(problem: OcpProblem) -> str | None:
    """Describe an axis that cannot keep its limits at the second node, whatever the input; `None`
    where every axis can. It proves, before any NLP, that a start is impossible.

    Velocity changes by at most the acceleration limit times the step, and a joint moves on
    meanwhile. Single axes are checked: where all can keep their limits, forces, constraints or
    goals may still be out of reach. A free duration counts as impossible only if all its steps are.
    """
    if not (problem.limited and problem.fixed_start):
        return None
    phase = problem.phases[0]
    shortest, longest = (duration / phase.n_steps for duration in phase.range)
    return _too_fast(problem, longest) or _leaves_range(problem, shortest, longest)


def _too_fast(problem: OcpProblem, h: float) -> str | None:
    """Describe an axis that is too fast even after the longest step h [s], which leaves the most
    time to slow down.
    """
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


def _leaves_range(problem: OcpProblem, shortest: float, longest: float) -> str | None:
    """Describe a joint that is out of its range at the end of the first step, for every duration of
    it from shortest to longest [s]: after a short step it may not have left the range yet, after a
    long one it may have come back.
    """
    robot = problem.robot
    limits = robot.limits
    lower, upper = robot.configuration_bounds
    for joint in robot.joints:
        for i in range(joint.n_v):
            q = float(problem.start.q[joint.q][i])
            v = float(problem.start.v[joint.idx_v + i])
            a = limits.acceleration[joint.idx_v + i]
            speed = limits.velocity[joint.idx_v + i]
            lowest_q = q + _smallest_displacement(v, a, speed, shortest, longest)
            highest_q = q - _smallest_displacement(-v, a, speed, shortest, longest)
            q_lower = lower[joint.q][i]
            q_upper = upper[joint.q][i]
            if lowest_q > q_upper + _ROUNDING or highest_q < q_lower - _ROUNDING:
                if shortest == longest:
                    span = f"{longest:.3g}"
                else:
                    span = f"{shortest:.3g} to {longest:.3g}"
                return (
                    f"joint {joint.name!r} starts at {q:.4g} with {v:.4g} per second and cannot"
                    f" stay between {q_lower:.4g} and {q_upper:.4g} in the first step of {span} s"
                )
    return None


def _smallest_displacement(
    v: float, a: float, speed: float, shortest: float, longest: float
) -> float:
    """Return the smallest displacement at the end of a step of any duration from shortest to longest
    [s]: v [unit of the axis / s] at its begin, falling by at most a per second, down to -speed.

    As a function of the duration the displacement is concave up to the one at which -speed is
    reached, and from there on: the least is at one of both ends or at that duration.
    """
    kink = (v + speed) / a if np.isfinite(a) else 0.0
    kink_in_range = min(max(kink, shortest), longest)
    displacements = []
    for h in (shortest, longest, kink_in_range):
        v_end = max(v - a * h, -speed)
        displacements.append(h * (v + v_end) / 2)
    return min(displacements)


def _axes(problem: OcpProblem) -> list[str]:
    """Return the names of all velocities."""
    vehicle = ("surge", "sway", "heave", "roll rate", "pitch rate", "yaw rate")
    joints = [f"rate of {name!r}" for name in problem.robot.joint_of_axis]
    return [*vehicle[: problem.robot.n_vehicle], *joints]


def describe_crowded_start(problem: OcpProblem, constraint: str) -> str:
    """Describe, in brackets, the pair of shapes that misses the margin of a constraint most at the
    start; empty where none misses it, or for a constraint without shapes.
    """
    worst = (0.0, "")
    for term in problem.constraints:
        if isinstance(term, ShapeClearance) and term.name == constraint:
            worst = max(worst, _largest_lack(term, problem))
    return worst[1]


def _largest_lack(term: ShapeClearance, problem: OcpProblem) -> tuple[float, str]:
    """Return by how much [m] the worst pair misses its margin at the start, and its description."""
    distances = term.distances([0.0], problem.start.q[None])[0]
    lack = term.margins - distances
    k = int(lack.argmax())
    pair = term.scene.pairs[k].name
    text = f" ({pair}: {distances[k]:.4g} m apart, margin {term.margins[k]:.4g} m)"
    return float(lack[k]), text


def check_goal(scene: CollisionScene, goal: Goal, start: np.ndarray) -> None:
    """Raise `InvalidInput`, with names and depth, where shapes whose poses the goal determines would
    touch; start (n_q,) [m, rad].

    A posture determines the shapes of the vehicle and of the joints that it names, a pose of a tool
    those of the tool's link, and a position of a tool no shape but the point itself.
    """
    if isinstance(goal, ToolGoal):
        _check_tool(scene, goal)
    scene.check_no_overlap(goal_distances(scene, goal, start), "the goal")


def start_distances(scene: CollisionScene, start: np.ndarray) -> np.ndarray:
    """Return the distances (n_pairs,) [m] at the start (n_q,) [m, rad]."""
    return CoalDistances(scene).distances_at(start[None])[0]


def goal_distances(scene: CollisionScene, goal: Goal, start: np.ndarray) -> np.ndarray:
    """Return distances (n_pairs,) [m] of the pairs of shapes whose poses a posture determines,
    infinite for others; all are infinite for a goal of a tool. start (n_q,) [m, rad].
    """
    if isinstance(goal, ToolGoal):
        return np.full(scene.n_pairs, np.inf)
    robot = scene.coordinates.robot
    q = robot.configuration(position=goal.position, rpy=goal.rpy, joints=dict(goal.joints)).copy()
    if robot.n_vehicle and goal.position is None:
        q[:3] = start[:3]
    if robot.n_vehicle and goal.rpy is None:
        q[3:7] = start[3:7]
    determined = _determined_joints(robot, goal)
    is_determined = [{pair.first_joint, pair.second_joint} <= determined for pair in scene.pairs]
    return np.where(is_determined, start_distances(scene, q), np.inf)


def _determined_joints(robot: Robot, goal: PostureGoal) -> set[int]:
    """Return the joints whose poses the goal determines: the world, and joints that the goal names
    together with all joints before them.
    """
    determined = {0}
    model = robot.model
    for joint in range(1, model.njoints):
        is_vehicle = model.joints[joint].nv == 6
        if is_vehicle:
            is_named = goal.position is not None or goal.rpy is not None
        else:
            is_named = model.names[joint] in goal.joints
        if is_named and model.parents[joint] in determined:
            determined.add(joint)
    return determined


def _check_tool(scene: CollisionScene, goal: ToolGoal) -> None:
    """Raise `InvalidInput` where shapes of the tool's link, or the point, would touch obstacles."""
    robot = scene.coordinates.robot
    shapes = list(scene.geometry.geometryObjects)
    links = shapes[: robot.collision_model.ngeoms]
    obstacles = shapes[robot.collision_model.ngeoms :]
    frame = robot.model.frames[robot.frame_id(goal.frame)]
    placed: list[tuple[str, coal.CollisionGeometry, pin.SE3]] = []
    if isinstance(goal.target, pin.SE3):
        X_WJ = goal.target * frame.placement.inverse()
        for shape in links:
            if shape.parentJoint == frame.parentJoint:
                placed.append((shape.name, shape.geometry, X_WJ * shape.placement))
    else:
        placed = [(goal.frame, coal.Sphere(_POINT), pin.SE3(np.eye(3), goal.target))]
    for obstacle in obstacles:
        for name, geometry, X in placed:
            depth = -_distance(obstacle.geometry, obstacle.placement, geometry, X)
            if depth >= 0.0:
                raise InvalidInput(
                    f"the goal is in collision: {obstacle.name} - {name} overlap by"
                    f" {depth:.3g} m; move it or the obstacle"
                )


def _distance(
    first: coal.CollisionGeometry,
    X_first: pin.SE3,
    second: coal.CollisionGeometry,
    X_second: pin.SE3,
) -> float:
    """Return the signed distance [m] of two shapes."""
    first_place = coal.Transform3s(X_first.rotation, X_first.translation)
    second_place = coal.Transform3s(X_second.rotation, X_second.translation)
    result = coal.DistanceResult()
    coal.distance(first, first_place, second, second_place, coal.DistanceRequest(), result)
    bodies = (Body(first), Body(second))
    return signed_contact(bodies, (X_first, X_second), result).distance
