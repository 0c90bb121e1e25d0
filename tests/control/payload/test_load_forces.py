"""What a load does to the equations of motion, and what an observer makes of it."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.control.force.observer import ObserverLaw, ObserverState
from uvms_ocp.control.load_filter import LOAD_FRAME
from uvms_ocp.control.payload import COLUMNS, current_force, load_force, response_function
from uvms_ocp.robot.description import TrimBody
from uvms_ocp.robot.dynamics import Dynamics, robot_dynamics
from uvms_ocp.robot.hydrodynamics import Water
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.static_balance import with_trim

ROBOTS = ("girona_maris7_full", "bluerov2_alpha5")
DT = 1 / 200


@lru_cache
def dynamics(name: str) -> Dynamics:
    return robot_dynamics(load_robot(name))


def scene(robot: Robot, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    q = pin.integrate(
        robot.model, np.array(robot.configuration()), 0.5 * rng.normal(size=robot.n_v)
    )
    return q, 0.3 * rng.normal(size=robot.n_v), 0.5 * rng.normal(size=robot.n_v)


def tool_acceleration(
    robot: Robot, q: np.ndarray, v: np.ndarray, a: np.ndarray, tool: str
) -> np.ndarray:
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q, v, a)
    frame = robot.frame_id(tool)
    return pin.getFrameClassicalAcceleration(
        robot.model, data, frame, pin.LOCAL_WORLD_ALIGNED
    ).linear


TOOLS = [*((name, LOAD_FRAME) for name in ROBOTS), ("bluerov2_two_alpha5", "starboard_tool")]


@pytest.mark.parametrize(("mass", "volume"), [(2.0, 0.0), (3.0, 1e-3), (1.0, 4e-3)])
@pytest.mark.parametrize(("name", "tool"), TOOLS)
def test_a_load_changes_the_dynamics_by_its_weight_and_by_what_its_mass_resists(
    name: str, tool: str, mass: float, volume: float
) -> None:
    robot = load_robot(name)
    plain = dynamics(name)
    body = TrimBody(name="load", link=tool, position=(0.0, 0.0, 0.0), mass=mass, volume=volume)
    heavy = robot_dynamics(with_trim(robot, [body]))
    gravity = float(np.linalg.norm(robot.model.gravity.linear))
    weight = (mass - robot.description.water_density * volume) * gravity
    for seed in range(3):
        q, v, a = scene(robot, seed)
        columns = load_force(
            plain.symbolic, ca.SX(q), ca.SX(tool_acceleration(robot, q, v, a, tool)), tool
        )
        pushed = np.array(ca.DM(columns)) @ [weight, mass]
        lacking = plain.inverse_dynamics(q, v, a) - heavy.inverse_dynamics(q, v, a)
        np.testing.assert_allclose(pushed, lacking, atol=1e-9 * np.abs(lacking).max())


@pytest.mark.parametrize("name", ROBOTS)
def test_a_current_pushes_as_the_drag_of_the_model_says(name: str) -> None:
    plain = dynamics(name)
    q, v, a = scene(load_robot(name), 4)
    flow = np.array([0.2, -0.1, 0.05])
    columns = np.array(ca.DM(current_force(plain.symbolic, ca.SX(q), ca.SX(v), ca.SX(flow))))
    pushed = columns @ [1.0, *flow]
    lacking = plain.inverse_dynamics(q, v, a) - plain.inverse_dynamics(
        q, v, a, Water(velocity=flow)
    )
    np.testing.assert_allclose(pushed, lacking, atol=1e-9 * np.abs(lacking).max())


def test_an_observer_answers_forces_as_its_response_says() -> None:
    """Of different bandwidths on vehicle and joints, while the robot moves and with it the mass
    matrix.
    """
    robot = load_robot("bluerov2_alpha5")
    model = dynamics("bluerov2_alpha5")
    bandwidth = np.repeat([3.0, 4.0], [robot.n_vehicle, robot.n_joints])
    law = ObserverLaw(bandwidth=bandwidth, limit=np.full(robot.n_v, 1e3), dt=DT)
    observe = observer_function(law, model, robot)
    response = response_function(model.symbolic, law.response)
    x = ca.SX.sym("q", robot.n_q)
    weight_force = load_force(model.symbolic, x, ca.SX(3, 1))[:, 0]
    tool = ca.Function("tool", [x], [weight_force])
    q, v, _ = scene(robot, 5)
    full_share = np.ones(robot.n_v)
    zeros = np.zeros(3)
    observer_state = [np.zeros(robot.n_v), v, 1.0]
    answer = 2 * [np.zeros((robot.n_v, COLUMNS + 2))]
    for _ in range(400):
        push = 5.0 * np.array(tool(q)).ravel()
        tau = model.inverse_dynamics(q, v, -0.5 * v) - push
        observer_state = [*observe(q, v, tau, *observer_state)]
        answer = [*response(q, v, zeros, zeros, full_share, *answer)]
        q = pin.integrate(robot.model, q, DT * v)
        v = v - 0.5 * DT * v
    estimate = np.array(observer_state[0]).ravel()
    expected = 5.0 * np.array(answer[0])[:, 1]
    np.testing.assert_allclose(estimate, expected, atol=1e-9 * np.abs(expected).max())
    assert np.abs(expected - push).max() > 1e-4 * np.abs(push).max()


def observer_function(law: ObserverLaw, model: Dynamics, robot: Robot) -> ca.Function:
    q = ca.SX.sym("q", robot.n_q)
    n = robot.n_v
    v, tau, estimate, v_hat = (ca.SX.sym(name, n) for name in ("v", "tau", "estimate", "v_hat"))
    follows = ca.SX.sym("follows")
    before = ObserverState(estimate=estimate, lead=ca.SX(n, 1), v_hat=v_hat, follows=follows)
    after = law.after(before, model.symbolic, q, v, tau, ca.SX.ones(n))
    return ca.Function(
        "observer",
        [q, v, tau, estimate, v_hat, follows],
        [after.estimate, after.v_hat, after.follows],
    )
