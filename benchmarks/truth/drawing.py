"""Draw problems of optimal control: robots, starts, goals, guesses, obstacles, levels, durations.

Start and goal are configurations that keep every limit and constraint, so that most problems have a
way; whether a motion between them exists is for the judges to find.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import casadi as ca
import coal
import numpy as np
import pinocchio as pin
from studies.drawn_robots import Body, write_robot

from truth.planes import Distances
from truth.statement import (
    Cost,
    EndRows,
    Node,
    PathRows,
    ShapeRows,
    Statement,
    duration,
    effort,
    electrical_power,
    smoothness,
)
from uvms_ocp.ocp import (
    Actuation,
    At,
    AtRest,
    Ball,
    BallClearance,
    Duration,
    Effort,
    Energy,
    OcpLevel,
    OcpPhase,
    OcpProblem,
    ShapeClearance,
    Smoothness,
    TaskTerm,
    Term,
    Trajectory,
    guess_through,
    hold_guess,
    residual_term,
)
from uvms_ocp.planning import Obstacle, collision_scene, coordinates, mesh_shape
from uvms_ocp.robot import Kinematics, Robot, State
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.tasks import JointTracking, MinimumAltitude, ToolPose, ToolPosition, VehiclePose

ROBOTS = (
    "bluerov2",
    "bluerov2_alpha5",
    "bluerov2",
    "drawn",
    "planar5",
    "bluerov2",
    "bluerov2_six_alpha5",
    "drawn",
    "girona_maris7_full",
    "torpedo_auv",
    "bluerov2_alpha5",
    "bluerov2",
    "bluerov2_two_alpha5",
    "drawn",
    "planar5",
    "girona_maris7",
)
"""Robots of the seeds in turn: light ones are drawn more often."""
SURROUNDINGS = (
    "open water",
    "shapes",
    "own rows",
    "open water",
    "moving shapes",
    "balls",
    "own links",
    "open water",
    "moving balls",
    "own rows",
    "shapes",
)
"""What is around the robot, in turn."""
GOALS = (
    "joints",
    "way point",
    "vehicle: place",
    "vehicle: attitude",
    "tool position: place",
    "tool pose: place",
    "tool pose: attitude",
)
"""Names of rows of ends that are goals; being at rest is a constraint."""
_KINDS = ("sphere", "box", "capsule", "cylinder", "cone", "ellipsoid", "mesh", "mesh")
GUESSES = ("default", "hold", "far", "default", "hold", "noise")
FEWEST_STEPS = 8
MOST_STEPS = 80
_ALTIMETER = "altimeter"
_DEPTH = -10.0  # [m] of the start
_ROOM = 0.04  # [m] beyond the margin that start and goal have
_LINK_ROOM = 0.005  # [m] between links at start and goal
_TRIES = 60  # of a place for start, goal or an obstacle
_CURRENT = 0.3  # [m/s] at most
_WAY = 2.5  # [m] at most, of the vehicle
_POSTURES = 0.35  # share of the ranges of joints between start and goal


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnProblem:
    """One drawn problem."""

    seed: int
    robot_name: str
    surroundings: str
    problem: OcpProblem
    statement: Statement
    guess_name: str
    guess: Trajectory | None
    """None asks for the planner's own."""
    goal: np.ndarray
    """(n_q,) [m, rad] a configuration in which all goals are met."""
    traits: tuple[str, ...]
    """What is unusual about it, for reports."""

    @property
    def straight(self) -> Trajectory:
        """Guess straight from the start to the goal."""
        model = self.problem.robot.model
        times = self.problem.nominal_times()
        shares = times / times[-1]
        start = self.problem.start.q
        path = np.array([pin.interpolate(model, start, self.goal, share) for share in shares])
        return guess_through(self.problem, times, path)


@dataclass(kw_only=True, slots=True, eq=False)
class Draft:
    """A problem on its way to be drawn."""

    rng: np.random.Generator
    robot: Robot
    start: np.ndarray
    goal: np.ndarray
    constraints: list[Term] = field(default_factory=list)
    path: list[PathRows] = field(default_factory=list)
    ends: list[EndRows] = field(default_factory=list)
    shapes: ShapeRows | None = None
    traits: list[str] = field(default_factory=list)
    floor: float = -np.inf
    """[m]"""
    moves: bool = False
    """Something moves by the clock: durations are fixed then, or nobody could say where it is."""

    def chance(self, share: float) -> bool:
        """True in so many of all draws."""
        return bool(self.rng.random() < share)


