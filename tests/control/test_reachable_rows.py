"""References that acceleration limits can follow: no degree of freedom joins in that is not
needed.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import uvms_ocp as uo
from uvms_ocp.control.velocity.jerk_limit import common_share, falling_share
from uvms_ocp.control.velocity.levels import build_levels
from uvms_ocp.control.velocity.reachable_rows import reachable_rows
from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.tasks import ToolPose, ToolPosition
from uvms_ocp.tasks.approach_speed import ENDLESS, row_acceleration
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.task import Rows, TickSymbols
from uvms_ocp.tasks.vehicle_velocity import NullVelocity

DT = 0.005


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7_full")


def outputs(robot: Robot, previous: np.ndarray, gate: float) -> dict[str, np.ndarray]:
    problem = build_levels(robot, Hierarchy([NullVelocity()]), DT)
    values = problem.function(
        robot.configuration(),
        np.zeros(13),
        np.zeros(4),
        previous,
        np.zeros(13),
        5.0,
        np.zeros(0),
        gate,
    )
    return {
        name: np.array(value).ravel()
        for name, value in zip(problem.function.name_out(), values, strict=True)
    }


def test_a_row_acceleration_puts_the_first_axis_at_its_limit() -> None:
    rng = np.random.default_rng(1)
    J = rng.normal(size=(5, 8))
    limit = rng.uniform(0.5, 2, 8)
    rates = np.array(ca.DM(ca.evalf(row_acceleration(ca.SX(J), limit)))).ravel()
    for row, rate in zip(J, rates, strict=True):
        acceleration = row * rate / (row @ row)
        assert np.max(np.abs(acceleration) / limit) == pytest.approx(1.0)


def test_accelerations_fall_to_0_on_the_way_to_a_reference(robot: Robot) -> None:
    v = np.zeros(13)
    path = []
    v[0] = 0.4
    for _ in range(150):
        v = np.concatenate([outputs(robot, v, 1.0)["lower"][13:19], np.zeros(7)])
        path.append(v[0])
    changes = np.diff(path, prepend=0.4)
    assert (changes <= 0.0).all()
    assert abs(path[-1]) < 1e-4
    # From the limit to rest it takes a tenth of a second.
    assert np.diff(changes).max() <= robot.limits.acceleration[0] * DT**2 / 0.1 * 1.01
    assert changes.min() == pytest.approx(-robot.limits.acceleration[0] * DT)


@pytest.mark.parametrize("dt", [0.005, 0.05])
def test_the_last_part_of_a_change_is_what_an_acceleration_that_falls_from_its_limit_in_a_tenth_of_a_second_covers(
    dt: float,
) -> None:
    desired = np.array([1e-4, -1e-3, 0.01, -0.1, 0.3])
    acceleration = np.array([0.2, 0.5, 1.0, 2.0, 0.5])
    shares = np.array(ca.DM(falling_share(ca.SX(desired), ca.SX(acceleration), dt))).ravel()
    first = shares * np.abs(desired) / dt
    jerk = acceleration / 0.1
    np.testing.assert_allclose(first * dt + first**2 / (2.0 * jerk), np.abs(desired), rtol=1e-9)


@pytest.mark.parametrize("eased", [False, True])
def test_a_bound_that_stands_for_none_is_none(robot: Robot, eased: bool) -> None:
    assert _bounds_of_surge(robot, DT, eased)(-ENDLESS, ENDLESS, 0.0) == [-np.inf, np.inf]


def test_an_equality_approaches_its_rate_in_proportion(robot: Robot) -> None:
    previous = np.zeros(13)
    previous[:6] = [0.4, 0.2, 0.0, 0.0, 0.0, 0.1]
    target = outputs(robot, previous, 1.0)["lower"][13:19]
    np.testing.assert_allclose(
        target / previous[:6].clip(1e-12), np.where(previous[:6], 1 - DT / 0.4, 0), atol=1e-9
    )


def test_a_gate_between_0_and_1_leaves_a_row_a_band_of_what_the_limits_let_one_tick_change(
    robot: Robot,
) -> None:
    previous = np.zeros(13)
    previous[0] = 0.4
    assert not outputs(robot, previous, 0.0)["gate"][13:19].any()
    settled = 0.4 - DT
    reach = robot.limits.acceleration[0] * DT
    for gate, width in ((1.0, 0.0), (0.8, 0.5), (0.5, 1.0), (0.2, 2.0)):
        rows = outputs(robot, previous, gate)
        assert rows["gate"][13:19].all()
        assert rows["lower"][13] == pytest.approx(settled - width * reach)
        assert rows["upper"][13] == pytest.approx(settled + width * reach)


@pytest.mark.parametrize("eased", [False, True])
@pytest.mark.parametrize("dt", [0.005, 0.05])
def test_bounds_that_are_near_each_other_do_not_cross_on_the_way_back(
    robot: Robot, dt: float, eased: bool
) -> None:
    bounds = _bounds_of_surge(robot, dt, eased)
    for width in (0.0, 1e-6, 1e-3, 0.1):
        for present in np.linspace(-0.3, 0.3, 61):
            lower, upper = bounds(0.0, width, present)
            assert lower <= upper
            assert abs(np.clip(present, lower, upper) - present) <= robot.limits.acceleration[
                0
            ] * dt * (1 + 1e-12)


def _bounds_of_surge(
    robot: Robot, dt: float, eased: bool
) -> Callable[[float, float, float], list[float]]:
    """(lower, upper, present) [m/s] -> the bounds [m/s] that can be followed, of a row that is
    surge alone.
    """
    lower = ca.SX.sym("lower")
    upper = ca.SX.sym("upper")
    present = ca.SX.sym("present")
    previous = ca.vertcat(present, ca.SX.zeros(robot.n_v - 1))
    empty = ca.SX.sym("nothing", 0)
    symbols = TickSymbols(
        robot=robot, kinematics=None, q=empty, velocity=empty, altimeter_range=empty, dt=dt
    )  # type: ignore[arg-type]
    row = Rows(
        jacobian=ca.SX.eye(robot.n_v)[0, :],
        rate=ca.SX(0),
        lower=lower,
        upper=upper,
        activation=ca.SX(0),
    )
    rows = reachable_rows(
        row, equality=False, eased=eased, symbols=symbols, previous=previous, gate=ca.SX(1)
    )
    function = ca.Function("bounds", [lower, upper, present], [rows.lower, rows.upper])
    return lambda *values: [float(bound) for bound in function(*values)]


def test_a_settled_row_is_exact(robot: Robot) -> None:
    np.testing.assert_array_equal(outputs(robot, np.zeros(13), 1.0)["lower"][13:19], 0.0)


@pytest.mark.slow
def test_axes_that_no_task_needs_stay_still_through_the_first_transition() -> None:
    record = case1(duration=20.0).run()
    assert record["phase"].max() == 1
    assert np.abs(record["command"][:, 3]).max() < 5e-3  # roll
    assert np.abs(record["command"][:, 4]).max() < 1e-2  # pitch


@pytest.mark.sampled
@pytest.mark.parametrize(
    "solver", [uo.LexicographicActiveSet(), uo.Icat()], ids=lambda solver: type(solver).__name__
)
@pytest.mark.parametrize("task", [ToolPosition, ToolPose])
def test_a_row_that_nothing_moves_stops_no_other(task: type, solver: Any) -> None:
    """No axis of an arm of parallel axes moves its tool out of its plane."""
    robot = uo.load_robot("planar5")
    start = robot.configuration()
    tool = uo.Kinematics(robot, start).pose("tool")
    task_goal = task(goal=pin.SE3(tool.rotation, tool.translation + np.array([0.3, 0.2, 0.0])))
    arrived = uo.Below(quantity=f"{task_goal.name}.position_error", limit=0.005)
    arrival = uo.Transition(to=uo.DONE, when=(arrived,), hold=0.5)
    mission = uo.Mission(
        hierarchy=uo.Hierarchy([task_goal]),
        phases=(uo.Phase(name="p", activations={task_goal.name: 1.0}, transitions=(arrival,)),),
    )
    deep = uo.Environment(seafloor=uo.FlatSeafloor(z=-100.0))
    record = uo.Scenario(
        name="plane",
        robot=robot,
        mission=mission,
        environment=deep,
        start=start,
        duration=30.0,
        solver=solver,
    ).run()
    assert summarize(record)["completed"]


def test_rows_change_in_proportion_and_one_that_is_hardly_moved_by_itself() -> None:
    desired = ca.SX([0.2, 0.1, 0.3])
    acceleration = ca.SX([1.0, 0.5, 1e-9])
    shares = np.array(ca.DM(common_share(desired, acceleration, 0.01))).ravel()
    alone = np.array(ca.DM(common_share(desired[:2], acceleration[:2], 0.01))).ravel()
    np.testing.assert_array_equal(shares[:2], alone)
    assert alone[0] == alone[1] > 0.0
    assert 0.0 <= shares[2] < 1e-6


AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0")
LENGTHS = (0.1, 0.4, 0.3, 0.1, 0.2)
_TURN = '<limit lower="-2.8" upper="2.8" effort="40" velocity="0.6"/>'
_BODY = """<link name="l{k}"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>"""


def arm_of(folder: Path, n: int) -> Robot:
    """A fixed arm of n joints, straight at 0."""
    names = ["base_link", *(f"l{k}" for k in range(n))]
    ends = (0.0, *LENGTHS)
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="{names[k]}"/><child link="l{k}"/><origin'
        f' xyz="{ends[k]} 0 0"/><axis xyz="{AXES[k]}"/>{_TURN}</joint>{_BODY.format(k=k)}'
        for k in range(n)
    )
    mount = (
        f'<joint name="m" type="fixed"><parent link="{names[n]}"/><child link="tool"/><origin'
        f' xyz="{ends[n]} 0 0"/></joint>'
    )
    (folder / "a.urdf").write_text(
        f'<robot name="arm"><link name="base_link"/>{joints}<link name="tool"/>{mount}</robot>'
    )
    accelerations = "".join(f"  j{k}: {{acceleration: 2.0}}\n" for k in range(n))
    (folder / "a.yaml").write_text(f"base: fixed\njoints:\n{accelerations}")
    return load_robot(urdf=folder / "a.urdf", hydrodynamics=folder / "a.yaml")


def damped_least_squares(robot: Robot, q: np.ndarray, goal: np.ndarray) -> float:
    """Distance [m] from the goal after 30 s."""
    for _ in range(3000):
        kinematics = uo.Kinematics(robot, np.clip(q, -2.8, 2.8))
        J = kinematics.jacobian("tool")[:3]
        error = goal - kinematics.pose("tool").translation
        q = q + 0.01 * np.clip(
            J.T @ np.linalg.solve(J @ J.T + 1e-4 * np.eye(3), 0.6 * error), -0.6, 0.6
        )
    return float(np.linalg.norm(error))


def run_of_arm(robot: Robot, start: float, goal: np.ndarray, solver: Any) -> uo.Record:
    arrival = uo.Transition(to=uo.DONE, when=(uo.Below(quantity="TP.position_error", limit=1e-9),))
    phase = uo.Phase(name="p", activations={"TP": 1.0}, transitions=(arrival,))
    return uo.Scenario(
        name="arm",
        robot=robot,
        mission=uo.Mission(
            hierarchy=uo.Hierarchy([ToolPosition(goal=uo.pose_at(tuple(goal)))]), phases=(phase,)
        ),
        environment=uo.Environment(seafloor=uo.FlatSeafloor(z=-100.0)),
        start=robot.configuration(joints=np.full(robot.n_joints, start)),
        plant="kinematic",
        solver=solver,
        dt=0.02,
        duration=40.0,
    ).run()


@pytest.mark.slow
@pytest.mark.parametrize(
    "solver",
    [uo.LexicographicActiveSet(), uo.Icat(damping=1e-8, threshold=1e-4)],
    ids=["active set", "Icat"],
)
@pytest.mark.parametrize("start", [0.0, 0.3])
@pytest.mark.parametrize("n", range(1, 6))
def test_arms_of_few_joints_end_where_damped_least_squares_ends_also_from_a_straight_arm(
    n: int, start: float, solver: Any, tmp_path: Path
) -> None:
    robot = arm_of(tmp_path, n)
    goal = (
        uo.Kinematics(robot, np.random.default_rng(n).uniform(-1, 1, n))
        .pose("tool")
        .translation.copy()
    )
    record = run_of_arm(robot, start, goal, solver)
    assert (
        record["TP.position_error"][-1]
        < damped_least_squares(robot, np.full(n, start), goal) + 1e-3
    )


@pytest.mark.sampled
@pytest.mark.parametrize("start", [0.0, 0.3])
def test_icat_says_where_its_published_damping_ends_before_a_singularity(
    start: float, tmp_path: Path
) -> None:
    robot = arm_of(tmp_path, 3)
    goal = (
        uo.Kinematics(robot, np.random.default_rng(3).uniform(-1, 1, 3))
        .pose("tool")
        .translation.copy()
    )
    record = run_of_arm(robot, start, goal, uo.Icat())
    assert record["TP.position_error"][-1] > 0.02
    cause = summarize(record)["cause"]
    assert cause["kind"] == "stalled"
    assert cause["text"].endswith("near a singularity Icat goes on with less damping and threshold")
