"""Axes that no thruster drives: no row asks for them, none is met by translation, and what cannot
be moved is left out.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from six_thrusters import command_of, six_thrusters
from task_values import evaluate, random_configuration, task_function

from uvms_ocp.control.velocity.goals import task_parameters
from uvms_ocp.robot.description import checked_copy
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import unactuated_axes
from uvms_ocp.tasks import (
    Alignment,
    FieldOfView,
    HorizontalAttitude,
    Task,
    UnderActuation,
    VehiclePose,
)

PITCH = 4
STEP = 1e-6
GOAL = np.array([3.0, -2.0, 1.0])
TASKS = {
    "HA": HorizontalAttitude(),
    "AT": Alignment(goal=GOAL),
    "FV": FieldOfView(goal=GOAL, frame="base_link", axis=(0.8, 0.0, -0.6)),
}


@pytest.fixture(scope="module")
def robot() -> Robot:
    return six_thrusters()


def flat(robot: Robot) -> Robot:
    """With its level thrusters alone: neither roll nor pitch, nor heave."""
    level = tuple(
        thruster for thruster in robot.description.thrusters if thruster.direction[2] == 0.0
    )
    return replace(robot, description=checked_copy(robot.description, thrusters=level))


def _found(
    function: ca.Function, task: Task, q: np.ndarray, v: np.ndarray | None = None
) -> dict[str, np.ndarray]:
    """Rows and quantities at q (n_q,) and v (n_v,), at rest unless given."""
    velocity = np.zeros(function.size1_in("v")) if v is None else v
    values = function.call([q, velocity, 2.0, task_parameters(task, task.reference(0.0), q)])
    return {name: np.array(value) for name, value in zip(function.name_out(), values, strict=True)}


def test_two_lift_thrusters_abeam_leave_pitch_to_itself(robot: Robot) -> None:
    assert unactuated_axes(robot) == (PITCH,)


@pytest.mark.parametrize("name", TASKS)
def test_an_angle_is_met_neither_by_translation_nor_by_what_nobody_drives(
    name: str, robot: Robot
) -> None:
    rng = np.random.default_rng(2)
    function = task_function(robot, TASKS[name])
    for _ in range(20):
        row = _found(function, TASKS[name], random_configuration(robot, rng))["jacobian"]
        assert not row[:, [0, 1, 2, PITCH]].any()
        assert row[:, [3, 5]].any()


def test_what_translation_makes_of_an_angle_is_reckoned_with(robot: Robot) -> None:
    """The rate that is left to ask falls by what the motion gives that nobody asked for."""
    function = task_function(robot, TASKS["AT"])
    v = np.zeros(robot.n_v)
    v[:3] = 0.3, -0.2, 0.1
    q = robot.configuration(rpy=(0.0, 0.0, 0.4))
    still = _found(function, TASKS["AT"], q)
    moving = _found(function, TASKS["AT"], q, v)
    later = _found(function, TASKS["AT"], pin.integrate(robot.model, q, STEP * v))
    turned = (later["misalignment"] - still["misalignment"]).item() / STEP
    assert abs(turned) > 1e-2
    assert (still["rate"] - moving["rate"]).item() == pytest.approx(turned, rel=1e-4)


@pytest.mark.parametrize("name", ["HA", "AT"])
def test_a_turn_that_is_asked_for_brings_the_axis_nearer_at_that_rate(
    name: str, robot: Robot
) -> None:
    """At any pitch, where roll and yaw are off: the angle in the plane that is driven falls as the
    row says.
    """
    task = TASKS[name]
    function = task_function(robot, TASKS[name])
    for pitch in (-0.7, 0.0, 0.7):
        for offset in (-2.5, -0.4, 0.4, 2.5):
            roll, yaw = (
                (offset, 0.3) if name == "HA" else (0.0, np.arctan2(GOAL[1], GOAL[0]) + offset)
            )
            q = robot.configuration(rpy=(roll, pitch, yaw))
            rows = _found(function, task, q)
            v = np.linalg.pinv(rows["jacobian"])[:, 0] * rows["rate"].item()
            assert rows["rate"].item() < 0.0
            R = pin.Quaternion(q[3:7]).matrix()
            turned = pin.integrate(robot.model, q, STEP * v)
            R_then = pin.Quaternion(turned[3:7]).matrix()
            angles = [_angle(name, rotation) for rotation in (R, R_then)]
            assert (angles[1] - angles[0]) / STEP == pytest.approx(rows["rate"].item(), rel=1e-3)


def _angle(name: str, R_WB: np.ndarray) -> float:
    """[rad] by roll alone or by yaw alone, in the frame of the vehicle."""
    goal = R_WB.T @ (
        np.array([0.0, 0.0, 1.0]) if name == "HA" else np.array([GOAL[0], GOAL[1], 0.0])
    )
    ahead = goal[2] if name == "HA" else goal[0]
    return float(np.arctan2(abs(goal[1]), ahead))


def test_a_pitch_that_nobody_drives_is_no_error_of_alignment_but_is_one_of_the_tilt(
    robot: Robot,
) -> None:
    q = robot.configuration(rpy=(0.0, 0.5, np.arctan2(GOAL[1], GOAL[0])))
    assert evaluate(robot, TASKS["AT"], q)["misalignment"] == pytest.approx(0.0, abs=1e-9)
    assert evaluate(robot, TASKS["HA"], q)["tilt"] == pytest.approx(0.5)
    pose = VehiclePose(goal=pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 0.2), GOAL))
    level = evaluate(robot, pose, robot.configuration(rpy=(0.0, 0.0, 0.2)))
    pitched = evaluate(robot, pose, robot.configuration(rpy=(0.0, 0.5, 0.2)))
    assert level["jacobian"].shape == (5, robot.n_v)
    assert pitched["orientation_error"] == pytest.approx(0.0, abs=1e-9)


def test_the_row_of_an_axis_that_nothing_turns_asks_for_nothing(robot: Robot) -> None:
    machine = flat(robot)
    q = machine.configuration(rpy=(0.6, 0.4, 1.0))
    rows = evaluate(machine, TASKS["HA"], q)
    assert not rows["jacobian"].any()
    assert rows["rate"].item() == 0.0
    assert rows["upper"].item() > 0.0
    assert rows["tilt"].item() > 0.5


@pytest.mark.sampled
@pytest.mark.parametrize("above", [(), ("AT",), ("HA", "AT")])
def test_the_way_point_is_approached_at_any_pitch(above: tuple[str, ...], robot: Robot) -> None:
    """No command leads away from the goal of the highest task that translates, whatever angles
    stand above it.
    """
    rng = np.random.default_rng(6)
    tasks: list[Task] = [UnderActuation(axes=(PITCH,)), *(TASKS[name] for name in above)]
    for _ in range(10):
        q = robot.configuration(
            rpy=(rng.uniform(-0.3, 0.3), rng.uniform(-0.8, 0.8), rng.uniform(-3, 3))
        )
        goal = pin.SE3(np.eye(3), rng.uniform(-4, 4, 3))
        v = np.zeros(robot.n_v)
        v[PITCH] = rng.uniform(-0.3, 0.3)
        command = command_of(robot, [*tasks, VehiclePose(goal=goal)], q, v)
        velocity = pin.Quaternion(q[3:7]).matrix() @ command[:3]
        assert velocity @ goal.translation > 0.0