def drawn_problem(seed: int, folder: Path) -> DrawnProblem:
    """The problem of a seed; folder: for the files of a robot that is drawn too."""
    rng = np.random.default_rng([58, seed])
    robot_name = ROBOTS[seed % len(ROBOTS)]
    surroundings = SURROUNDINGS[seed % len(SURROUNDINGS)]
    robot = _robot(robot_name, rng, folder)
    start = _configuration(robot, rng, robot.configuration(), 0.0)
    goal = _configuration(robot, rng, start, _WAY)
    draft = Draft(rng=rng, robot=robot, start=start, goal=goal)
    _SURROUNDERS[surroundings](draft)
    problem, costs = _problem(draft, robot_name)
    statement = Statement(
        path=tuple(draft.path), ends=tuple(draft.ends), costs=costs, shapes=draft.shapes
    )
    guess_name = GUESSES[int(rng.integers(len(GUESSES)))]
    return DrawnProblem(
        seed=seed,
        robot_name=robot_name,
        surroundings=surroundings,
        problem=problem,
        statement=statement,
        guess_name=guess_name,
        guess=_guess(guess_name, problem, rng),
        goal=draft.goal,
        traits=tuple(draft.traits),
    )


# Robots and configurations.


def _robot(name: str, rng: np.random.Generator, folder: Path) -> Robot:
    if name != "drawn":
        return load_robot(name)
    mass = float(np.exp(rng.uniform(np.log(10.0), np.log(300.0))))
    shape = rng.uniform([1.2, 0.8, 0.5], [2.5, 1.2, 0.9])
    x, y, z = (shape * (mass / 1025.0 / float(np.prod(shape))) ** (1 / 3)).tolist()
    arms: tuple[int, ...] = ()
    if rng.random() >= 0.4:
        arms = (int(rng.integers(1, 5)),)
    body = Body(mass=mass, size=(x, y, z), thrusters=int(rng.integers(6, 10)), arms=arms, load=0.0)
    return write_robot(body, rng, folder)


def _configuration(
    robot: Robot, rng: np.random.Generator, about: np.ndarray, way: float
) -> np.ndarray:
    """(n_q,) within the limits; way [m] at most from `about`, 0 for a start."""
    step = np.zeros(robot.n_v)
    lower = np.clip(robot.limits.position_lower, -2.0, 2.0)
    upper = np.clip(robot.limits.position_upper, -2.0, 2.0)
    joints = _joint_values(robot, about)
    room = 0.06 * (upper - lower)
    drawn_joints = joints + _POSTURES * rng.uniform(-1.0, 1.0, robot.n_joints) * (upper - lower)
    step[robot.joint_v] = np.clip(drawn_joints, lower + room, upper - room) - joints
    if robot.n_vehicle:
        if way == 0.0:
            about = about.copy()
            about[2] = _DEPTH
            step[5] = rng.uniform(-np.pi, np.pi)
        else:
            direction = rng.normal(size=3) * [1.0, 1.0, 0.6]
            step[:3] = rng.uniform(0.3, way) * direction / np.linalg.norm(direction)
            step[5] = rng.uniform(-0.8, 0.8)
    moved = pin.integrate(robot.model, about, step)
    if robot.n_vehicle and way:
        # Level again: the step is a screw.
        yaw = float(pin.rpy.matrixToRpy(pin.Quaternion(moved[3:7]).matrix())[2])
        moved[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.0, yaw)).coeffs()
    return np.asarray(moved)


def _joint_values(robot: Robot, q: np.ndarray) -> np.ndarray:
    return np.asarray(robot.joint_values(q))


# Surroundings: each writes its constraint twice.


def _open_water(draft: Draft) -> None:
    pass


