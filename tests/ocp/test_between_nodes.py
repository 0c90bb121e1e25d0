"""What a plan keeps at its nodes it keeps between them, and what a check says of a motion is what
dense samples of it say.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.ocp.ball_clearance import Ball, BallClearance
from uvms_ocp.ocp.clearance_certificate import certificate
from uvms_ocp.ocp.motion_check import motion_check
from uvms_ocp.ocp.motion_scan import FINE
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpLevel, OcpPhase, OcpProblem, single_phase
from uvms_ocp.ocp.range_check import MotionCheck, RangeKind
from uvms_ocp.ocp.shape_clearance import ShapeClearance
from uvms_ocp.ocp.terms import (
    At,
    AtRest,
    Effort,
    Smoothness,
    StageSymbols,
    TaskTerm,
    Term,
    residual_term,
)
from uvms_ocp.ocp.tightening import KEPT
from uvms_ocp.ocp.trajectory import Trajectory, hold_guess
from uvms_ocp.planning import collision_scene, coordinates
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.hydrodynamics import Water
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.obstacles import mesh_shape, obstacle
from uvms_ocp.robot.signals import State
from uvms_ocp.tasks.joints import JointTracking
from uvms_ocp.tasks.pose import VehiclePose

DENSE = 2000
CHEAP = OcpLevel(name="effort", terms=(Effort(), Smoothness(weight=0.09)))
DEPTH = -5.0


@pytest.fixture(scope="module")
def vehicle() -> Robot:
    return load_robot("bluerov2")


@pytest.fixture(scope="module")
def arm_vehicle() -> Robot:
    return load_robot("bluerov2_alpha5")


def dense_states(robot: Robot, path: Trajectory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (n,), q (n, n_q) and v (n, n_v), by the trajectory's own interpolation."""
    t = np.linspace(0.0, path.t[-1], DENSE)
    states = [path.state_at(robot.model, moment) for moment in t]
    return t, np.array([q for q, _, _ in states]), np.array([v for _, v, _ in states])


