"""Laws of collision costs and of plans around obstacles."""

import itertools

import coal
import numpy as np
import pinocchio as pin
import pytest
from curves.closed_forms import ClosedFormDistances, collision_density, density_hessian

from uvms_ocp.collision.capsules import capsule_robot
from uvms_ocp.collision.coal_distances import CoalDistances
from uvms_ocp.collision.collision_scene import CollisionScene, collision_scene
from uvms_ocp.collision.conservative_advancement import check_clearance
from uvms_ocp.collision.coordinates import Coordinates, coordinates
from uvms_ocp.exceptions import FrameNotFound, InvalidInput, NameNotFound
from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.shapes.obstacles import obstacle
from uvms_ocp.planning.block_tridiagonal import BlockTridiagonal
from uvms_ocp.planning.inverse_kinematics import ToolGoalOptions, tool_goal
from uvms_ocp.planning.ipopt_descent import IpoptOptions
from uvms_ocp.planning.link_speed import link_speeds
from uvms_ocp.planning.path_cost import CostWeights, Distances, PathCost
from uvms_ocp.planning.penalty import outside, penalty, two_sided
from uvms_ocp.planning.sampling import SamplingOptions, edge_reach, sampled_waypoints
from uvms_ocp.planning.soft_collision import (
    PlanStatus,
    SoftCollisionOptions,
    plan_soft_collision,
    straight_start,
)
from uvms_ocp.tasks.joints import JointTracking
from uvms_ocp.trajectories.free_derivatives import pieces_of
from uvms_ocp.trajectories.segment_times import MotionLimits

N = 13
SPHERE = obstacle("ball", coal.Sphere(0.3), [1.6, 0.1, -0.3])
PIPE = obstacle("pipe", coal.Capsule(0.2, 1.0), [1.0, 1.2, 0.0])


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7")


@pytest.fixture(scope="module")
def planned(robot: Robot) -> Coordinates:
    return coordinates(robot)


@pytest.fixture(scope="module")
def scene(planned: Coordinates) -> CollisionScene:
    return collision_scene(planned, [SPHERE, PIPE])


@pytest.fixture(scope="module")
def capsule_scene(robot: Robot) -> CollisionScene:
    return collision_scene(coordinates(capsule_robot(robot)), [SPHERE, PIPE])


def limits_of(robot: Robot) -> MotionLimits:
    return MotionLimits(velocity=robot.limits.velocity, acceleration=robot.limits.acceleration)


def random_x(planned: Coordinates, n: int, spread: float = 0.2) -> np.ndarray:
    lower, upper = planned.limits()
    home = planned.x(planned.robot.configuration())
    return np.clip(home + spread * np.random.default_rng(0).normal(size=(n, N)), lower, upper)


def differences(function, x: np.ndarray, h: float) -> np.ndarray:  # type: ignore[no-untyped-def]
    """(size of x, ...) central differences."""
    steps = h * np.eye(x.size).reshape(x.size, *x.shape)
    return np.array([(function(x + s) - function(x - s)) / (2 * h) for s in steps])


# --- coordinates -----------------------------------------------------------------------------------------------------


def test_coordinates_and_configurations_are_inverse(planned: Coordinates) -> None:
    x = random_x(planned, 20)
    again = np.array([planned.x(q) for q in planned.configurations(x)])
    np.testing.assert_allclose(again, x, atol=1e-12)


def test_axes_that_are_not_planned_keep_their_reference(robot: Robot) -> None:
    q = robot.configuration(position=[1.0, 2.0, 3.0], rpy=[0.0, 0.1, 0.2])
    arm = coordinates(robot, reference=q, axes=robot.joint_names)
    np.testing.assert_allclose(arm.configurations(arm.x(q)[None])[0], q, atol=1e-12)
    assert arm.names == robot.joint_names
    with pytest.raises(NameNotFound, match="joint1"):
        coordinates(robot, axes=["joint01"])