def _own_rows(draft: Draft) -> None:
    """One or two rows of a user's own."""
    makers: list[Callable[[Draft], None]] = [_tilt_row, _speed_row, _effort_row]
    if draft.robot.n_vehicle:
        makers += [_plane_row, _pillar_row, _plane_row]
        if draft.robot.has_frame(_ALTIMETER):
            makers.append(_altitude_row)
    else:
        makers = [_wall_row, _speed_row, _effort_row]
    for k in draft.rng.choice(len(makers), size=int(draft.rng.integers(1, 3)), replace=False):
        makers[int(k)](draft)


def _add_rows(draft: Draft, name: str, stated: PathRows, rows: Callable[[Any], ca.SX]) -> None:
    """Add the same rows to the statement and, written by the package's symbols, to the problem."""
    term = residual_term(
        name, rows, lower=stated.lower, upper=stated.upper, at=At.PATH, inputs=stated.of_inputs
    )
    draft.constraints.append(term)
    draft.path.append(stated)
    draft.traits.append(name)


def _frame(robot: Robot) -> str:
    """The tool, or the vehicle where there is none."""
    return robot.tools[0] if robot.tools else "base_link"


def _places(draft: Draft, frame: str) -> tuple[np.ndarray, np.ndarray]:
    """(3,) [m] of a frame at start and goal."""
    first = Kinematics(draft.robot, draft.start).pose(frame)
    last = Kinematics(draft.robot, draft.goal).pose(frame)
    return np.array(first.translation), np.array(last.translation)


def _plane_row(draft: Draft) -> None:
    """The vehicle stays above a height that start and goal hardly keep."""
    first, last = _places(draft, "base_link")
    lowest = min(first[2], last[2]) - float(draft.rng.uniform(0.02, 0.15))
    stated = PathRows(name="height", rows=lambda node: node.pose("base_link")[1][2], lower=lowest)
    _add_rows(draft, "height", stated, lambda stage: stage.tick.kinematics.pose("base_link")[1][2])


def _pillar_row(draft: Draft) -> None:
    """The vehicle goes round an upright pillar in its way."""
    first, last = _places(draft, "base_link")
    reach = float(np.linalg.norm((last - first)[:2])) / 2
    if reach < 0.15:
        return
    radius = float(draft.rng.uniform(0.25, 0.8)) * reach
    side = float(draft.rng.uniform(-0.7, 0.7)) * radius
    along = (last - first)[:2] / (2 * reach)
    x, y = ((first + last)[:2] / 2 + side * np.array([-along[1], along[0]])).tolist()

    def away(p: ca.SX) -> ca.SX:
        return ca.sqrt((p[0] - x) ** 2 + (p[1] - y) ** 2 + 1e-6)

    stated = PathRows(
        name="pillar", rows=lambda node: away(node.pose("base_link")[1]), lower=radius
    )
    _add_rows(
        draft, "pillar", stated, lambda stage: away(stage.tick.kinematics.pose("base_link")[1])
    )


def _altitude_row(draft: Draft) -> None:
    """The altimeter stays above the floor, by hardly less than at start or goal."""
    first, last = _places(draft, _ALTIMETER)
    threshold = float(draft.rng.uniform(0.5, 1.5))
    floor = min(first[2], last[2]) - threshold - float(draft.rng.uniform(0.01, 0.1))
    draft.floor = floor
    draft.constraints.append(TaskTerm(task=MinimumAltitude(threshold=threshold), at=At.PATH))
    draft.path.append(
        PathRows(
            name="altitude", rows=lambda node: node.pose(_ALTIMETER)[1][2] - floor, lower=threshold
        )
    )
    draft.traits.append("altitude")


def _wall_row(draft: Draft) -> None:
    """The tool stays on one side of a wall."""
    first, last = _places(draft, _frame(draft.robot))
    name = _frame(draft.robot)
    upper = max(first[0], last[0]) + float(draft.rng.uniform(0.01, 0.1))
    stated = PathRows(name="wall", rows=lambda node: node.pose(name)[1][0], upper=upper)
    _add_rows(draft, "wall", stated, lambda stage: stage.tick.kinematics.pose(name)[1][0])


