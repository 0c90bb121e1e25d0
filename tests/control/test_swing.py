"""A pitch that no thruster drives: joints counter what it swings by, thrust does not, and rows hold
how the vehicle leans.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from six_thrusters import command_of, six_thrusters, unit_laws

from uvms_ocp.control.force.tick_functions import (
    ForceInputs,
    ForceState,
    column_places,
    control_function,
)
from uvms_ocp.control.velocity.levels import tick_symbols
from uvms_ocp.control.velocity.swing import (
    N_PASSIVE,
    countered_rows,
    lean_of,
    lean_rows,
    mean_attitude,
    swing_frequency,
    swinging_axes,
)
from uvms_ocp.robot.dynamics import cached_dynamics
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.scenario.scenario import pose_at
from uvms_ocp.tasks import ToolPosition, UnderActuation

PITCH = 4
STEP = 1e-5
DT = 0.005
POSTURES = ((0.0, 0.9, 0.4), (0.5, 0.3, -0.6), (-0.8, -0.5, 1.0))
GOAL = np.array([1.4, 0.2, -0.5])


@pytest.fixture(scope="module")
def robot() -> Robot:
    return six_thrusters()


@pytest.fixture(scope="module")
def rows(robot: Robot) -> ca.Function:
    """Of a tool task: ``q, v, passive -> jacobian, rate, its jacobian and rate where nobody minds a
    swing, lean``.
    """
    symbols = tick_symbols(robot, DT)
    passive = ca.SX.sym("passive", N_PASSIVE)
    task = ToolPosition(goal=pose_at(GOAL))
    still = mean_attitude(symbols, passive)
    plain = task.rows(symbols, ca.SX([*GOAL, 0, 0, 0]))
    lean = lean_of(still, passive)
    mean = task.rows(still, ca.SX([*GOAL, 0, 0, 0]))
    countered = countered_rows(plain, mean, symbols, passive, lean)
    lean_limit = lean_rows(still, lean)
    parts = [
        countered.jacobian,
        countered.rate,
        plain.jacobian,
        mean.rate,
        lean.slope,
        lean_limit.lower,
        lean_limit.upper,
    ]
    return ca.Function(
        "rows", [symbols.q, symbols.velocity, passive], [ca.densify(part) for part in parts]
    )


def evaluated(
    rows: ca.Function, q: np.ndarray, pitching: float = 0.0, swing: float = 0.0, weight: float = 0.0
) -> list:
    v = np.zeros(rows.size1_in(1))
    v[PITCH] = pitching
    return [np.array(part) for part in rows(q, v, [0.0, swing, 0.0, weight])]


def test_nothing_swings_where_every_rotation_is_driven(robot: Robot) -> None:
    assert swinging_axes(robot) == [PITCH]
    assert [swinging_axes(load_robot(name)) for name in ("girona_maris7_full", "planar5")] == [
        [],
        [],
    ]


def test_the_frequency_is_that_of_small_swings_in_water(robot: Robot) -> None:
    """By the moment that rights a small pitch, over the inertia about it."""
    dynamics = cached_dynamics(robot)
    tilted = robot.configuration(rpy=(0.0, 0.01, 0.0))
    moment = dynamics.inverse_dynamics(tilted, np.zeros(robot.n_v), np.zeros(robot.n_v))[PITCH]
    level = dynamics.inverse_dynamics(
        robot.configuration(), np.zeros(robot.n_v), np.zeros(robot.n_v)
    )[PITCH]
    inertia = dynamics.mass_matrix(tilted)[PITCH, PITCH]
    assert swing_frequency(robot) == pytest.approx(
        np.sqrt((moment - level) / 0.01 / inertia), rel=1e-3
    )


def balance(robot: Robot, joints: np.ndarray, weight: float) -> float:
    """Pitch [rad] at which a vehicle with a weight [N] at its tool is at rest, by bisection of its
    moment.
    """
    dynamics = cached_dynamics(robot)
    low = -1.4
    high = 1.4
    for _ in range(60):
        middle = (low + high) / 2
        q = robot.configuration(rpy=(0.0, middle, 0.0), joints=joints)
        righting = dynamics.inverse_dynamics(q, np.zeros(robot.n_v), np.zeros(robot.n_v))[PITCH]
        moment = righting + weight * Kinematics(robot, q).jacobian("tool")[2, PITCH]
        low, high = (low, middle) if moment > 0.0 else (middle, high)
    return (low + high) / 2


@pytest.mark.sampled
@pytest.mark.parametrize("weight", [0.0, 20.0])
@pytest.mark.parametrize("posture", POSTURES)
def test_the_vehicle_leans_after_its_joints_as_the_rows_say(
    robot: Robot, rows: ca.Function, posture: tuple[float, ...], weight: float
) -> None:
    pitch = balance(robot, np.array(posture), weight)
    slope = evaluated(
        rows, robot.configuration(rpy=(0.0, pitch, 0.0), joints=posture), weight=weight
    )[4][0]
    for k, step in enumerate(STEP * np.eye(3)):
        leant = balance(robot, np.array(posture) + step, weight) - balance(
            robot, np.array(posture) - step, weight
        )
        assert slope[k] == pytest.approx(leant / (2 * STEP), rel=0.03, abs=1e-3)


@pytest.mark.parametrize("weight", [0.0, 20.0])
def test_what_the_tool_moves_by_in_the_end_is_what_its_row_says(
    robot: Robot, rows: ca.Function, weight: float
) -> None:
    """A motion of the joints, and the vehicle leaning after it."""
    joints = np.array(POSTURES[0])
    direction = np.array([0.3, -1.0, 0.7])

    def tool(posture: np.ndarray) -> np.ndarray:
        q = robot.configuration(rpy=(0.0, balance(robot, posture, weight), 0.0), joints=posture)
        return Kinematics(robot, q).pose("tool").translation

    q = robot.configuration(rpy=(0.0, balance(robot, joints, weight), 0.0), joints=joints)
    moved = (tool(joints + STEP * direction) - tool(joints - STEP * direction)) / (2 * STEP)
    J = evaluated(rows, q, weight=weight)[0]
    assert J[:, 6:] @ direction == pytest.approx(moved, rel=0.05, abs=5e-3)
    assert not J[:, PITCH].any()


@pytest.mark.parametrize("posture", POSTURES)
def test_a_swing_is_countered_by_joints_alone_in_phase_within_their_limits(
    robot: Robot, rows: ca.Function, posture: tuple[float, ...]
) -> None:
    """What is asked for beside the rate at rest is a motion of the joints, which goes against the
    tool's own.
    """
    q = robot.configuration(joints=posture)
    limit = robot.limits.velocity[6:]
    for pitching in (-2.0, -0.02, 0.02, 2.0):
        J, rate, plain, mean, *_ = evaluated(rows, q, pitching=pitching)
        joints, *_ = np.linalg.lstsq(J[:, 6:], (rate - mean)[:, 0], rcond=None)
        assert J[:, 6:] @ joints == pytest.approx((rate - mean)[:, 0], abs=1e-9)
        assert (np.abs(joints) <= 0.5 * limit + 1e-9).all()
        swung = plain[:, PITCH] * pitching
        assert (plain[:, 6:] @ joints) @ swung < 0.0
    assert np.linalg.norm(plain[:, 6:] @ joints + swung) < np.linalg.norm(swung)


def test_thrust_answers_a_swing_by_its_mean_alone(robot: Robot, rows: ca.Function) -> None:
    """Whatever the pitch at the moment is, the rate is that of the tool where the vehicle would be
    without the swing.
    """
    upright = evaluated(rows, robot.configuration())
    for swing in (-0.3, 0.1):
        pitched = evaluated(rows, robot.configuration(rpy=(0.0, swing, 0.0)), swing=swing)
        assert pitched[3] == pytest.approx(upright[3], abs=1e-9)


def test_joints_lean_the_vehicle_no_farther_than_it_rights_itself(
    robot: Robot, rows: ca.Function
) -> None:
    """Bounds close where the balance, not the swing, comes to the largest lean, and beyond it lead
    back.
    """
    q = robot.configuration(joints=(0.0, 0.0, 0.0))
    for weight, leads_back in ((0.0, False), (60.0, True)):
        pitch = balance(robot, np.zeros(3), weight)
        q = robot.configuration(rpy=(0.0, pitch, 0.0), joints=(0.0, 0.0, 0.0))
        upper = evaluated(rows, q, weight=weight)[6].item()
        assert (upper < 0.0) is leads_back


def test_no_command_leads_the_tool_away_from_its_target(robot: Robot) -> None:
    rng = np.random.default_rng(3)
    for _ in range(10):
        q = robot.configuration(
            rpy=(0.0, 0.0, rng.uniform(-3, 3)), joints=rng.uniform(-0.8, 0.8, 3)
        )
        tool = Kinematics(robot, q)
        goal = tool.pose("tool").translation + rng.uniform(-2, 2, 3)
        tasks = [UnderActuation(axes=(PITCH,)), ToolPosition(goal=pin.SE3(np.eye(3), goal))]
        command = command_of(robot, tasks, q, np.zeros(robot.n_v))
        assert (tool.jacobian("tool")[:3] @ command) @ (goal - tool.pose("tool").translation) > 0.0


def test_driven_axes_accelerate_as_asked_whatever_pitch_makes_of_it(robot: Robot) -> None:
    """Pitch takes no force, and what it takes along of the driven axes is fed forward."""
    dynamics = cached_dynamics(robot)
    rng = np.random.default_rng(5)
    n = robot.n_v
    laws = unit_laws(robot, DT)
    control = control_function(laws)
    driven = [axis for axis in range(n) if axis != PITCH]
    q = robot.configuration(rpy=(0.1, 0.4, 0.3))
    v = 0.05 * rng.normal(size=n)
    desired = 0.1 * rng.normal(size=n)
    disturbance = rng.normal(size=n)
    inputs = np.zeros(control.size1_in(0))
    observed = np.zeros(control.size1_in(1))
    places = column_places(ForceInputs, laws.dimensions)
    state = column_places(ForceState, laws.dimensions)
    inputs[places["q"]] = q
    before = v - DT * desired
    measured = v.copy()
    measured[6:] = before[6:]  # joints meet a reference in the tick that it is given for
    inputs[places["v"]] = measured
    inputs[places["reference"]] = v
    inputs[places["joints"]] = 1.0
    observed[state["share"]] = 1.0
    observed[state["before"]] = before
    observed[state["estimate"]] = disturbance
    force = np.array(control(inputs, observed)).ravel()[n : 2 * n]
    assert force[PITCH] == pytest.approx(0.0, abs=1e-9)
    acceleration = dynamics.forward_dynamics(q, v, force + disturbance)
    assert acceleration[driven] == pytest.approx(desired[driven], abs=1e-9)
