"""What stands in for missing measurements, in both controllers: finite commands, and limits that
hold all the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace

import coal
import numpy as np
import pinocchio as pin
import pytest

import uvms_ocp as uo
from uvms_ocp.control.force.dynamic import DynamicController
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.estimation.fallbacks import LastValidEstimate
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.collision_model import CollisionModel
from uvms_ocp.robot.shapes.obstacles import Obstacle
from uvms_ocp.robot.signals import Command, StateEstimate
from uvms_ocp.tasks.altitude import MinimumAltitude
from uvms_ocp.tasks.attitude import HorizontalAttitude
from uvms_ocp.tasks.clearance import Clearance
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.pose import VehiclePose
from uvms_ocp.tasks.task import Task

DT = 0.02
THRESHOLD = 1.0
CALM = 0.55  # [s] shorter than the watchdog waits


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7_full")


def controller(robot: Robot, *tasks: Task) -> KinematicController:
    reached = uo.Transition(to=uo.DONE, when=(uo.Below(quantity="PC.position_error", limit=1e-9),))
    phase = uo.Phase(
        name="go", activations={task.name: 1 for task in tasks}, transitions=(reached,)
    )
    mission = uo.Mission(hierarchy=Hierarchy(list(tasks)), phases=(phase,), ramp=0.0)
    return KinematicController(
        robot=robot, mission=mission, solver=uo.LexicographicActiveSet(), dt=DT
    )


def diving(robot: Robot) -> KinematicController:
    pose = VehiclePose(goal=uo.pose_at((0, 0, -20)), gain_linear=2.0)
    return controller(
        robot,
        pose,
        MinimumAltitude(threshold=THRESHOLD, gain=20.0, margin=0.05),
        HorizontalAttitude(),
    )


def dynamic(robot: Robot) -> DynamicController:
    return DynamicController(robot=robot, dynamics=robot_dynamics(robot), kinematic=diving(robot))


@pytest.mark.sampled
@pytest.mark.parametrize("build", [diving, dynamic])
@pytest.mark.parametrize(("field", "index"), [("q", 0), ("q", 4), ("q", 10), ("v", 2), ("v", 9)])
def test_a_number_that_is_none_counts_as_a_silent_sensor(
    robot: Robot,
    build: Callable[[Robot], Callable[[StateEstimate, float], Command]],
    field: str,
    index: int,
) -> None:
    control = build(robot)
    q = robot.configuration(position=(0, 0, -4))
    broken = {"q": np.array(q), "v": np.zeros(robot.n_v)}
    broken[field][index] = np.nan
    control(StateEstimate(q=q, v=np.zeros(robot.n_v), altimeter_range=1.005), 0.0)
    commands = [
        control(StateEstimate(**broken, altimeter_range=1.005), DT * k) for k in range(1, 200)
    ]
    for command in commands:
        assert np.isfinite(command.v).all()
        assert command.thrust is None or np.isfinite(command.thrust).all()
        assert command.torque is None or np.isfinite(command.torque).all()
    assert [command.hold for command in commands[:20]] == [False] * 20
    assert commands[60].hold
    assert commands[-1].stop


def any_joints() -> SimpleNamespace:
    """A robot with every kind of joint that has a norm in it."""
    model = pin.Model()
    joint = 0
    for kind in (
        pin.JointModelFreeFlyer,
        pin.JointModelSpherical,
        pin.JointModelPlanar,
        pin.JointModelRUBZ,
        pin.JointModelRX,
    ):
        joint = model.addJoint(joint, kind(), pin.SE3.Identity(), kind.__name__)
    return SimpleNamespace(
        model=model,
        n_q=model.nq,
        n_v=model.nv,
        n_vehicle=6,
        n_joints=model.nv - 6,
        joint_q=slice(7, model.nq),
        description=SimpleNamespace(thrusters=()),
        configuration=lambda: pin.neutral(model),
    )


def test_a_configuration_is_sound_where_every_quaternion_and_circle_in_it_has_norm_one() -> None:
    """By Pinocchio, which knows the manifold of each joint."""
    anything = any_joints()
    rng = np.random.default_rng(1)
    validity = set()
    sound = LastValidEstimate(anything)  # type: ignore[arg-type]
    v = np.zeros(anything.n_v)
    assert sound.memory.n_units == 4
    for _ in range(100):
        q = pin.randomConfiguration(anything.model, -np.ones(anything.n_q), np.ones(anything.n_q))
        q[rng.integers(anything.n_q)] *= 1.0 + 3e-3 * rng.normal()
        estimate = sound(StateEstimate(q=q, v=v, altimeter_range=1.0), 0.0)
        assert bool(sound.memory.is_valid) == pin.isNormalized(anything.model, q, 1e-3)
        assert (estimate.q == q).all() == bool(sound.memory.is_valid)
        validity.add(bool(sound.memory.is_valid))
    assert validity == {True, False}


def test_a_robot_that_has_never_measured_holds_until_first_readings_are_overdue(
    robot: Robot,
) -> None:
    broken = StateEstimate(
        q=np.full(robot.n_q, np.nan), v=np.zeros(robot.n_v), altimeter_range=math.nan
    )
    assert LastValidEstimate(robot)(broken, 0.0).age == np.inf
    control = diving(robot)
    stop_after = control.watchdog.stop_after
    for t in (0.0, stop_after):
        command = control(broken, t)
        assert command.hold
        assert not command.stop
        assert not command.v.any()
    assert control(broken, stop_after + DT).stop


@pytest.mark.sampled
@pytest.mark.parametrize("outage", [0.0, CALM])
def test_minimum_altitude_holds_while_echoes_are_missing(robot: Robot, outage: float) -> None:
    control = diving(robot)
    q = robot.configuration(position=(0, 0, -4))
    v = np.zeros(robot.n_v)
    data = robot.model.createData()
    sensor = robot.frame_id("altimeter")
    since = math.inf
    lowest = math.inf
    for k in range(700):
        pin.framesForwardKinematics(robot.model, data, q)
        altitude = data.oMf[sensor].translation[2] + 7.0
        t = DT * k
        if altitude < 1.35:
            since = min(since, t)
        is_lost = since <= t < since + outage
        echo = math.nan if is_lost else altitude
        command = control(StateEstimate(q=q, v=v, altimeter_range=echo), t)
        assert not command.hold
        v = command.v
        lowest = min(lowest, altitude)
        q = pin.integrate(robot.model, q, v * DT)
    assert THRESHOLD - 1e-6 <= lowest < 1.1


@pytest.mark.slow
def test_a_blackout_beside_an_obstacle_leads_along_the_stop_that_was_found_clear(
    robot: Robot,
) -> None:
    rng = np.random.default_rng(0)
    n_near_limit = 0
    for _ in range(40):
        place = pin.SE3(np.eye(3), rng.uniform(-2.5, 2.5, 3))
        ball = Obstacle(name="ball", shape=coal.Sphere(0.4), X_WO=place)
        model = CollisionModel(robot, [ball], self_collision=False)
        q = robot.configuration()
        v = np.zeros(robot.n_v)
        if model.values(q).min() < 0.3:
            continue
        pose = VehiclePose(
            goal=uo.pose_at(tuple(place.translation), (0.0, 0.0, rng.uniform(-3, 3))),
            gain_linear=5.0,
        )
        control = controller(robot, Clearance(model=model, threshold=0.05, gain=50.0), pose)
        for k in range(400):
            blind = near_limit = model.values(q).min() < 0.12
            command = control(
                StateEstimate(q=q, v=v, altimeter_range=5.0, age=1.0 if blind else 0.0), DT * k
            )
            n_near_limit += near_limit
            if blind:
                # All axes in proportion, as the stop that the tick before has found clear.
                np.testing.assert_allclose(
                    command.v * np.linalg.norm(v), v * np.linalg.norm(command.v), atol=1e-9
                )
            v = command.v
            q = pin.integrate(robot.model, q, v * DT)
            assert model.values(q).min() >= 0.05 - 1e-6
            if blind and not v.any():
                break
    assert n_near_limit > 0