def _tilt_row(draft: Draft) -> None:
    """The z axis of the first frame stays near where it is at start and goal."""
    name = _frame(draft.robot)
    first = Kinematics(draft.robot, draft.start).pose(name).rotation[2, 2]
    last = Kinematics(draft.robot, draft.goal).pose(name).rotation[2, 2]
    lower = min(first, last) - float(draft.rng.uniform(0.02, 0.2))
    stated = PathRows(name="tilt", rows=lambda node: node.pose(name)[0][2, 2], lower=lower)
    _add_rows(draft, "tilt", stated, lambda stage: stage.tick.kinematics.pose(name)[0][2, 2])


def _speed_row(draft: Draft) -> None:
    """All velocities together stay small."""
    robot = draft.robot
    limit = np.where(np.isfinite(robot.limits.velocity), robot.limits.velocity, 1.0)
    upper = float(draft.rng.uniform(0.3, 1.0))
    unit = ca.DM(limit)
    stated = PathRows(name="speed", rows=lambda node: ca.sumsqr(node.v / unit), upper=upper)
    _add_rows(draft, "speed", stated, lambda stage: ca.sumsqr(stage.tick.velocity / unit))


def _effort_row(draft: Draft) -> None:
    """All inputs together stay small."""
    upper = float(draft.rng.uniform(0.5, 2.0))
    stated = PathRows(name="all inputs", rows=effort, upper=upper, of_inputs=True)
    _add_rows(
        draft,
        "all inputs",
        stated,
        lambda stage: ca.sumsqr(stage.thrust_share) + ca.sumsqr(stage.torque_share),
    )


def _shapes(draft: Draft) -> None:
    _keep_apart(draft, n=int(draft.rng.integers(1, 4)), moves=False)


def _moving_shapes(draft: Draft) -> None:
    _keep_apart(draft, n=int(draft.rng.integers(1, 3)), moves=True)


def _own_links(draft: Draft) -> None:
    _keep_apart(draft, n=0, moves=False)


def _keep_apart(draft: Draft, *, n: int, moves: bool) -> None:
    """Shapes between start and goal, and the links of the robot among themselves."""
    robot = draft.robot
    rng = draft.rng
    margin = float(rng.uniform(0.0, 0.08))
    _spread_links(draft)
    obstacles: list[Obstacle] = []
    solids: list[Obstacle] = []
    for k in range(n):
        drawn = _free_obstacle(draft, f"obstacle {k}", margin)
        if drawn is not None:
            kind, obstacle, solid = drawn
            draft.traits.append(kind)
            obstacles.append(obstacle)
            solids.append(solid)
    places: dict[str, Callable[[float], pin.SE3]] = {}
    if moves:
        draft.moves = True
        places = {solid.name: _motion_of(draft, solid.X_WO) for solid in solids}
    scene = collision_scene(coordinates(robot), obstacles)
    if not scene.n_pairs:
        draft.traits.append("no pairs")
        return
    statement = _scene(robot, solids, margin)
    term = ShapeClearance(scene=scene, margins=statement.margins, moving=places)
    draft.constraints.append(term)
    draft.shapes = replace(statement, moving=places)


def _spread_links(draft: Draft) -> None:
    """Draw start and goal again until no links of the robot touch."""
    robot = draft.robot
    rng = draft.rng
    alone = _scene(robot, [], 0.0)
    for _ in range(_TRIES):
        if _least_room(alone, robot, draft.start) > _LINK_ROOM:
            break
        draft.start = _configuration(robot, rng, robot.configuration(), 0.0)
    for _ in range(_TRIES):
        draft.goal = _configuration(robot, rng, draft.start, _WAY)
        if _least_room(alone, robot, draft.goal) > _LINK_ROOM:
            break


def _free_obstacle(draft: Draft, name: str, margin: float) -> tuple[str, Obstacle, Obstacle] | None:
    """An obstacle that start and goal are free of, or none after many tries."""
    for _ in range(_TRIES):
        kind, obstacle, solid = _drawn_obstacle(draft, name)
        alone = _scene(draft.robot, [solid], margin, self_collision=False)
        rooms = [_least_room(alone, draft.robot, q) for q in (draft.start, draft.goal)]
        if min(rooms) > _ROOM:
            return kind, obstacle, solid
    return None