# --- penalties -------------------------------------------------------------------------------------------------------


def test_the_penalty_is_twice_differentiable_and_convex() -> None:
    y, h = np.linspace(-0.5, 3.0, 701), 1e-6
    up, here, down = penalty(y + h), penalty(y), penalty(y - h)
    np.testing.assert_allclose(here.slope, (up.value - down.value) / (2 * h), atol=1e-8)
    np.testing.assert_allclose(here.curvature, (up.slope - down.slope) / (2 * h), atol=1e-6)
    assert (here.curvature >= 0.0).all()


def test_limit_penalties_match_their_differences_on_both_sides() -> None:
    v, h = np.linspace(-2.0, 2.0, 401), 1e-6
    for f in (
        lambda z: two_sided(z, np.array(1.0), 0.2),
        lambda z: outside(z, np.array(-1.0), np.array(0.5), 0.1),
    ):
        np.testing.assert_allclose(f(v).slope, (f(v + h).value - f(v - h).value) / (2 * h), atol=1e-6)
        np.testing.assert_allclose(f(v).curvature, (f(v + h).slope - f(v - h).slope) / (2 * h), atol=1e-3)
    assert two_sided(np.array([1e9]), np.array([np.inf]), 0.1).value == 0.0


# --- distances -------------------------------------------------------------------------------------------------------


def test_gradients_of_coal_distances_match_differences(scene: CollisionScene) -> None:
    distances, x = CoalDistances(scene), random_x(scene.coordinates, 10)
    near = distances.near(x, np.full(scene.n_pairs, 0.3))
    assert near.sample.size > 50
    for sample in range(10):
        slopes = differences(lambda z: distances.distances(z[None])[0], x[sample], 1e-4)
        mine = near.sample == sample
        found = near.gradient[mine]
        np.testing.assert_allclose(found, slopes.T[near.pair[mine]], atol=2e-4)


def test_remembered_bounds_do_not_change_what_is_near(scene: CollisionScene) -> None:
    warm, x = CoalDistances(scene), random_x(scene.coordinates, 30)
    thresholds = np.full(scene.n_pairs, 0.1)
    for size in (0.0, 0.01, 0.1, 0.01):
        x = x + size
        again, fresh = warm.near(x, thresholds), CoalDistances(scene).near(x, thresholds)
        np.testing.assert_array_equal(again.pair, fresh.pair)
        np.testing.assert_array_equal(again.sample, fresh.sample)
        np.testing.assert_allclose(again.gradient, fresh.gradient, atol=1e-4)


def test_no_distance_changes_faster_than_its_reach(scene: CollisionScene) -> None:
    near = CoalDistances(scene).near(random_x(scene.coordinates, 50, 0.5), np.full(scene.n_pairs, 10.0))
    assert (np.abs(near.gradient) <= scene.reach[near.pair] + 1e-9).all()


def test_closed_forms_equal_coal(capsule_scene: CollisionScene) -> None:
    x, thresholds = random_x(capsule_scene.coordinates, 100), np.full(capsule_scene.n_pairs, 0.2)
    closed, exact = ClosedFormDistances(capsule_scene), CoalDistances(capsule_scene)
    np.testing.assert_allclose(closed.distances(x), exact.distances(x), atol=1e-9)
    a, b = closed.near(x, thresholds), exact.near(x, thresholds)
    np.testing.assert_array_equal(a.pair, b.pair)
    np.testing.assert_allclose(a.gradient, b.gradient, atol=1e-9)
    np.testing.assert_allclose(a.centre, b.centre, atol=1e-12)


def test_a_robot_covered_by_capsules_is_nowhere_smaller(robot: Robot, planned: Coordinates) -> None:
    x = random_x(planned, 50)
    exact = collision_scene(planned, [SPHERE, PIPE], self_collision=False)
    covered = collision_scene(coordinates(capsule_robot(robot)), [SPHERE, PIPE], self_collision=False)
    assert (
        CoalDistances(covered).distances(x).min(axis=1) <= CoalDistances(exact).distances(x).min(axis=1) + 1e-6
    ).all()


