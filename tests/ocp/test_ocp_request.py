"""Laws of plans by optimal control from a request: goals, obstacles, and what is refused."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.problem import OcpLevel, single_phase
from uvms_ocp.ocp.request import OcpRequest, _margins, along_curve, solve_ocp
from uvms_ocp.ocp.terms import Effort
from uvms_ocp.planning import coordinates
from uvms_ocp.planning.distances import CoalDistances
from uvms_ocp.planning.request import PostureGoal, ToolGoal
from uvms_ocp.report.planned_motion import ocp_record, ocp_report
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.obstacles import Obstacle, obstacle
from uvms_ocp.robot.signals import State
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial


def ball_at(*position: float) -> Obstacle:
    return obstacle("ball", coal.Sphere(0.2), position)


BALL = ball_at(0.8, 0.9, 0.0)


@pytest.fixture(scope="module")
def planar() -> Robot:
    return load_robot("planar5")


def asked(robot: Robot, goal: ToolGoal | PostureGoal, **options: Any) -> OcpRequest:
    chosen: dict[str, Any] = {"start": robot.configuration(), "n_steps": 20, "duration": 10.0}
    return OcpRequest(robot=robot, goal=goal, **(chosen | options))


def test_the_tool_reaches_its_goal_around_an_obstacle(planar: Robot) -> None:
    tool = Kinematics(planar, planar.configuration()).pose("tool").translation
    goal = (float(tool[0]) + 3.0, float(tool[1]) + 1.0, float(tool[2]))
    free = solve_ocp(asked(planar, ToolGoal(position=goal), duration=20.0))
    x, y, z = (
        Kinematics(planar, free.samples[1][len(free.samples[0]) // 2]).pose("base_link").translation
    )
    wall = obstacle("wall", coal.Cylinder(0.15, 1.0), (x, y + 0.1, z))
    around = solve_ocp(asked(planar, ToolGoal(position=goal), duration=20.0, obstacles=(wall,)))
    for result in (free, around):
        assert result.plan.status is OcpStatus.SOLVED
        end = Kinematics(planar, result.samples[1][-1]).pose("tool").translation
        np.testing.assert_allclose(end, goal, atol=1e-5)
    assert around.collision_free
    pairs = around.scene.groups()["wall"]
    at_nodes = np.array([around.scene.coordinates.x(q) for q in around.plan.trajectory.q])
    assert CoalDistances(around.scene).distances(at_nodes)[:, pairs].min() > 0.06 - 1e-6
    assert around.plan.levels[-1].residual > free.plan.levels[-1].residual


def test_links_keep_a_clearance_of_their_own(planar: Robot) -> None:
    goal = PostureGoal(joints={"theta1": 0.3})
    one, two = (
        asked(planar, goal, obstacles=(BALL,), clearance=0.05, **other)
        for other in ({}, {"link_clearance": 0.01})
    )
    scene = solve_ocp(one).scene
    links = scene.groups().get("its own links", [])
    assert links
    differ = np.flatnonzero(_margins(one, scene) != _margins(two, scene))
    assert set(differ) <= set(links)
    assert len(differ)
    assert _margins(two, scene)[links].max() <= 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("way", "at"),
    [
        ((1.3, 0.1, -0.2), (0.6, 0.1, -0.1)),
        ((1.2, 0.97, 0.03), (0.59, 0.46, 0.04)),
        ((-0.19, 1.02, 0.1), (-0.18, 0.52, 0.05)),
    ],
)
def test_a_vehicle_does_not_roll_over_on_its_way_around_a_rock(
    way: tuple[float, float, float], at: tuple[float, float, float]
) -> None:
    robot = load_robot("bluerov2_alpha5")
    q = robot.configuration(position=(0.0, 0.0, -5.0))
    tool = Kinematics(robot, q).pose("tool").translation
    rock = obstacle("rock", coal.Sphere(0.18), tool + np.array(at))
    goal = ToolGoal(position=tuple(tool + np.array(way)))
    result = solve_ocp(asked(robot, goal, start=q, obstacles=(rock,), duration=9.0))
    assert result.plan.status is OcpStatus.SOLVED
    x, y, _, _ = result.plan.trajectory.q[:, 3:7].T
    assert (1.0 - 2.0 * (x**2 + y**2)).min() > np.cos(0.6)


def test_a_posture_moves_what_was_asked_and_ends_at_rest(planar: Robot) -> None:
    result = solve_ocp(asked(planar, PostureGoal(joints={"x0": 0.8, "theta1": 1.0})))
    trajectory = result.plan.trajectory
    end = dict(zip(planar.joint_names, trajectory.q[-1], strict=True))
    assert end["x0"] == pytest.approx(0.8, abs=1e-5)
    assert end["theta1"] == pytest.approx(1.0, abs=1e-5)
    np.testing.assert_allclose(trajectory.v[-1], 0.0, atol=1e-6)


def test_what_is_nearer_at_the_start_comes_no_nearer_and_what_touches_is_refused(
    planar: Robot,
) -> None:
    near = ball_at(0.0, 0.45, 0.0)
    result = solve_ocp(
        asked(planar, PostureGoal(joints={"x0": 0.5}), obstacles=(near,), clearance=0.2)
    )
    assert result.plan.status is OcpStatus.SOLVED
    assert result.collision_free
    at_start = result.distances[0]
    kept = np.minimum(
        0.2, at_start * np.where([pair.first_joint != 0 for pair in result.scene.pairs], 0.75, 0.99)
    )
    assert at_start.min() < 0.1
    assert (result.distances.min(axis=0) > kept - 5e-4).all()
    with pytest.raises(InvalidInput, match="the start is in collision: ball"):
        solve_ocp(asked(planar, PostureGoal(joints={"x0": 0.5}), obstacles=(ball_at(0, 0, 0),)))


def test_a_goal_inside_an_obstacle_is_named_with_its_depth_before_anything_is_solved(
    planar: Robot,
) -> None:
    tool = Kinematics(planar, planar.configuration()).pose("tool").translation + np.array(
        [3.0, 0.0, 0.0]
    )
    ball = ball_at(*tool)
    with pytest.raises(
        InvalidInput, match=r"the goal is in collision: ball - tool overlap by 0\.2 m; move it"
    ):
        solve_ocp(asked(planar, ToolGoal(position=tuple(tool)), obstacles=(ball,)))
    with pytest.raises(
        InvalidInput, match=r"the goal is in collision: ball - link2_0 overlap by 0\.\d+ m; move it"
    ):
        solve_ocp(
            asked(planar, ToolGoal(position=tuple(tool), rpy=(0.0, 0.0, 0.0)), obstacles=(ball,))
        )
    names = ("x0", "y0", "alpha")
    base = ball_at(3.0, 0.0, 0.0)
    with pytest.raises(
        InvalidInput, match=r"the goal is in collision: ball - base_link_0 overlap by 0\.\d+ m"
    ):
        solve_ocp(
            asked(
                planar,
                PostureGoal(joints=dict(zip(names, (3.0, 0.0, 0.0), strict=True))),
                obstacles=(base,),
            )
        )


def test_a_guess_along_a_curve_has_its_pace_and_takes_all_the_time(planar: Robot) -> None:
    """Half a curve, whenever it begins, is the way of half the horizon."""
    problem = single_phase(
        robot=planar,
        start=State(q=planar.configuration(), v=np.zeros(planar.n_v)),
        duration=8.0,
        n_steps=4,
        levels=[OcpLevel(name="effort", terms=(Effort(),))],
        water=False,
    )
    way = np.linspace(0.1, 0.5, planar.n_v)
    curve = PiecewisePolynomial(
        breaks=np.array([2.0, 5.0]), coefficients=np.array([[np.zeros(planar.n_v)], [way]])
    )
    guess = along_curve(problem, coordinates(planar), curve)
    np.testing.assert_allclose(guess.t, [0.0, 2.0, 4.0, 6.0, 8.0])
    np.testing.assert_allclose(guess.q, np.outer([0.0, 0.25, 0.5, 0.75, 1.0], way), atol=1e-12)


@pytest.mark.slow
def test_a_level_floor_is_kept_clear_of() -> None:
    robot = load_robot("girona_maris7_full")
    here = Kinematics(robot, robot.configuration()).pose("tool").translation
    goal = ToolGoal(position=tuple(here + np.array([0.4, 0.0, -0.5])))
    free = solve_ocp(asked(robot, goal))
    seabed = float(free.samples[1][-1][2]) - 0.5
    above = solve_ocp(asked(robot, goal, seabed=seabed))
    for result in (free, above):
        assert result.plan.status is OcpStatus.SOLVED
    assert above.collision_free
    assert above.distances[:, above.scene.groups()["seafloor"]].min() > 0.06 - 5e-4


@pytest.mark.slow
def test_samples_of_iterates_that_left_their_manifold_are_configurations() -> None:
    robot = load_robot("girona_maris7_full")
    result = solve_ocp(
        asked(robot, PostureGoal(position=(2.0, 0.0, 0.0)), n_steps=2, current=(3.0, 0.0, 0.0))
    )
    assert not result.plan.status.usable
    assert np.abs(np.linalg.norm(result.plan.trajectory.q[:, 3:7], axis=1) - 1.0).max() < 1e-12
    for q in result.samples[1]:
        np.testing.assert_allclose(robot.check_configuration(q), q)


def test_a_goal_out_of_reach_is_a_verdict_with_a_motion(planar: Robot) -> None:
    result = solve_ocp(asked(planar, ToolGoal(position=(1.0, 0.0, 2.0)), n_steps=10))
    report = ocp_report(result)
    assert report["status"] == "unreachable"
    assert "level 'goal' is missed by" in report["reason"]
    assert report["tool_error"]["position_m"] == pytest.approx(2.0, abs=0.1)


def test_the_record_adds_up(planar: Robot) -> None:
    result = solve_ocp(
        asked(planar, PostureGoal(joints={"x0": 0.5}), obstacles=(BALL,), n_steps=10)
    )
    record = ocp_record(result)
    plan = result.plan
    taken = record["thruster_energy"][-1].sum() + record["joint_energy"][-1]
    assert taken == pytest.approx(plan.energy, rel=1e-9)
    assert ocp_report(result)["energy_j"] == pytest.approx(plan.energy)
    steps = np.diff(record["q"], axis=0) / np.diff(record["t"])[:, None]
    middle = (record["x_rate"][:-1] + record["x_rate"][1:]) / 2
    np.testing.assert_allclose(steps, middle, atol=1e-2)
    assert record.meta.clearance_groups[0] == "ball"


def test_mistakes_are_refused_in_one_line(planar: Robot) -> None:
    goal = PostureGoal(joints={"x0": 0.5})
    inside = obstacle("inside", coal.Sphere(0.3), (0.0, 0.0, 0.0))
    for options, message in (
        ({"obstacles": (inside,)}, "the start is in collision: inside"),
        ({"obstacles": (BALL, BALL)}, "two obstacles are called 'ball'"),
        ({"obstacles": (BALL,), "clearance": -1.0}, "clearance = -1.0; give a number from 0"),
        ({"duration": 0.0}, "duration = 0.0; give a number > 0"),
        ({"n_steps": 0}, "n_steps = 0; give a whole number >= 1"),
        ({"current": (np.nan, 0.0, 0.0)}, "current\\[0\\] = nan; give a number, finite"),
    ):
        with pytest.raises(InvalidInput, match=message):
            solve_ocp(asked(planar, goal, **options))
    with pytest.raises(InvalidInput, match="fixed base"):
        solve_ocp(asked(planar, PostureGoal(position=(1.0, 0.0, 0.0))))
    with pytest.raises(NameNotFound, match="joint9"):
        solve_ocp(asked(planar, PostureGoal(joints={"joint9": 1.0})))
    with pytest.raises(NameNotFound, match="ipopt"):
        solve_ocp(asked(planar, goal, plugin="snopt"))