def _scene(
    robot: Robot, obstacles: list[Obstacle], margin: float, *, self_collision: bool = True
) -> ShapeRows:
    scene = collision_scene(coordinates(robot), obstacles, self_collision=self_collision)
    return ShapeRows(geometry=scene.geometry, margins=scene.per_pair(margin, 0.0))


def _least_room(shapes: ShapeRows, robot: Robot, q: np.ndarray) -> float:
    """[m] beyond the margins at q (n_q,) [m, rad]."""
    distances = Distances(robot, shapes).measure(q, 0.0)
    return float((distances - shapes.margins).min(initial=np.inf))


def _drawn_obstacle(draft: Draft, name: str) -> tuple[str, Obstacle, Obstacle]:
    """The kind of an obstacle near the way, itself, and the solid that it is."""
    rng = draft.rng
    first, last = _places(draft, _frame(draft.robot))
    across = rng.normal(size=3) * float(rng.uniform(0.0, 0.5))
    position = first + float(rng.uniform(0.2, 0.8)) * (last - first) + across
    rotation = pin.rpy.rpyToMatrix(*rng.uniform(-1.5, 1.5, 3))
    X = pin.SE3(rotation, position)
    size = rng.uniform(0.05, 0.35, 3)
    kind = _KINDS[int(rng.integers(len(_KINDS)))]
    solid: coal.CollisionGeometry = {
        "sphere": lambda: coal.Sphere(size[0]),
        "box": lambda: coal.Box(*(2 * size)),
        "capsule": lambda: coal.Capsule(size[0] / 2, 4 * size[1]),
        "cylinder": lambda: coal.Cylinder(size[0] / 2, 4 * size[1]),
        "cone": lambda: coal.Cone(size[0], 2 * size[1]),
        "ellipsoid": lambda: coal.Ellipsoid(*size),
        "mesh": lambda: coal.Box(*(2 * size)),
    }[kind]()
    shape = _box_mesh(size) if kind == "mesh" else solid
    obstacle = Obstacle(name=name, shape=shape, X_WO=X)
    return kind, obstacle, Obstacle(name=name, shape=solid, X_WO=X)


def _box_mesh(half: np.ndarray) -> coal.CollisionGeometry:
    """A closed surface of a box of half sizes (3,) [m]."""
    signs = np.array(list(product((-1, 1), repeat=3)))
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [(a, b, c) for a, b, c, _ in faces]
    triangles += [(a, c, d) for a, _, c, d in faces]
    return mesh_shape(signs * half, np.array(triangles))


def _motion_of(draft: Draft, X: pin.SE3) -> Callable[[float], pin.SE3]:
    """A straight motion that begins at a place."""
    rate = draft.rng.normal(size=3) * float(draft.rng.uniform(0.0, 0.08))

    def place(t: float) -> pin.SE3:
        return pin.SE3(X.rotation, X.translation + t * rate)

    return place


def _balls(draft: Draft) -> None:
    _keep_balls_apart(draft, fast=0.0)


def _moving_balls(draft: Draft) -> None:
    _keep_balls_apart(draft, fast=0.15)


def _keep_balls_apart(draft: Draft, *, fast: float) -> None:
    """Balls between start and goal, and one or two of the robot; fast [m/s]: at most."""
    robot = draft.robot
    rng = draft.rng
    frames = {_frame(robot)}
    largest_radius = 0.04
    if robot.n_vehicle:
        frames.add("base_link")
        largest_radius = 0.15
    radii = {}
    for frame in sorted(frames):
        radii[frame] = largest_radius if frame == "base_link" else largest_radius / 2
    margin = float(rng.uniform(0.0, 0.06))
    obstacles: list[tuple[np.ndarray, np.ndarray, float]] = []
    for _ in range(int(rng.integers(1, 4))):
        ball = _free_ball(draft, radii, margin)
        if ball is not None:
            centre, size = ball
            rate = fast * rng.uniform(-1.0, 1.0, 3)
            obstacles.append((centre, rate, size))
    if not obstacles:
        draft.traits.append("no balls")
        return
    obstacle_balls = []
    for centre, rate, size in obstacles:
        if fast:
            obstacle_balls.append(Ball(centre=_line(centre, rate), radius=size))
        else:
            obstacle_balls.append(Ball(centre=tuple(centre.tolist()), radius=size))
    term = BallClearance(
        robot_balls=tuple(Ball(frame=frame, radius=radius) for frame, radius in radii.items()),
        obstacles=tuple(obstacle_balls),
        margin=margin,
    )

    def gaps(node: Node) -> ca.SX:
        rows = []
        for frame, radius in radii.items():
            for centre, rate, size in obstacles:
                away = node.pose(frame)[1] - ca.DM(centre) - ca.DM(rate) * node.t
                rows.append(ca.sqrt(ca.sumsqr(away) + 1e-12) - radius - size)
        return ca.vertcat(*rows)

    draft.moves = fast > 0.0
    draft.constraints.append(term)
    draft.path.append(PathRows(name="balls", rows=gaps, lower=margin))


