"""What no thruster works on, whatever line it turns about: thrust does not feed it, and no task
asks for it.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from six_thrusters import six_thrusters, unit_laws
from tiny_robots import ENDLESS, Tiny, robot_of

from uvms_ocp.control.force.allocation import allocation_of
from uvms_ocp.control.force.tick_functions import (
    ForceInputs,
    ForceState,
    column_places,
    control_function,
)
from uvms_ocp.control.velocity.levels import build_levels, tick_symbols
from uvms_ocp.control.velocity.swing import N_PASSIVE, countered_rows, lean_of, mean_attitude
from uvms_ocp.robot.description import checked_copy
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import free_motions, thruster_matrix, unactuated_axes
from uvms_ocp.scenario.scenario import pose_at
from uvms_ocp.tasks import Hierarchy, JointLimits, Manipulability, ToolPosition, UnderActuation

PITCH = 4
DT = 0.005


def moved(height: float, ahead: float = 0.0) -> Robot:
    """Six thrusters, those that push ahead and across at a height [m], those that lift ahead [m] of
    where they are.
    """
    robot = six_thrusters()
    level = robot.description.thrusters[:4]
    lift = robot.description.thrusters[4:]
    thrusters = (
        *(
            thruster.model_copy(update={"position": (*thruster.position[:2], height)})
            for thruster in level
        ),
        *(
            thruster.model_copy(update={"position": (ahead, *thruster.position[1:])})
            for thruster in lift
        ),
    )
    return replace(robot, description=checked_copy(robot.description, thrusters=thrusters))


@pytest.fixture(scope="module", params=[0.0, 0.1, -0.15])
def robot(request: pytest.FixtureRequest) -> Robot:
    return moved(request.param)


def test_no_thruster_works_on_a_free_motion_and_each_is_measured_alone(robot: Robot) -> None:
    motions, measured = free_motions(robot)
    assert motions[PITCH] == pytest.approx(1.0)
    assert motions[:6].T @ thruster_matrix(robot) == pytest.approx(0.0, abs=1e-9)
    assert measured @ motions == pytest.approx(np.eye(1))


@pytest.mark.parametrize("ahead", [-0.01, 0.001, 0.01])
def test_lift_thrusters_a_centimetre_off_drive_no_pitch(ahead: float) -> None:
    assert unactuated_axes(moved(0.05, ahead)) == (PITCH,)


def test_a_lever_of_a_hand_drives_pitch() -> None:
    robot = six_thrusters()
    level = robot.description.thrusters[:4]
    lateral_left, right = robot.description.thrusters[4:]
    apart = [
        pair.model_copy(update={"position": (x, *pair.position[1:])})
        for pair, x in ((lateral_left, 0.1), (right, -0.1))
    ]
    third = right.model_copy(update={"name": "lift_rear", "position": (-0.2, 0.0, 0.0)})
    robot = replace(
        robot, description=checked_copy(robot.description, thrusters=(*level, *apart, third))
    )
    assert unactuated_axes(robot) == ()


def test_forces_are_those_that_thrusters_give_and_feed_no_free_motion(robot: Robot) -> None:
    rng = np.random.default_rng(4)
    n = robot.n_v
    laws = unit_laws(robot, DT)
    control = control_function(laws)
    places = column_places(ForceInputs, laws.dimensions)
    inputs = np.zeros(control.size1_in(0))
    observed = np.zeros(control.size1_in(1))
    inputs[places["q"]] = robot.configuration(rpy=(0.1, 0.3, 0.2))
    inputs[places["v"]], inputs[places["reference"]] = 0.05 * rng.normal(size=(2, n))
    state = column_places(ForceState, laws.dimensions)
    inputs[places["joints"]] = 1.0
    observed[state["share"]] = 1.0
    observed[state["before"]] = inputs[places["reference"]]
    force = np.array(control(inputs, observed)).ravel()[n : 2 * n]
    assert free_motions(robot)[0].T @ force == pytest.approx(0.0, abs=1e-9)
    allocation = allocation_of(robot, compiled=False).allocate(force[:6])
    assert allocation.unreachable == pytest.approx(0.0, abs=1e-6)


def test_tasks_ask_for_nothing_of_what_swings(robot: Robot) -> None:
    """Neither by their rows, nor by where the swing has taken the vehicle and its velocity."""
    symbols = tick_symbols(robot, DT)
    passive = ca.SX.sym("passive", N_PASSIVE)
    goal = ca.SX([*pose_at((1.4, 0.2, -0.5)).translation, 0, 0, 0])
    task = ToolPosition(goal=pose_at((1.4, 0.2, -0.5)))
    still = mean_attitude(symbols, passive)
    plain = task.rows(symbols, goal)
    mean = task.rows(still, goal)
    rows = countered_rows(plain, mean, symbols, passive, lean_of(still, passive))
    read = ca.Function("rows", [symbols.q, symbols.velocity, passive], [rows.jacobian, mean.rate])
    motions = free_motions(robot)[0][:, 0]
    q = robot.configuration(joints=(0.2, 0.5, -0.3))
    J, rate = map(np.array, read(q, np.zeros(robot.n_v), np.zeros(N_PASSIVE)))
    assert J[:, :6] @ motions[:6] == pytest.approx(0.0, abs=1e-9)
    swung = ca.Function("swung", [symbols.q, passive], [still.q])  # back from a swing by 0.3 rad
    for swing in (-0.3, 0.2):
        away = np.array(swung(q, [0.0, -swing, 0.0, 0.0])).ravel()
        assert np.array(read(away, swing * motions, [0.0, swing, 0.0, 0.0])[1]) == pytest.approx(
            rate, abs=1e-9
        )


def test_a_steady_way_is_told_to_tasks_as_it_is(robot: Robot) -> None:
    """It has momentum about the free axis, which turns nothing: taken for a swing, tools are
    carried away from their goals.
    """
    symbols = tick_symbols(robot, DT)
    passive = ca.SX.sym("passive", N_PASSIVE)
    task = ToolPosition(goal=pose_at((1.4, 0.2, -0.5)))
    still = mean_attitude(symbols, passive)
    goal = ca.SX([*task.goal.translation, 0, 0, 0])
    plain = task.rows(symbols, goal)
    mean = task.rows(still, goal)
    rows = countered_rows(plain, mean, symbols, passive, lean_of(still, passive))
    read = ca.Function(
        "rows",
        [symbols.q, symbols.velocity, passive],
        [rows.jacobian, plain.jacobian, rows.rate, mean.rate],
    )
    v = np.array([0.4, -0.1, 0.3, 0.1, 0.0, 0.2, *np.zeros(robot.n_joints)])
    J, whole, rate, desired = map(
        np.array, read(robot.configuration(joints=(0.2, 0.5, -0.3)), v, np.zeros(N_PASSIVE))
    )
    assert pytest.approx(whole @ v) == J @ v
    assert rate == pytest.approx(desired)


def test_the_motion_that_is_measured_is_kept_as_it_is(robot: Robot) -> None:
    symbols = tick_symbols(robot, DT)
    motions, measured = free_motions(robot)
    rows = UnderActuation(axes=(PITCH,)).rows(symbols, ca.SX())
    v = np.random.default_rng(1).normal(size=robot.n_v)
    J, rate = map(np.array, ca.Function("rows", [symbols.velocity], [rows.jacobian, rows.rate])(v))
    assert J @ motions == pytest.approx(1.0)
    assert rate[0] == pytest.approx(measured @ v)


def test_a_free_motion_heeds_no_limit_and_moves_nothing_else(robot: Robot) -> None:
    """Rows that cut it short would have the other axes make up for it."""
    problem = build_levels(robot, Hierarchy([UnderActuation(axes=(PITCH,))]), DT)
    v = 3.0 * free_motions(robot)[0][:, 0]
    zeros = np.zeros(robot.n_v)
    outputs = problem.function(
        robot.configuration(), v, np.zeros(N_PASSIVE), v, zeros, 5.0, [], 1.0
    )
    parts = {
        name: np.array(x) for name, x in zip(problem.function.name_out(), outputs, strict=True)
    }
    has_own_axis = np.abs(parts["J"]) @ np.eye(robot.n_v)[PITCH] == np.abs(parts["J"]).sum(axis=1)
    limited = has_own_axis & (np.abs(parts["J"][:, PITCH]) == 1.0)
    is_still = limited & (parts["lower"][:, 0] == parts["upper"][:, 0])
    assert limited.any()
    assert np.isinf(parts["lower"][limited & ~is_still]).all()
    assert np.isinf(parts["upper"][limited & ~is_still]).all()


def test_manipulability_is_asked_for_on_a_swinging_vehicle_with_endless_joints() -> None:
    lift = tuple((0.0, y, 0.1, 0, 0, 1) for y in (0.2, -0.2))
    level = tuple(
        (x, y, 0.0, 1, -1 if x * y > 0 else 1, 0) for x in (0.2, -0.2) for y in (0.2, -0.2)
    )
    robot = robot_of(Tiny(joints=(ENDLESS, ENDLESS), thrusters=(*level, *lift)))
    assert unactuated_axes(robot) == (PITCH,)
    assert build_levels(robot, Hierarchy([JointLimits(), Manipulability()]), DT).sizes