def test_shapes_without_closed_form_are_refused(scene: CollisionScene) -> None:
    with pytest.raises(InvalidInput, match="Box has no closed form"):
        ClosedFormDistances(scene)


def test_speeds_of_links_match_differences(scene: CollisionScene) -> None:
    distances, thresholds = CoalDistances(scene), np.full(scene.n_pairs, 10.0)
    x, v = random_x(scene.coordinates, 1)[0], 0.3 * np.random.default_rng(1).normal(size=N)

    def speeds(z: np.ndarray, rates: np.ndarray) -> np.ndarray:
        near = distances.near(z[None], thresholds)
        return link_speeds(scene, near, np.tile(rates, (near.sample.size, 1)), 0.02).speed

    near = distances.near(x[None], thresholds)
    found = link_speeds(scene, near, np.tile(v, (near.sample.size, 1)), 0.02)
    np.testing.assert_allclose(found.by_position, differences(lambda z: speeds(z, v), x, 1e-6).T, atol=1e-7)
    np.testing.assert_allclose(found.by_rate, differences(lambda z: speeds(x, z), v, 1e-6).T, atol=1e-7)


# --- cost ------------------------------------------------------------------------------------------------------------


def cost_of(distances: Distances, weights: CostWeights) -> tuple[PathCost, np.ndarray]:
    rng, n_pieces = np.random.default_rng(3), 4
    pieces = pieces_of(rng.uniform(1.0, 2.0, n_pieces), 4)
    limits = MotionLimits(velocity=0.3, acceleration=0.5)
    cost = PathCost(distances=distances, pieces=pieces, weights=weights, limits=limits)
    values = 0.1 * rng.normal(size=(4, n_pieces + 1, N))
    values[0] += random_x(distances.scene.coordinates, 1)[0] + np.linspace(0, 0.5, n_pieces + 1)[:, None]
    return cost, cost.variables(values)


@pytest.mark.parametrize(
    "weights",
    [
        CostWeights(smoothness=1e-6, collision=0.0, limits=0.0),
        CostWeights(smoothness=0.0, collision=100.0, limits=0.0, clearance=0.3),
        CostWeights(smoothness=0.0, collision=0.0, limits=1.0),
    ],
    ids=["smoothness", "collision", "limits"],
)
def test_each_part_of_the_gradient_matches_differences(capsule_scene: CollisionScene, weights: CostWeights) -> None:
    cost, y = cost_of(ClosedFormDistances(capsule_scene), weights)
    found = cost.model(y)
    assert found.parts.total > 0.0
    slopes = differences(lambda z: cost.model(z).parts.total, y, 1e-6).reshape(y.shape)
    np.testing.assert_allclose(found.gradient, slopes, atol=1e-6 * np.abs(slopes).max())


def test_the_gradient_with_coal_matches_differences(scene: CollisionScene) -> None:
    cost, y = cost_of(CoalDistances(scene), CostWeights(clearance=0.3, smoothness=1e-6))
    found, rng = cost.model(y), np.random.default_rng(0)
    for _ in range(20):
        step = 1e-5 * rng.normal(size=y.shape)
        slope = cost.model(y + step).parts.total - cost.model(y - step).parts.total
        assert slope == pytest.approx(
            2.0 * np.sum(found.gradient * step), rel=1e-4, abs=1e-7 * np.abs(found.gradient).max()
        )


def test_the_hessian_of_the_optimiser_is_positive_semi_definite(capsule_scene: CollisionScene) -> None:
    cost, y = cost_of(ClosedFormDistances(capsule_scene), CostWeights(clearance=0.3))
    eigenvalues = np.linalg.eigvalsh(cost.model(y).hessian.dense())
    assert eigenvalues[0] > -1e-10 * eigenvalues[-1]