def _free_ball(
    draft: Draft, radii: dict[str, float], margin: float
) -> tuple[np.ndarray, float] | None:
    """Centre and radius [m] of a ball that start and goal are free of, or none after many tries.

    radii [m]: of the balls of the robot, by their frames.
    """
    rng = draft.rng
    frames = list(radii)
    for _ in range(_TRIES):
        first, last = _places(draft, frames[int(rng.integers(len(frames)))])
        spread = rng.normal(size=3) * float(rng.uniform(0.0, 0.3))
        centre = first + float(rng.uniform(0.2, 0.8)) * (last - first) + spread
        size = float(rng.uniform(0.04, 0.3))
        rooms = []
        for q in (draft.start, draft.goal):
            for frame, radius in radii.items():
                offset = Kinematics(draft.robot, q).pose(frame).translation - centre
                rooms.append(float(np.linalg.norm(offset)) - radius - size - margin)
        if min(rooms) > _ROOM:
            return centre, size
    return None


def _line(centre: np.ndarray, rate: np.ndarray) -> Callable[[float], tuple[np.ndarray, np.ndarray]]:
    def place(t: float) -> tuple[np.ndarray, np.ndarray]:
        return centre + t * rate, rate

    return place


_SURROUNDERS: dict[str, Callable[[Draft], None]] = {
    "open water": _open_water,
    "own rows": _own_rows,
    "shapes": _shapes,
    "moving shapes": _moving_shapes,
    "own links": _own_links,
    "balls": _balls,
    "moving balls": _moving_balls,
}


# Goals and costs.


def _problem(draft: Draft, robot_name: str) -> tuple[OcpProblem, tuple[Cost, ...]]:
    robot = draft.robot
    rng = draft.rng
    phases, free = _phases(draft)
    levels = _goal_levels(draft)
    if len(phases) > 1 and draft.chance(0.5):
        levels[0] = replace(levels[0], terms=(*levels[0].terms, _way_point(draft, phases[0].name)))
    cost_levels, costs = _cost_levels(draft, free=free)
    if draft.chance(0.85):
        draft.constraints.append(AtRest())
        limit = robot.limits.velocity
        unit = ca.DM(np.where(np.isfinite(limit) & (limit > 0.0), limit, 1.0))
        draft.ends.append(EndRows(name="at rest", rows=lambda node: node.v / unit))
    else:
        draft.traits.append("ends in motion")
    velocity = np.zeros(robot.n_v)
    if draft.chance(0.15):
        velocity = 0.3 * rng.uniform(-1.0, 1.0, robot.n_v) * np.minimum(robot.limits.velocity, 1.0)
        draft.traits.append("starts in motion")
    wrench = bool(robot.n_vehicle) and not robot.description.thrusters
    problem = OcpProblem(
        robot=robot,
        start=State(q=draft.start, v=velocity),
        phases=phases,
        levels=(*levels, *cost_levels),
        constraints=tuple(draft.constraints),
        current=_current(draft, sum(phase.n_steps for phase in phases)),
        floor=draft.floor,
        actuation=Actuation.WRENCH if wrench else Actuation.THRUSTERS,
    )
    return problem, costs


