"""Laws of a plan's tracking: computed torque, the end of the plan, and what a plant made of it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from horizon.tracking import tracked

from uvms_ocp.control.force.computed_torque import OPEN_LOOP, Actuators, TrackingGains
from uvms_ocp.control.plan_following import PlanTracker
from uvms_ocp.errors import FrameNotFound, InvalidInput
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import StateEstimate
from uvms_ocp.scenario.plan_replay import tracking_error
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import FlatSeafloor

DT = 1 / 200


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7_full")


def push_off(robot: Robot, duration: float = 2.0) -> Trajectory:
    """Half of the time forward, half of it slower again, by constant accelerations."""
    a = np.zeros((2, robot.n_v))
    a[:, 0] = [0.1, -0.1]
    a[:, 8] = [0.2, -0.2]
    h = duration / 2
    q = [np.array(robot.configuration(position=(0.0, 0.0, -5.0)))]
    v = np.array([np.zeros(robot.n_v), h * a[0], np.zeros(robot.n_v)])
    for k in range(2):
        q.append(pin.integrate(robot.model, q[k], h * v[k] + 0.5 * h * h * a[k]))
    n = len(robot.description.thrusters)
    return Trajectory(
        t=np.array([0.0, h, 2 * h]),
        q=np.array(q),
        v=v,
        a=a,
        thrust=np.zeros((2, n)),
        torque=np.zeros((2, robot.n_joints)),
    )


def tracker(robot: Robot, plan: Trajectory) -> PlanTracker:
    return PlanTracker(plan, robot, robot_dynamics(robot), dt=DT)


def carried_out(
    robot: Robot, plan: Trajectory, gains: TrackingGains | None = None
) -> dict[str, np.ndarray]:
    environment = Environment(seafloor=FlatSeafloor(z=-40))
    return tracked(robot, plan, environment, dt=DT, duration=10.0, gains=gains)


def test_the_loop_ends_with_the_plan(robot: Robot) -> None:
    record = carried_out(robot, push_off(robot))
    assert record["t"][-1] == pytest.approx(2.0)
    assert len(record["t"]) == round(2.0 / DT) + 1


def test_feedback_brings_a_plant_nearer_to_the_plan(robot: Robot) -> None:
    plan = push_off(robot)
    errors = [
        tracking_error(plan, record["t"], record["q"], robot=robot, frame="tool")
        for record in (carried_out(robot, plan), carried_out(robot, plan, OPEN_LOOP))
    ]
    assert errors[0].position < 0.01
    assert errors[0].end_position < errors[1].end_position


def test_a_plan_that_is_followed_exactly_has_no_mismatch_and_a_shift_is_its_length(
    robot: Robot,
) -> None:
    plan = push_off(robot)
    times = np.linspace(0.0, 2.0, 21)
    q = np.array([plan.state_at(robot.model, float(t))[0] for t in times])
    exact = tracking_error(plan, times, q, robot=robot, frame="tool")
    assert max(exact.position, exact.end_position, exact.end_orientation) < 1e-9
    q[10:, :3] += [0.03, 0.0, 0.04]
    q[-1, :3] -= [0.0, 0.0, 0.04]
    shifted = tracking_error(plan, times, q, robot=robot, frame="tool")
    assert shifted.position == pytest.approx(0.05)
    assert shifted.end_position == pytest.approx(0.03)
    with pytest.raises(FrameNotFound):
        tracking_error(plan, times, q, robot=robot, frame="hand")


def test_a_measurement_that_is_no_number_still_gives_a_command(robot: Robot) -> None:
    plan = push_off(robot)
    at_rest = np.zeros(robot.n_v)
    control = tracker(robot, plan)
    control(StateEstimate(q=plan.q[0], v=at_rest, altimeter_range=35.0), 0.0)
    command = control(
        StateEstimate(q=np.full(robot.n_q, np.nan), v=at_rest, altimeter_range=35.0), DT
    )
    assert np.isfinite(command.thrust).all()
    assert np.isfinite(command.torque).all()


def test_the_same_measurements_give_the_same_commands(robot: Robot) -> None:
    plan = push_off(robot)
    rng = np.random.default_rng(2)
    noise = 1e-3 * rng.standard_normal((50, robot.n_v))
    measurements = [
        StateEstimate(q=pin.integrate(robot.model, plan.q[0], row), v=row, altimeter_range=35.0)
        for row in noise
    ]
    runs = [
        [control(measurement, k * DT) for k, measurement in enumerate(measurements)]
        for control in (tracker(robot, plan), tracker(robot, plan))
    ]
    for first, second in zip(*runs, strict=True):
        np.testing.assert_array_equal(first.thrust, second.thrust)
        np.testing.assert_array_equal(first.torque, second.torque)


@pytest.mark.parametrize("name", ["girona_maris7_full", "bluerov2_alpha5", "planar5"])
def test_a_force_within_the_limits_is_realized_and_one_beyond_them_is_cut(name: str) -> None:
    machine = load_robot(name)
    rng = np.random.default_rng(1)
    actuators = Actuators(machine, lead=4.0, dt=DT)
    small = 1e-2 * rng.standard_normal(machine.n_v)
    np.testing.assert_allclose(actuators.realize(small).force, small, atol=1e-9)
    finite = np.isfinite(machine.limits.effort)
    large = actuators.realize(np.full(machine.n_v, 1e4))
    np.testing.assert_array_equal(large.torque[finite], machine.limits.effort[finite])
    assert large.allocation.saturated == bool(machine.n_vehicle)


def test_thrusters_that_are_driven_come_to_the_force_that_was_realized(robot: Robot) -> None:
    actuators = Actuators(robot, lead=4.0, dt=DT)
    desired = np.linspace(-2.0, 2.0, robot.n_v)
    assert not actuators.force.any()
    for _ in range(400):
        realized = actuators.realize(desired)
        actuators.drive(realized)
    np.testing.assert_allclose(actuators.force, realized.force, atol=1e-6)


def test_gains_that_make_no_sense_are_refused() -> None:
    with pytest.raises(InvalidInput, match=r"TrackingGains: lead = 0\.5; give a number from 1 "):
        TrackingGains(lead=0.5)
    assert TrackingGains(lead=1.0).lead == 1.0, "not driven faster than they are"


def test_the_open_loop_feeds_nothing_back() -> None:
    gains = {
        name: getattr(OPEN_LOOP, name)
        for name in TrackingGains.__dataclass_fields__
        if name != "lead"
    }
    assert gains == dict.fromkeys(gains, 0.0)