def test_the_exact_hessian_of_the_collision_cost_matches_differences(capsule_scene: CollisionScene) -> None:
    weights = CostWeights(clearance=0.3)
    hessian = density_hessian(collision_density(capsule_scene, weights))
    x = random_x(capsule_scene.coordinates, 3)
    v = 0.3 * np.random.default_rng(1).normal(size=x.shape)
    for z in np.concatenate([x, v], axis=1):
        blocks, slope = hessian(z)
        found = np.asarray(blocks)
        slopes = differences(lambda y: np.asarray(hessian(y)[1]).ravel(), z, 1e-6)
        assert np.abs(found).max() > 0.0
        np.testing.assert_allclose(found, slopes, atol=1e-6 * np.abs(found).max())
        assert slope.shape == (2 * N, 1)


def test_the_collision_cost_equals_its_closed_form(capsule_scene: CollisionScene) -> None:
    weights = CostWeights(clearance=0.3, smoothness=0.0, limits=0.0)
    cost, y = cost_of(ClosedFormDistances(capsule_scene), weights)
    x, v, _ = cost.samples(y)
    density = collision_density(capsule_scene, weights)
    h = cost.pieces.durations * cost.pieces.unit / weights.samples
    total = sum(h[j] * float(density(x[i, j], v[i, j])) for i in range(weights.samples) for j in range(len(h)))
    assert cost.model(y).parts.collision == pytest.approx(total, rel=1e-9)


def test_a_block_tridiagonal_solve_is_the_dense_one() -> None:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(6, 4, 4))
    matrix = BlockTridiagonal(diagonal=A @ A.transpose(0, 2, 1) + 20 * np.eye(4), below=rng.normal(size=(5, 4, 4)))
    right, factor = rng.normal(size=(6, 4)), matrix.cholesky()
    assert factor is not None
    np.testing.assert_allclose(factor.solve(right).ravel(), np.linalg.solve(matrix.dense(), right.ravel()), rtol=1e-10)
    np.testing.assert_allclose(matrix.times(right).ravel(), matrix.dense() @ right.ravel(), rtol=1e-12)
    indefinite = BlockTridiagonal(diagonal=-np.ones((2, 1, 1)), below=np.zeros((1, 1, 1)))
    assert indefinite.cholesky() is None


# --- plans -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def ends(planned: Coordinates) -> np.ndarray:
    """Two poses with a ball in the way of the arm and the hull."""
    start = planned.x(planned.robot.configuration())
    return np.stack([start, start + np.concatenate([[0.0, 1.6, 0.0], np.zeros(10)])])


@pytest.fixture(scope="module")
def blocked(planned: Coordinates) -> CollisionScene:
    return collision_scene(planned, [obstacle("ball", coal.Sphere(0.25), [0.9, 0.8, -0.5])])


def test_a_straight_line_through_an_obstacle_is_bent_around_it(
    robot: Robot, blocked: CollisionScene, ends: np.ndarray
) -> None:
    exact, limits = CoalDistances(blocked), limits_of(robot)
    assert not check_clearance(exact, straight_start(ends, limits)).collision_free
    plan = plan_soft_collision(blocked, ends, limits=limits)
    t = np.linspace(plan.trajectory.start, plan.trajectory.end, 3000)
    assert plan.status is PlanStatus.FREE
    assert exact.distances(plan.trajectory.evaluate(t)).min() > 0.0
    assert limits.ratio(plan.trajectory) == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(plan.trajectory.evaluate([t[0], t[-1]]), ends, atol=1e-10)
    np.testing.assert_allclose(plan.trajectory.evaluate([t[0], t[-1]], 1), 0.0, atol=1e-10)
    assert plan.clearance.pair in {pair.name for pair in blocked.pairs}
    assert plan.status.advice