def _current(draft: Draft, n_steps: int) -> np.ndarray:
    rng = draft.rng
    if not draft.robot.n_vehicle or draft.chance(0.5):
        return np.zeros(3)
    current = rng.uniform(-1.0, 1.0, 3) * [_CURRENT, _CURRENT, 0.05]
    if draft.chance(0.2):
        draft.traits.append("current of steps")
        return np.asarray(np.linspace(0.2, 1.0, n_steps)[:, None] * current)
    draft.traits.append("current")
    return np.asarray(current)


def _phases(draft: Draft) -> tuple[tuple[OcpPhase, ...], bool]:
    """Phases, and whether their durations are free."""
    robot = draft.robot
    rng = draft.rng
    n_steps = round(float(np.exp(rng.uniform(np.log(FEWEST_STEPS), np.log(MOST_STEPS)))))
    way = np.abs(pin.difference(robot.model, draft.start, draft.goal))
    limits = robot.limits
    speed = np.where(np.isfinite(limits.velocity), limits.velocity, 1.0)
    acceleration = np.where(np.isfinite(limits.acceleration), limits.acceleration, 1.0)
    shortest = float((way / speed + 2 * (way / acceleration) ** 0.5).max(initial=1.0))
    whole = shortest * float(rng.uniform(1.5, 4.0))
    count = 1
    if not draft.chance(0.65):
        count = int(rng.integers(2, 4))
    free = not draft.moves and draft.chance(0.2)
    shares = rng.dirichlet(np.full(count, 2.0)) * 0.8 + 0.2 / count
    steps = rng.dirichlet(np.full(count, 2.0)) * 0.7 + 0.3 / count
    if count > 1:
        draft.traits.append(f"{count} phases")
    if free:
        draft.traits.append("free time")
    phases = []
    for k in range(count):
        nominal = whole * float(shares[k])
        n = max(2, round(n_steps * float(steps[k])))
        span = (0.7 * nominal, 1.5 * nominal) if free else nominal
        phases.append(OcpPhase(name=f"phase {k + 1}", n_steps=n, duration=span))
    return tuple(phases), free


def _goal_levels(draft: Draft) -> list[OcpLevel]:
    """Levels whose goals are all met at the drawn goal."""
    terms = [_goal_term(draft, kind) for kind in _goal_kinds(draft)]
    if len(terms) > 1 and draft.chance(0.6):
        draft.traits.append("strict levels")
        return [OcpLevel(name=term.name, terms=(term,)) for term in terms]
    return [OcpLevel(name="goals", terms=tuple(terms))]


def _goal_kinds(draft: Draft) -> list[str]:
    robot = draft.robot
    if not robot.n_joints:
        return ["vehicle"]
    kinds = ["tool pose"]
    if draft.chance(0.5) or robot.n_v < 6:
        kinds = ["tool position"]
    if not robot.tools:
        kinds = ["joints"]
    if robot.n_vehicle and draft.chance(0.4):
        if draft.chance(0.5):
            kinds.insert(0, "vehicle")
        else:
            kinds.append("vehicle")
    elif draft.chance(0.3) and "joints" not in kinds:
        kinds.append("joints")
    return kinds


def _goal_term(draft: Draft, kind: str) -> Term:
    robot = draft.robot
    kinematics = Kinematics(robot, draft.goal)
    if kind == "joints":
        values = _joint_values(robot, draft.goal)
        draft.ends.append(EndRows(name="joints", rows=lambda node: _ways(node, values)))
        return TaskTerm(task=JointTracking(joints=robot.joint_names, goal=values))
    frame = "base_link" if kind == "vehicle" else robot.tools[0]
    goal = kinematics.pose(frame)
    p = ca.DM(goal.translation)
    R = ca.DM(goal.rotation)
    draft.ends.append(EndRows(name=f"{kind}: place", rows=lambda node: node.pose(frame)[1] - p))
    if kind == "tool position":
        return TaskTerm(task=ToolPosition(frame=frame, goal=goal))

    def turn(node: Node) -> ca.SX:
        """Sine of the angle times the axis, which is 0 at half a turn too: guesses are nearer."""
        between = R.T @ node.pose(frame)[0]
        return ca.vertcat(
            between[2, 1] - between[1, 2],
            between[0, 2] - between[2, 0],
            between[1, 0] - between[0, 1],
        )

    draft.ends.append(EndRows(name=f"{kind}: attitude", rows=turn))
    if kind == "vehicle":
        return TaskTerm(task=VehiclePose(goal=goal))
    return TaskTerm(task=ToolPose(frame=frame, goal=goal))


