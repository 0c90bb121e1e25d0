"""Laws of clearance by true shapes: distances as coal measures them, their derivatives, and proof
between the nodes.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import coal
import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.ocp.clearance_certificate import SteppedMotion, certificate, shortfall
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.separating_planes import support_of
from uvms_ocp.ocp.shape_clearance import ShapeClearance
from uvms_ocp.ocp.terms import AtRest, Effort, Smoothness, TaskTerm, Term
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.planning import CollisionScene, collision_scene, coordinates
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.obstacles import Obstacle, obstacle, seafloor
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers.nlp.options import NlpOptions
from uvms_ocp.tasks.joints import JointTracking
from uvms_ocp.tasks.pose import ToolPosition

TILT = pin.rpy.rpyToMatrix(0.4, 0.2, 0.1)
CORNERS = np.random.default_rng(3).normal(size=(20, 3)) * 0.2


def stone() -> coal.Convex:
    points = coal.StdVec_Vec3s()
    points.extend(list(CORNERS))
    return coal.Convex.convexHull(points, True, "")


SHAPES = {
    "sphere": lambda: coal.Sphere(0.2),
    "capsule": lambda: coal.Capsule(0.1, 0.5),
    "cylinder": lambda: coal.Cylinder(0.15, 0.5),
    "box": lambda: coal.Box(0.3, 0.2, 0.4),
    "cone": lambda: coal.Cone(0.2, 0.4),
    "convex mesh": stone,
}


LOWEST = {
    "sphere": lambda n, aside: -0.2,
    "capsule": lambda n, aside: -0.25 * abs(n[2]) - 0.1,
    "cylinder": lambda n, aside: -0.25 * abs(n[2]) - 0.15 * aside,
    "box": lambda n, aside: -np.abs(n) @ [0.15, 0.1, 0.2],
    "cone": lambda n, aside: min(0.2 * n[2], -0.2 * n[2] - 0.2 * aside),
    "convex mesh": lambda n, aside: (CORNERS @ n).min(),
}
"""[m] of the points of a shape along a direction; aside: the length of its part across z."""


@pytest.mark.parametrize("kind", SHAPES)
def test_the_point_that_is_farthest_against_a_direction_is_in_its_support(kind: str) -> None:
    drawn = np.random.default_rng(4).normal(size=(50, 3))
    normals = np.vstack([drawn / np.linalg.norm(drawn, axis=1)[:, None], np.eye(3), -np.eye(3)])
    support = support_of(SHAPES[kind](), normals, np.zeros((len(normals), 3)))
    lowest = np.einsum("nki,ni->nk", support.centres, normals).min(axis=1) - support.radius
    np.testing.assert_allclose(
        lowest, [LOWEST[kind](n, float(np.hypot(n[0], n[1]))) for n in normals], atol=1e-12
    )


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7_full")


def clearance(robot: Robot, things: list[Obstacle], margin: float = 0.0) -> ShapeClearance:
    scene = collision_scene(coordinates(robot), things)
    return ShapeClearance(scene=scene, margins=np.full(scene.n_pairs, margin))


def rows_of(term: ShapeClearance, robot: Robot) -> ca.Function:
    """Rows as a function of q and the parameters."""
    start = State(q=robot.configuration(), v=np.zeros(robot.n_v))
    level = OcpLevel(name="effort", terms=(Effort(),))
    model = StageModel(
        single_phase(robot=robot, start=start, duration=1.0, n_steps=1, levels=[level])
    )
    p = ca.SX.sym("p", term.n_parameters(robot))
    return ca.Function(
        "rows", [model.z[model.layout.q], p], [term.residual(model.symbols, p).value]
    )


def postures(robot: Robot, n: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    lower = robot.limits.position_lower
    upper = robot.limits.position_upper
    joints = [
        dict(zip(robot.joint_names, rng.uniform(lower, upper), strict=True)) for _ in range(n)
    ]
    return np.array(
        [
            robot.configuration(
                position=rng.uniform(-0.3, 0.3, 3), rpy=rng.uniform(-0.5, 0.5, 3), joints=one
            )
            for one in joints
        ]
    )


@pytest.mark.parametrize("kind", SHAPES)
def test_the_least_row_is_the_least_distance_apart_and_in_penetration(
    robot: Robot, kind: str
) -> None:
    term = clearance(robot, [obstacle("thing", SHAPES[kind](), [0.9, 0.1, -0.5], TILT)])
    rows = rows_of(term, robot)
    q = postures(robot, 40, 5)
    n_world = term.n_rows
    parameters = term.references([0.0] * len(q), q)
    true = term.distances([0.0] * len(q), q)
    of_thing = term.scene.groups()["thing"]
    others = np.setdiff1d(np.arange(term.scene.n_pairs), of_thing)
    values = np.array([np.array(rows(*pair)).ravel() for pair in zip(q, parameters, strict=True)])
    np.testing.assert_allclose(
        values[:, :n_world].min(axis=1), true[:, of_thing].min(axis=1), atol=1e-3
    )
    np.testing.assert_allclose(
        values[:, n_world:].min(axis=1), true[:, others].min(axis=1), atol=1e-3
    )
    assert true[:, of_thing].min() < 0.0 < true[:, of_thing].max()


def test_rows_of_single_pairs_have_the_distances_of_these_pairs_wherever_the_vehicle_is(
    robot: Robot,
) -> None:
    whole = clearance(robot, [])
    chosen = np.flatnonzero(whole.distances([0.0], robot.configuration()[None])[0] < 0.2)[:4]
    scene = whole.scene.among(chosen)
    term = ShapeClearance(scene=scene, margins=np.zeros(len(chosen)), n_pair_rows=8)
    q = apart(whole, postures(robot, 40, 5))
    values = rows_of(term, robot)
    parameters = term.references([0.0] * len(q), q)
    heights = np.array(
        [np.array(values(*pair)).ravel() for pair in zip(q, parameters, strict=True)]
    )
    true = whole.distances([0.0] * len(q), q)[:, chosen]
    np.testing.assert_allclose(heights.reshape(len(q), len(chosen), 8).min(axis=2), true, atol=1e-3)
    assert len(q) > 5
    _, columns = values.jacobian().sparsity_out(0).get_triplet()
    assert min(columns) >= 7  # what moves all links alike is left out


def test_what_rows_written_elsewhere_overlook_counts_as_off(robot: Robot) -> None:
    """Rows are few: a pair that has none was taken for one that agrees, however deep it was."""
    term = replace(clearance(robot, []), n_own_rows=1)
    written = apart(term, postures(robot, 40, 5))[:1]
    rows = rows_of(term, robot)
    parameters = term.references([0.0], written)[0]
    overlooked = 0
    for q in postures(robot, 40, 6):
        lack = -float(term.distances([0.0], q[None]).min())
        heights = np.array(rows(q, parameters)).ravel()
        if lack > 0.0 and heights.min() > 0.01:
            overlooked += 1
            assert term.mismatch([0.0], written, q[None]) >= lack - 1e-6
    assert overlooked > 3


def test_the_derivative_of_a_distance_is_between_those_of_its_least_rows(robot: Robot) -> None:
    """Of one row at a corner, of two where an edge lies along the plane."""
    term = clearance(robot, [obstacle("ball", coal.Sphere(0.2), [0.9, 0.1, -0.5])])
    step = 1e-5
    seen = 0
    rows = rows_of(term, robot)
    of_ball = term.scene.groups()["ball"]
    J = rows.jacobian()
    for q in apart(term, postures(robot, 60, 8))[:12]:
        p = term.references([0.0], q[None])[0]
        distances = term.distances([0.0], q[None])[0, of_ball]
        heights = np.array(rows(q, p)).ravel()[: term.n_rows]
        slopes = J(q, p, 0.0)[0].full()[: term.n_rows][heights < heights.min() + 1e-5]
        for axis in np.eye(robot.n_v):
            ends = np.array([pin.integrate(robot.model, q, sign * step * axis) for sign in (-1, 1)])
            pair = of_ball[int(np.argmin(distances))]
            slope = np.diff(term.distances([0.0] * 2, ends)[:, pair])[0] / (2 * step)
            found = slopes @ (ends[1] - ends[0]) / (2 * step)
            assert found.min() - 1e-3 <= slope <= found.max() + 1e-3
            seen += abs(slope) > 0.05
    assert seen > 30


def apart(term: ShapeClearance, q: np.ndarray) -> np.ndarray:
    """Those in which nothing touches: the depth of an overlap is not smooth."""
    return q[term.distances([0.0] * len(q), q).min(axis=1) > 0.01]


def test_rows_far_from_anything_are_wide_of_their_bounds(robot: Robot) -> None:
    term = replace(clearance(robot, [seafloor(-50.0)]), n_rows=400)
    q = robot.configuration()
    values = np.array(rows_of(term, robot)(q, term.references([0.0], q[None])[0])).ravel()
    assert values[: term.n_rows].max() == pytest.approx(50.0, abs=2.0)
    assert (values[: term.n_rows] >= 1.0).all()


# --- plans ----------------------------------------------------------------------------------------


def planar_problem(
    things: list[Obstacle], *, margin: float = 0.05, n_steps: int = 16
) -> tuple[OcpProblem, ShapeClearance]:
    """The planar robot moves sideways past what stands there."""
    planar = load_robot("planar5")
    term = clearance(planar, things, margin)
    goal = TaskTerm(task=JointTracking(joints=("x0", "y0"), goal=np.array([4.0, 0.0])))
    problem = single_phase(
        robot=planar,
        start=State(q=planar.configuration(), v=np.zeros(5)),
        duration=12.0,
        n_steps=n_steps,
        levels=[OcpLevel(name="goal", terms=(goal,)), OcpLevel(name="effort", terms=(Effort(),))],
        constraints=(AtRest(), term),
        water=False,
    )
    return problem, term


WAYS = {
    "ball": [obstacle("ball", coal.Sphere(0.3), [2.3, 1.4, 0.0])],
    "box": [
        obstacle(
            "box", coal.Box(0.4, 0.5, 1.0), [2.3, 1.3, 0.0], pin.rpy.rpyToMatrix(0.0, 0.0, 0.4)
        )
    ],
    "convex mesh": [obstacle("stone", stone(), [2.3, 1.2, 0.0])],
}


@pytest.mark.slow
@pytest.mark.parametrize("plugin", ["ipopt", "stagewise"])
@pytest.mark.parametrize("way", WAYS)
def test_a_plan_keeps_its_margin_between_nodes_too_and_says_what_coal_says(
    way: str, plugin: str
) -> None:
    problem, term = planar_problem(WAYS[way])
    free = Planner(
        replace(problem, constraints=(AtRest(),)), NlpOptions(time_limit=600.0, plugin="ipopt")
    ).plan()
    plan = Planner(problem, NlpOptions(time_limit=600.0, plugin=plugin)).plan()
    assert (free.status, plan.status) == (OcpStatus.SOLVED, OcpStatus.SOLVED)
    assert least(term, free.trajectory) < 0.04
    assert plan.certified_free
    assert plan.clearance is not None
    assert least(term, plan.trajectory) > 0.05 - 5e-4
    assert plan.clearance.nearest.distance == pytest.approx(least(term, plan.trajectory), abs=5e-3)
    assert shortfall(term, plan.trajectory, 0.0).max() < 1e-3


def least(term: ShapeClearance, path: Trajectory) -> float:
    t = np.linspace(0.0, path.t[-1], 2000)
    return float(
        term.distances(
            t.tolist(), SteppedMotion(term=term, trajectory=path).configurations(t)
        ).min()
    )


@pytest.mark.slow
@pytest.mark.parametrize("n_steps", [4, 8])
@pytest.mark.parametrize("way", WAYS)
def test_a_plan_is_called_solved_only_where_it_keeps_its_margin_between_nodes(
    way: str, n_steps: int
) -> None:
    """Of steps in which a link turns far, tighter nodes do not help, and a short dip is found as
    well.
    """
    problem, term = planar_problem(WAYS[way], n_steps=n_steps)
    plan = Planner(problem, NlpOptions(time_limit=600.0, plugin="stagewise")).plan()
    missed = max(0.05 - least(term, plan.trajectory), 0.0)
    assert plan.verdict is not None
    allowed = plan.verdict.tolerances.clearance
    assert shortfall(term, plan.trajectory, 0.0).max() == pytest.approx(missed, abs=1e-3)
    assert plan.status in (OcpStatus.SOLVED, OcpStatus.BROKEN)
    if plan.status is OcpStatus.SOLVED:
        assert missed <= 1.1 * allowed
    elif missed > 1.1 * allowed:
        assert "clearance" in plan.reason


@pytest.mark.sampled
@pytest.mark.parametrize("speed", [1.0, 0.0], ids=["steady", "a jump from node to node"])
def test_a_motion_through_a_thin_wall_between_two_nodes_is_not_certified(speed: float) -> None:
    problem, term = planar_problem([obstacle("sheet", coal.Box(0.001, 6.0, 6.0), [2.6, 0.0, 0.0])])
    free = Planner(replace(problem, constraints=(AtRest(),))).plan().trajectory
    hop = np.array([[0.0, 0, 0, 0, 0], [9.0, 0, 0, 0, 0]])
    inputs = {"a": np.zeros((1, 5)), "thrust": free.thrust[:1], "torque": free.torque[:1]}
    path = replace(
        free, t=np.array([0.0, 1.0]), q=hop, v=speed * np.repeat(hop[1:], 2, axis=0), **inputs
    )
    assert term.distances([0.0, 1.0], hop).min() > 0.1
    report = certificate(term, path)
    assert not report.collision_free
    assert report.nearest.distance <= 0.0 or report.undecided


def test_bounds_of_a_turning_vehicle_hold_for_every_point_of_it(robot: Robot) -> None:
    rng = np.random.default_rng(2)
    term = clearance(robot, [obstacle("ball", coal.Sphere(0.2), [0.9, 0.1, -0.5])])
    q = robot.configuration(rpy=(0.2, -0.3, 0.5))
    v = rng.normal(size=(2, robot.n_v))
    a = rng.normal(size=(1, robot.n_v))
    end = pin.integrate(robot.model, q, 0.8 * v[0] + 0.32 * a[0])
    path = Trajectory(
        t=np.array([0.0, 0.8]),
        q=np.array([q, end]),
        v=v,
        a=a,
        thrust=np.zeros((1, 8)),
        torque=np.zeros((1, 7)),
    )
    motion = SteppedMotion(term=term, trajectory=path)
    middle = np.linspace(0.1, 0.7, 13)
    half = np.full(13, 0.1)
    bound = motion.bounds(middle, half) @ term.scene.reach.T
    there = motion.distances(middle)
    for share in (-1.0, -0.5, 0.5, 1.0):
        moved = np.abs(motion.distances(middle + share * half) - there)
        assert (moved <= bound + 1e-7).all()
        assert moved.max() > 0.02 * bound.max()


def test_a_straight_steady_motion_goes_as_far_as_its_bounds() -> None:
    planar = load_robot("planar5")
    term = clearance(planar, [obstacle("ball", coal.Sphere(0.2), [9.0, 0.0, 0.0])])
    speed = np.linspace(0.1, 0.5, 5)
    ways = {"q": np.outer([0.0, 2.0], speed), "v": np.tile(speed, (2, 1)), "a": np.zeros((1, 5))}
    path = Trajectory(
        t=np.array([0.0, 2.0]), **ways, thrust=np.zeros((1, 0)), torque=np.zeros((1, 5))
    )
    bounds = SteppedMotion(term=term, trajectory=path).bounds(
        np.array([0.5, 1.0]), np.array([0.25, 1.0])
    )
    np.testing.assert_allclose(bounds, np.outer([0.25, 1.0], speed), atol=1e-12)


def test_a_straight_steady_motion_of_a_vehicle_is_bounded_by_its_speed(robot: Robot) -> None:
    term = clearance(robot, [obstacle("ball", coal.Sphere(0.2), [9.0, 0.1, -0.5])])
    q = robot.configuration(rpy=(0.2, -0.3, 0.5))
    v = np.zeros((2, robot.n_v))
    v[:, :3] = 0.3, -0.4, 1.2
    path = {
        "q": np.array([q, pin.integrate(robot.model, q, 2.0 * v[0])]),
        "v": v,
        "a": np.zeros((1, robot.n_v)),
    }
    inputs = {"thrust": np.zeros((1, 8)), "torque": np.zeros((1, 7))}
    motion = SteppedMotion(
        term=term, trajectory=Trajectory(t=np.array([0.0, 2.0]), **path, **inputs)
    )
    bounds = motion.bounds(np.array([1.0]), np.array([0.5]))
    np.testing.assert_allclose(bounds[0], [0.5 * 1.3, *np.zeros(robot.n_v - 1)], atol=1e-12)


def test_links_of_one_robot_stay_apart() -> None:
    planar = load_robot("planar5")
    term = clearance(planar, [], 0.3)
    fold = TaskTerm(task=JointTracking(joints=("theta1", "theta2"), goal=np.array([0.6, 2.5])))
    problem = single_phase(
        robot=planar,
        start=State(q=planar.configuration(), v=np.zeros(5)),
        duration=10.0,
        n_steps=10,
        levels=[OcpLevel(name="fold", terms=(fold,)), OcpLevel(name="effort", terms=(Effort(),))],
        constraints=(AtRest(), term),
        water=False,
    )
    free, kept = (
        Planner(one, NlpOptions(time_limit=600.0)).plan(diagnose=False)
        for one in (replace(problem, constraints=(AtRest(),)), problem)
    )
    assert least(term, free.trajectory) < 0.2
    assert least(term, kept.trajectory) > 0.3 - 1e-3
    assert kept.certified_free


@pytest.mark.slow
def test_a_soft_level_gives_way_to_what_is_above_and_yields_to_nothing_below() -> None:
    problem, term = planar_problem(WAYS["ball"], margin=0.3)
    without = OcpLevel(name="effort", terms=(Effort(),))
    soft = OcpLevel(name="clearance", terms=(replace(term, weight=10.0),))
    above = replace(problem, levels=(problem.levels[0], soft, without), constraints=(AtRest(),))
    plain = replace(problem, constraints=(AtRest(),))
    wide, narrow = (
        Planner(one, NlpOptions(time_limit=600.0)).plan(diagnose=False) for one in (above, plain)
    )
    assert wide.levels[0].residual < 1e-3
    assert least(term, wide.trajectory) > least(term, narrow.trajectory) + 0.05


@pytest.mark.slow
def test_an_obstacle_that_moves_is_where_it_is_at_the_time_of_the_node() -> None:
    problem, term = planar_problem([obstacle("ball", coal.Sphere(0.3), [2.0, 9.0, 0.0])])
    still = Planner(problem, NlpOptions(time_limit=600.0)).plan()
    meeting = Kinematics(problem.robot, still.trajectory.q[8]).pose("tool").translation + np.array(
        [0.0, 0.25, 0.0]
    )
    coming = replace(
        term,
        moving={
            "ball": lambda t: pin.SE3(np.eye(3), meeting + max(0.0, 3.0 - 0.5 * t) * np.eye(3)[1])
        },
    )
    plan = Planner(
        replace(problem, constraints=(AtRest(), coming)), NlpOptions(time_limit=600.0)
    ).plan()
    assert plan.status is OcpStatus.SOLVED
    assert least(coming, still.trajectory) < 0.0
    assert least(coming, plan.trajectory) > 0.05 - 1e-3
    assert not plan.certified_free


def test_a_start_in_penetration_is_named_by_its_depth_and_pair() -> None:
    problem, term = planar_problem([obstacle("ball", coal.Sphere(0.3), [0.0, 0.0, 0.0])])
    plan = Planner(problem).plan()
    assert plan.status is OcpStatus.OBSTRUCTED
    distances = term.distances([0.0], problem.start.q[None])[0]
    nearest = int((term.margins - distances).argmax())
    assert plan.reason.startswith("clearance is broken by ")
    assert (
        f"({term.scene.pairs[nearest].name}: {distances[nearest]:.4g} m apart, margin 0.05 m)"
        in plan.reason
    )
    assert not plan.certified_free


def test_mistakes_are_refused_in_one_line(robot: Robot) -> None:
    scene: CollisionScene = collision_scene(coordinates(robot), [seafloor(-5.0)])
    with pytest.raises(InvalidInput, match=r"margins .* give one finite number"):
        ShapeClearance(scene=scene, margins=np.zeros(3))
    level = collision_scene(coordinates(robot, axes=("x", "y")), [seafloor(-5.0)])
    with pytest.raises(InvalidInput, match="give one that plans all axes"):
        ShapeClearance(scene=level, margins=np.zeros(level.n_pairs))
    with pytest.raises(NameNotFound, match="moving obstacle"):
        ShapeClearance(
            scene=scene,
            margins=np.zeros(scene.n_pairs),
            moving={"whale": lambda t: pin.SE3.Identity()},
        )


def test_the_term_counts_what_it_is_asked() -> None:
    _, term = planar_problem(WAYS["ball"])
    assert isinstance(term, Term)
    assert term.reference(0.0).shape == (term.n_parameters(load_robot("planar5")),)


def test_every_pair_that_is_near_has_a_row_before_another_has_two() -> None:
    """One pair that is always near had all rows, and others were passed through."""
    robot = load_robot("bluerov2_alpha5")
    scene = collision_scene(
        coordinates(robot), [obstacle("ball", coal.Sphere(0.3), (0.7, 0.0, -5.0))]
    )
    term = ShapeClearance(scene=scene, margins=scene.per_pair(0.06, 0.0), n_rows=9, n_own_rows=7)
    rng = np.random.default_rng(2)
    lower = robot.limits.position_lower
    upper = robot.limits.position_upper
    shares = rng.uniform(0.2, 0.8, (8, robot.n_joints))
    q = np.array(
        [
            robot.configuration(position=(0.0, 0.0, -5.0), joints=lower + share * (upper - lower))
            for share in shares
        ]
    )
    times = [0.0] * len(q)
    near = term.distances(times, q) - term.margins < 0.2
    margins = np.broadcast_to(term.margins, near.shape)
    for group, planes in zip(term._groups, term._chosen(times, q, margins), strict=True):
        for k in range(len(q)):
            pairs = planes.pair[planes.sample == k]
            asked = np.flatnonzero(group.pairs & near[k])
            assert len(set(pairs.tolist()) & set(asked.tolist())) == min(len(asked), group.n)


@pytest.mark.slow
def test_a_plan_around_a_ball_keeps_the_arm_out_of_the_hull() -> None:
    robot = load_robot("bluerov2_alpha5")
    start = robot.configuration(position=(0.0, 0.0, -5.0))
    tool = Kinematics(robot, start).pose("tool")
    goal = pin.SE3(tool.rotation, tool.translation + np.array([2.0, 0.3, -0.4]))
    scene = collision_scene(
        coordinates(robot), [obstacle("ball", coal.Sphere(0.3), (1.2, 0.1, -5.2))]
    )
    term = ShapeClearance(scene=scene, margins=scene.per_pair(0.06, 0.0))
    problem = single_phase(
        robot=robot,
        start=State(q=start, v=np.zeros(robot.n_v)),
        duration=10.0,
        n_steps=40,
        levels=[
            OcpLevel(name="tool", terms=(TaskTerm(task=ToolPosition(goal=goal)),)),
            OcpLevel(name="effort", terms=(Effort(), Smoothness(weight=0.09))),
        ],
        constraints=(AtRest(), term),
    )
    plan = Planner(problem).plan()
    assert plan.status is OcpStatus.SOLVED
    times = np.linspace(0.0, 10.0, 400)
    dense = [plan.trajectory.state_at(robot.model, t)[0] for t in times]
    assert (term.distances([0.0] * len(dense), np.array(dense)) - term.margins).min() > -1e-3