def test_given_times_are_kept_where_the_limits_allow(robot: Robot, blocked: CollisionScene, ends: np.ndarray) -> None:
    slow = plan_soft_collision(blocked, ends, limits=limits_of(robot), times=[2.0, 62.0])
    assert (slow.trajectory.start, slow.trajectory.end) == (2.0, 62.0)
    hurried = plan_soft_collision(blocked, ends, limits=limits_of(robot), times=[0.0, 0.5])
    assert limits_of(robot).ratio(hurried.trajectory) == pytest.approx(1.0, abs=1e-9)


def test_way_points_are_kept_on_request(robot: Robot, blocked: CollisionScene, ends: np.ndarray) -> None:
    over = ends.mean(axis=0)
    over[2] += 1.0
    waypoints = np.stack([ends[0], over, ends[1]])
    options = SoftCollisionOptions(free_waypoints=False)
    plan = plan_soft_collision(blocked, waypoints, limits=limits_of(robot), options=options)
    middle = plan.trajectory.evaluate(plan.trajectory.breaks[plan.trajectory.n_pieces // 2])
    assert plan.collision_free
    np.testing.assert_allclose(middle, over, atol=1e-9)


def test_ipopt_finds_the_same_plan(robot: Robot, blocked: CollisionScene, ends: np.ndarray) -> None:
    mine = plan_soft_collision(blocked, ends, limits=limits_of(robot))
    theirs = plan_soft_collision(
        blocked, ends, limits=limits_of(robot), options=SoftCollisionOptions(descent=IpoptOptions())
    )
    assert theirs.collision_free
    assert theirs.cost.total == pytest.approx(mine.cost.total, rel=0.05)


def test_the_same_seed_gives_the_same_plan(robot: Robot, blocked: CollisionScene, ends: np.ndarray) -> None:
    a, b = (plan_soft_collision(blocked, ends, limits=limits_of(robot)) for _ in range(2))
    np.testing.assert_array_equal(a.trajectory.coefficients, b.trajectory.coefficients)


def test_a_plan_that_collides_says_so(robot: Robot, planned: Coordinates, ends: np.ndarray) -> None:
    wall = collision_scene(
        planned, [obstacle("wall", coal.Box(60.0, 0.1, 60.0), [0.0, 0.8, 0.0])], self_collision=False
    )
    options = SoftCollisionOptions(restarts=0, sampling=SamplingOptions(max_samples=3))
    plan = plan_soft_collision(wall, ends, limits=limits_of(robot), options=options)
    assert plan.status is PlanStatus.COLLIDING
    assert not plan.collision_free
    assert plan.clearance.min_clearance <= 0.0
    assert plan.clearance.pair.startswith("wall")


def test_an_end_point_in_collision_or_out_of_limits_is_refused(
    robot: Robot, planned: Coordinates, ends: np.ndarray
) -> None:
    on_goal = collision_scene(planned, [obstacle("rock", coal.Sphere(0.2), ends[1, :3])])
    with pytest.raises(InvalidInput, match=r"way point 1 \(the goal\) is in collision: rock - base_link"):
        plan_soft_collision(on_goal, ends, limits=limits_of(robot))
    far = ends.copy()
    far[1, 7] = 3.0
    with pytest.raises(InvalidInput, match=r"way point 1 \(the goal\) has joint2 = 3"):
        plan_soft_collision(on_goal, far, limits=limits_of(robot))
    with pytest.raises(InvalidInput, match="one column per axis"):
        plan_soft_collision(on_goal, ends[:, :5], limits=limits_of(robot))
    with pytest.raises(InvalidInput, match="way points 0 and 1 are equal"):
        plan_soft_collision(on_goal, ends[[0, 0]], limits=limits_of(robot))
    with pytest.raises(InvalidInput, match="pose of obstacle 'x' has NaN"):
        obstacle("x", coal.Sphere(1.0), [0.0, np.nan, 0.0])


def test_the_certificate_finds_a_thin_wall_between_samples(planned: Coordinates, ends: np.ndarray) -> None:
    thin = collision_scene(
        planned, [obstacle("sheet", coal.Box(60.0, 1e-4, 60.0), [0.0, 0.8, 0.0])], self_collision=False
    )
    line = straight_start(ends, MotionLimits(velocity=1.0))
    report = check_clearance(CoalDistances(thin), line, per_piece=1)
    assert not report.collision_free


def test_sampled_legs_are_free_of_collision(blocked: CollisionScene, ends: np.ndarray) -> None:
    exact = CoalDistances(blocked)
    assert edge_reach(exact, ends[0], ends[1], 0.0) < 1.0
    path = sampled_waypoints(exact, ends[0], ends[1])
    assert path is not None
    np.testing.assert_array_equal(path[[0, -1]], ends)
    for a, b in itertools.pairwise(path):
        assert exact.distances(a + np.linspace(0, 1, 200)[:, None] * (b - a)).min() > 0.0


def test_a_tool_goal_puts_the_tool_there_clear_of_collision(
    robot: Robot, blocked: CollisionScene, ends: np.ndarray
) -> None:
    exact, data = CoalDistances(blocked), robot.model.createData()
    X_WT = pin.SE3(pin.rpy.rpyToMatrix(np.pi, 0.0, 0.3), np.array([1.2, 1.5, -0.8]))
    x = tool_goal(exact, "tool", X_WT, ends[1])
    assert x is not None
    lower, upper = blocked.coordinates.limits()
    assert ((x >= lower) & (x <= upper)).all()
    assert exact.distances(x[None]).min() > 0.0
    pin.framesForwardKinematics(robot.model, data, blocked.coordinates.configurations(x[None])[0])
    np.testing.assert_allclose(data.oMf[robot.frame_id("tool")].homogeneous, X_WT.homogeneous, atol=1e-5)


def test_a_tool_goal_inside_an_obstacle_is_not_found(blocked: CollisionScene, ends: np.ndarray) -> None:
    inside = pin.SE3(np.eye(3), np.array([0.9, 0.8, -0.5]))
    options = ToolGoalOptions(attempts=3)
    assert tool_goal(CoalDistances(blocked), "tool", inside, ends[1], options) is None
    with pytest.raises(FrameNotFound, match="tol"):
        tool_goal(CoalDistances(blocked), "tol", inside, ends[1])
    with pytest.raises(InvalidInput, match="guess has shape"):
        tool_goal(CoalDistances(blocked), "tool", inside, ends[1, :3])


def test_joint_tracking_follows_a_planned_trajectory(robot: Robot, ends: np.ndarray) -> None:
    curve = straight_start(ends, limits_of(robot)).axes(range(9, 13))
    task = JointTracking(joints=robot.joint_names[-4:], goal=curve)
    np.testing.assert_allclose(task.reference(1.0), np.concatenate(curve(1.0)))


def test_weights_out_of_range_are_refused() -> None:
    with pytest.raises(InvalidInput, match="clearance is 0"):
        CostWeights(clearance=0.0)
    with pytest.raises(InvalidInput, match="smoothness is -1"):
        CostWeights(smoothness=-1.0)


def test_a_fixed_base_robot_is_planned_for_as_well() -> None:
    planar = coordinates(load_robot("planar5"))
    start = planar.x(planar.robot.configuration())
    ends = np.stack([start, start + np.array([4.0, 0.0, 0.0, 0.0, 0.0])])
    scene = collision_scene(planar, [obstacle("post", coal.Cylinder(0.3, 2.0), [2.0, 0.1, 0.0])])
    assert CoalDistances(scene).distances(ends.mean(axis=0)[None]).min() < 0.0
    plan = plan_soft_collision(scene, ends, limits=limits_of(planar.robot))
    assert plan.collision_free