def _ways(node: Node, values: np.ndarray) -> ca.SX:
    """(n_joints,) from joint values (n_joints,) [m, rad]."""
    rows = []
    for joint, value in zip(node.robot.joints, values.tolist(), strict=True):
        q = node.q[joint.q]
        if joint.endless:
            rows.append(q[1] * np.cos(value) - q[0] * np.sin(value))
        else:
            rows.append(q - value)
    return ca.vertcat(*rows)


def _way_point(draft: Draft, phase: str) -> Term:
    """A place that a frame passes at the end of the first phase."""
    robot = draft.robot
    rng = draft.rng
    between = pin.interpolate(robot.model, draft.start, draft.goal, float(rng.uniform(0.3, 0.7)))
    frame = _frame(robot)
    place = Kinematics(robot, between).pose(frame)
    p = ca.DM(place.translation)
    draft.ends.append(EndRows(name="way point", rows=lambda node: node.pose(frame)[1] - p, phase=0))
    draft.traits.append("way point")
    return TaskTerm(task=ToolPosition(name="way point", frame=frame, goal=place), phase=phase)


def _cost_levels(draft: Draft, *, free: bool) -> tuple[list[OcpLevel], tuple[Cost, ...]]:
    robot = draft.robot
    rng = draft.rng
    weight = float(rng.choice([0.01, 0.09, 0.5]))
    powers = all(thruster.power is not None for thruster in robot.description.thrusters)
    thrusters = bool(robot.description.thrusters) or not robot.n_vehicle
    kind = int(rng.integers(4))
    if kind == 1 and not (powers and thrusters):
        kind = 0
    terms: tuple[Term, ...]
    costs: tuple[Cost, ...]
    if kind == 1:
        terms = (Energy(), Smoothness(weight=weight))
        costs = (
            Cost(name="energy", density=electrical_power),
            Cost(name="smoothness", density=smoothness, weight=weight),
        )
        draft.traits.append("energy")
    elif kind == 2:
        terms = (Effort(),)
        costs = (Cost(name="effort", density=effort),)
        draft.traits.append("effort alone")
    else:
        terms = (Effort(), Smoothness(weight=weight))
        costs = (
            Cost(name="effort", density=effort),
            Cost(name="smoothness", density=smoothness, weight=weight),
        )
    if not free:
        return [OcpLevel(name="costs", terms=terms)], costs
    if draft.chance(0.4):
        draft.traits.append("time first")
        quick = OcpLevel(name="time", terms=(Duration(),), relax=0.05)
        below = tuple(replace(cost, level=1) for cost in costs)
        levels = [quick, OcpLevel(name="costs", terms=terms)]
        return levels, (Cost(name="duration", density=duration), *below)
    worth = float(rng.choice([0.001, 0.01, 0.1]))
    terms = (*terms, Duration(weight=worth))
    costs = (*costs, Cost(name="duration", density=duration, weight=worth))
    return [OcpLevel(name="costs", terms=terms)], costs


# Guesses.


def _guess(name: str, problem: OcpProblem, rng: np.random.Generator) -> Trajectory | None:
    if name == "default":
        return None
    if name == "hold":
        return hold_guess(problem)
    robot = problem.robot
    times = problem.nominal_times()
    if name == "noise":
        hold = hold_guess(problem)
        steps = rng.normal(size=(len(times), robot.n_v)) * float(rng.choice([0.01, 0.1, 0.5]))
        path = [pin.integrate(robot.model, problem.start.q, step) for step in steps]
        return replace(hold, q=np.array(path), v=rng.normal(size=hold.v.shape) * 0.1)
    places = [problem.start.q]
    for _ in range(2):
        places.append(_configuration(robot, rng, places[-1], 2 * _WAY))
    return guess_through(problem, times[[0, len(times) // 2, -1]], np.array(places))