def frame_place(robot: Robot, q: np.ndarray, frame: str) -> np.ndarray:
    """(3,) [m] in W, whatever the limits."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return np.array(data.oMf[robot.model.getFrameId(frame)].translation)


def crossing(
    robot: Robot, constraints: Sequence[Term], *, n_steps: int, way: float = 3.0, **fields: Any
) -> OcpProblem:
    """Straight ahead by some way [m] in 20 s."""
    goal = pin.SE3(np.eye(3), np.array([way, 0.0, DEPTH]))
    start = State(q=robot.configuration(position=(0.0, 0.0, DEPTH)), v=np.zeros(robot.n_v))
    levels = [OcpLevel(name="go", terms=(TaskTerm(task=VehiclePose(goal=goal)),)), CHEAP]
    return single_phase(
        robot=robot,
        start=start,
        duration=20.0,
        n_steps=n_steps,
        levels=levels,
        constraints=(AtRest(), *constraints),
        **fields,
    )


def drawn_motion(problem: OcpProblem, seed: int) -> Trajectory:
    """Drawn accelerations from the start, integrated by MIDPOINT, with the forces that they take."""
    rng = np.random.default_rng(seed)
    robot = problem.robot
    guess = hold_guess(problem)
    h = np.diff(guess.t)
    q = guess.q.copy()
    v = guess.v.copy()
    a = rng.normal(size=guess.a.shape) * 0.3
    v[0] = problem.start.v
    for k, step in enumerate(h):
        q[k + 1] = pin.integrate(robot.model, q[k], step * v[k] + step**2 / 2 * a[k])
        v[k + 1] = v[k] + step * a[k]
    thrust = rng.normal(size=guess.thrust.shape) * 20.0
    torque = rng.normal(size=guess.torque.shape)
    return Trajectory(t=guess.t, q=q, v=v, a=a, thrust=thrust, torque=torque)


def peak_of(check: MotionCheck, kind: RangeKind, name: str | None = None) -> tuple[float, float]:
    """The worst anywhere, and the resolution."""
    items = [item for item in check.of(kind) if name in (None, item.name)]
    return max(item.worst.amount for item in items), max(item.resolution for item in items)


def assert_same(found: tuple[float, float], dense: float) -> None:
    """No dense sample is worse by more than the resolution, and what is found is there."""
    amount, resolution = found
    assert dense <= amount + resolution + 1e-9
    assert amount <= dense + 2e-3 + 0.02 * dense


# --- the check ----------------------------------------------------------------------------------------


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(4))
def test_a_check_says_what_dense_samples_say(arm_vehicle: Robot, seed: int) -> None:
    robot = arm_vehicle
    ball = Ball(frame="tool", radius=0.1)
    boat = Ball(centre=lambda t: (np.array([0.4 * t - 1.0, 0.3, DEPTH]), np.zeros(3)), radius=0.2)
    above = residual_term(
        "above",
        lambda stage: stage.tick.kinematics.pose("base_link")[1][2],
        lower=DEPTH - 0.05,
        upper=np.inf,
        at=At.PATH,
    )
    scene = collision_scene(
        coordinates(robot), [obstacle("box", coal.Box(0.4, 0.5, 0.3), (0.8, 0.2, DEPTH))]
    )
    shapes = ShapeClearance(scene=scene, margins=scene.per_pair(0.05, 0.01))
    start = robot.configuration(position=(0.0, 0.0, DEPTH), joints=robot.home)
    problem = single_phase(
        robot=robot,
        start=State(q=start, v=np.zeros(robot.n_v)),
        duration=4.0,
        n_steps=5 + seed,
        levels=[CHEAP],
        constraints=(
            BallClearance(robot_balls=(ball,), obstacles=(boat,), margin=0.02),
            above,
            shapes,
        ),
        current=np.array([0.2, -0.1, 0.0]),
    )
    path = drawn_motion(problem, seed)
    check = motion_check(problem, path)
    t, q, v = dense_states(robot, path)
    lower, upper = robot.configuration_bounds
    joints = robot.limited_positions
    over = np.maximum(q - upper, lower - q)[:, joints].max()
    assert_same(peak_of(check, RangeKind.POSITION), max(over, 0.0))
    fast = (np.abs(v) - robot.limits.velocity).max()
    assert_same(peak_of(check, RangeKind.VELOCITY), max(fast, 0.0))
    tools = np.array([frame_place(robot, row, "tool") for row in q])
    boats = np.array([boat.centre_at(moment) for moment in t])
    gap = 0.32 - np.linalg.norm(tools - boats, axis=1)
    assert_same(peak_of(check, RangeKind.TERM, "clearance"), max(gap.max(), 0.0))
    low = DEPTH - 0.05 - q[:, 2].min()
    assert_same(peak_of(check, RangeKind.TERM, "above"), max(low, 0.0))
    near = (shapes.margins - shapes.distances(t.tolist(), q)).max()
    assert_same(peak_of(check, RangeKind.CLEARANCE), max(near, 0.0))
    steps = np.clip(np.searchsorted(path.t, t, side="right") - 1, 0, len(path.a) - 1)
    dynamics = robot_dynamics(robot)
    water = Water(velocity=problem.current)
    forces = [
        dynamics.inverse_dynamics(*states, water)
        for states in zip(q, v, path.a[steps], strict=True)
    ]
    torque = np.abs(np.array(forces)[:, robot.n_vehicle :]) - robot.limits.effort
    amount, resolution = max(
        (item.between.amount, item.resolution) for item in check.of(RangeKind.TORQUE)
    )
    assert max(torque.max(), 0.0) <= amount + resolution + 1e-6


def test_a_check_finds_what_a_motion_breaks_of_its_laws(vehicle: Robot) -> None:
    problem = crossing(vehicle, (), n_steps=6)
    path = drawn_motion(problem, 3)
    clean = motion_check(problem, path)
    assert peak_of(clean, RangeKind.MOTION)[0] < 1e-9
    q = path.q.copy()
    q[3, 1] += 0.01
    moved = Trajectory(t=path.t, q=q, v=path.v, a=path.a, thrust=path.thrust, torque=path.torque)
    assert peak_of(motion_check(problem, moved), RangeKind.MOTION)[0] == pytest.approx(
        0.01, rel=0.2
    )
    (start,) = motion_check(
        problem,
        Trajectory(
            t=path.t,
            q=path.q + np.eye(len(q[0]))[0] * 0.02,
            v=path.v,
            a=path.a,
            thrust=path.thrust,
            torque=path.torque,
        ),
    ).of(RangeKind.START)
    assert start.worst.amount == pytest.approx(0.02)


def test_what_a_start_breaks_by_itself_is_no_fault_of_the_motion(arm_vehicle: Robot) -> None:
    robot = arm_vehicle
    v = np.zeros(robot.n_v)
    v[0] = robot.limits.velocity[0] + 0.3
    problem = single_phase(
        robot=robot,
        start=State(q=robot.configuration(position=(0.0, 0.0, DEPTH)), v=v),
        duration=2.0,
        n_steps=2,
        levels=[CHEAP],
    )
    held = hold_guess(problem)
    path = replace(held, v=np.vstack([v, held.v[1:]]))
    (speeds,) = motion_check(problem, path).of(RangeKind.VELOCITY)
    assert speeds.at_nodes.amount == 0.0
    path = replace(held, v=np.vstack([v, v, held.v[2:]]))
    (speeds,) = motion_check(problem, path).of(RangeKind.VELOCITY)
    assert speeds.at_nodes.amount == pytest.approx(0.3)
    assert speeds.at_nodes.time == pytest.approx(1.0)


def test_forces_of_the_first_step_are_the_motions_own(vehicle: Robot) -> None:
    problem = single_phase(
        robot=vehicle,
        start=State(q=vehicle.configuration(position=(0.0, 0.0, DEPTH)), v=np.zeros(vehicle.n_v)),
        duration=1.0,
        n_steps=1,
        levels=[CHEAP],
        current=np.array([3.0, 0.0, 0.0]),
    )
    check = motion_check(problem, hold_guess(problem))
    (thrust,) = check.of(RangeKind.THRUST)
    smallest_excess = 0.5 * np.max(thrust.upper)
    assert thrust.between.amount > smallest_excess
    assert thrust.above[0].max() > smallest_excess or thrust.below[0].max() > smallest_excess


# --- plans keep their ranges between nodes ------------------------------------------------------------


def assert_kept(problem: OcpProblem, plan: Plan) -> None:
    assert plan.status.value == "solved"
    check = motion_check(problem, plan.trajectory)
    kinds = (RangeKind.POSITION, RangeKind.VELOCITY, RangeKind.TERM, RangeKind.CLEARANCE)
    for item in check.of(*kinds):
        assert item.worst.amount <= 2 * KEPT, item.name


@pytest.mark.sampled
@pytest.mark.parametrize("draw", range(4))
def test_joint_limits_are_kept_between_nodes(arm_vehicle: Robot, draw: int) -> None:
    robot = arm_vehicle
    rng = np.random.default_rng(40 + draw)
    k = int(rng.integers(min(4, robot.n_joints)))
    lower = robot.limits.position_lower[k]
    upper = robot.limits.position_upper[k]
    room = rng.uniform(0.04, 0.08) * (upper - lower)
    joints = robot.home.copy()
    joints[k] = upper - room
    v = np.zeros(robot.n_v)
    i = robot.n_vehicle + k
    stops = np.sqrt(2 * room * min(robot.limits.acceleration[i], 5.0))
    v[i] = rng.uniform(0.4, 0.6) * min(robot.limits.velocity[i], stops)
    start = State(q=robot.configuration(position=(0.0, 0.0, DEPTH), joints=joints), v=v)
    task = JointTracking(joints=(robot.joint_names[k],), goal=[upper - 0.001])
    n_steps = int(rng.integers(3, 6))
    problem = single_phase(
        robot=robot,
        start=start,
        duration=2.0 * n_steps,
        n_steps=n_steps,
        levels=[OcpLevel(name="joint", terms=(TaskTerm(task=task),)), CHEAP],
        constraints=(AtRest(),),
    )
    plan = Planner(problem).plan()
    _, q, _ = dense_states(robot, plan.trajectory)
    own = q[:, robot.joint(robot.joint_names[k]).idx_q]
    assert own.max() <= upper + 2 * KEPT
    assert_kept(problem, plan)


@pytest.mark.sampled
@pytest.mark.parametrize(("n_steps", "aside"), [(5, 0.03), (9, -0.02), (14, 0.0)])
def test_a_thin_post_is_passed_and_not_passed_through(
    vehicle: Robot, n_steps: int, aside: float
) -> None:
    centre = np.array([1.55, aside, DEPTH])
    post = Ball(centre=lambda t: (centre, np.zeros(3)), radius=0.04)
    clear = BallClearance(robot_balls=(Ball(frame="base_link", radius=0.12),), obstacles=(post,))
    problem = crossing(vehicle, (clear,), n_steps=n_steps)
    plan = Planner(problem).plan()
    _, q, _ = dense_states(vehicle, plan.trajectory)
    assert np.linalg.norm(q[:, :3] - centre, axis=1).min() >= 0.04 + 0.12 + 0.05 - 2 * KEPT
    assert_kept(problem, plan)


@pytest.mark.sampled
@pytest.mark.parametrize(("n_steps", "late", "speed"), [(8, 0.3, 3.0), (20, 0.4, 4.0)])
def test_a_boat_does_not_pass_through_the_vehicle(
    vehicle: Robot, n_steps: int, late: float, speed: float
) -> None:
    across = pin.utils.rotate("z", np.pi / 2)

    def place(t: float) -> pin.SE3:
        return pin.SE3(across, np.array([1.5, speed * (t - 10.0 - late), DEPTH]))

    scene = collision_scene(
        coordinates(vehicle), [obstacle("boat", coal.Box(3.0, 1.0, 0.8), (0.0, 0.0, 0.0))]
    )
    clear = ShapeClearance(scene=scene, margins=scene.per_pair(0.05, None), moving={"boat": place})
    problem = crossing(vehicle, (clear,), n_steps=n_steps)
    plan = Planner(problem).plan()
    t, q, _ = dense_states(vehicle, plan.trajectory)
    assert clear.distances(t.tolist(), q).min() >= 0.05 - 2 * KEPT
    assert_kept(problem, plan)


def test_a_ball_that_moves_keeps_its_distance(vehicle: Robot) -> None:
    def centre(t: float) -> tuple[np.ndarray, np.ndarray]:
        return np.array([1.6, 2.0 * (t - 10.2), DEPTH]), np.array([0.0, 2.0, 0.0])

    clear = BallClearance(
        robot_balls=(Ball(frame="base_link", radius=0.2),),
        obstacles=(Ball(centre=centre, radius=0.25),),
    )
    problem = crossing(vehicle, (clear,), n_steps=18)
    plan = Planner(problem).plan()
    t, q, _ = dense_states(vehicle, plan.trajectory)
    gaps = np.linalg.norm(q[:, :3] - [centre(moment)[0] for moment in t], axis=1)
    assert gaps.min() >= 0.5 - 2 * KEPT
    assert_kept(problem, plan)


def own_floor(level: float) -> Callable[[StageSymbols], Any]:
    return lambda stage: stage.tick.kinematics.pose("base_link")[1][2] - level


@pytest.mark.sampled
@pytest.mark.parametrize(("sink", "room", "n_steps"), [(0.12, 0.1, 6), (0.08, 0.03, 10)])
def test_an_own_row_is_kept_between_nodes(
    vehicle: Robot, sink: float, room: float, n_steps: int
) -> None:
    level = DEPTH - room
    above = residual_term("above", own_floor(level), lower=0.0, upper=np.inf, at=At.PATH)
    problem = crossing(vehicle, (above,), n_steps=n_steps)
    start = State(q=problem.start.q, v=np.array([0.0, 0.0, -sink, 0.0, 0.0, 0.0]))
    sinking = single_phase(
        robot=vehicle,
        start=start,
        duration=12.0,
        n_steps=n_steps,
        levels=problem.levels,
        constraints=problem.constraints,
    )
    plan = Planner(sinking).plan()
    _, q, _ = dense_states(vehicle, plan.trajectory)
    assert q[:, 2].min() >= level - 2 * KEPT
    assert_kept(sinking, plan)


def test_a_motion_inside_a_closed_mesh_is_not_certified(vehicle: Robot) -> None:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    triangles = np.array(
        [
            (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
            (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
        ]
    )  # fmt: skip
    rock = obstacle("rock", mesh_shape(4.0 * corners, triangles), (0.0, 0.0, DEPTH))
    scene = collision_scene(coordinates(vehicle), [rock])
    term = ShapeClearance(scene=scene, margins=scene.per_pair(0.05, None))
    problem = crossing(vehicle, (term,), n_steps=4)
    report = certificate(term, hold_guess(problem))
    assert not report.collision_free
    assert report.nearest.distance < -1.0
    assert report.surfaces == ()
    (check,) = motion_check(problem, hold_guess(problem)).of(RangeKind.CLEARANCE)
    patch = obstacle("patch", mesh_shape(4.0 * corners, triangles[:4]), (0.0, 0.0, DEPTH))
    open_scene = collision_scene(coordinates(vehicle), [patch])
    own = ShapeClearance(scene=open_scene, margins=open_scene.per_pair(0.05, None))
    assert certificate(own, hold_guess(problem)).surfaces == ("patch",)
    assert check.resolution >= FINE


def test_a_constraint_of_one_phase_holds_to_its_end(vehicle: Robot) -> None:
    """The last step of the phase ended beyond it."""
    slow = residual_term(
        "slow",
        lambda stage: stage.tick.velocity[0],
        lower=-0.1,
        upper=0.1,
        at=At.PATH,
        phase="inspect",
    )
    problem = crossing(vehicle, (), n_steps=1)
    two = replace(
        problem,
        constraints=(AtRest(), slow),
        phases=(
            OcpPhase(name="inspect", duration=10.0, n_steps=8),
            OcpPhase(name="go", duration=7.0, n_steps=6),
        ),
    )
    plan = Planner(two).plan()
    assert_kept(two, plan)
    speed = plan.trajectory.v[:9, 0]
    assert speed.min() >= -1e-3  # nothing is undone to keep it
    assert speed[-1] == pytest.approx(0.1, abs=1e-3)
