"""A robot's clock begins where it likes: what is commanded depends on time that has passed, not on
what the clock shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from odd_robots import ODD, pair_of

import uvms_ocp as uo
from uvms_ocp.mission import ABORT, Abort
from uvms_ocp.robot.loading import list_robots
from uvms_ocp.robot.signals import CHANNELS, IDEAL_SENSORS, Reading, Readings, SensorSpecs, State
from uvms_ocp.sim import SensorSuite
from uvms_ocp.tasks import HorizontalAttitude, JointTracking, VehiclePose
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial

TICKS = 80
SENSORS = {"ideal": IDEAL_SENSORS, "noisy": SensorSpecs()}


class Swing:
    """A goal that never rests, asked of Python at every tick."""

    def __call__(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        return np.array([0.3 * np.sin(t)]), np.array([0.3 * np.cos(t)])


def mission_of_moving_goals(joints: Sequence[str]) -> uo.Mission:
    """Two phases: goals of tasks and of phases that move, in tables and asked for, a hold, an
    abort.
    """
    first, second = joints
    ramp = PiecewisePolynomial(
        breaks=[0.0, 3.0], coefficients=np.array([[[0.0], [0.1]]]).transpose(1, 0, 2)
    )
    tasks = [
        HorizontalAttitude(),
        VehiclePose(goal=uo.pose_at((0.05, 0.0, -5.0))),
        JointTracking(name="table", joints=(first,), goal=ramp),
        JointTracking(name="asked", joints=(second,), goal=Swing()),
    ]
    on = {task.name: 1.0 for task in tasks}
    go = uo.Transition(to="on", when=(uo.Below(quantity="PC.position_error", limit=1.0),), hold=0.3)
    never = uo.Transition(to=uo.DONE, when=(uo.Below(quantity="PC.position_error", limit=1e-9),))
    phases = (
        uo.Phase(name="begin", activations=on, transitions=(go,), goals={"asked": Swing()}),
        uo.Phase(name="on", activations=on, transitions=(never,), goals={"table": ramp}),
    )
    climb = uo.Phase(
        name="climb", activations=on, transitions=(uo.Transition(to=ABORT, when=never.when),)
    )
    return uo.Mission(
        hierarchy=uo.Hierarchy(tasks),
        phases=phases,
        abort=Abort(phase=climb, ascent_task="PC", stall_after=0.61),
    )


def scenario_of(robot: uo.Robot, joints: Sequence[str]) -> uo.Scenario:
    return uo.Scenario(
        name="clock",
        dt=0.02,
        robot=robot,
        mission=mission_of_moving_goals(joints),
        environment=uo.Environment(seafloor=uo.FlatSeafloor(z=-40)),
        start=robot.configuration(position=(0, 0, -5)),
    )


def commands(scenario: uo.Scenario, began: float) -> tuple[np.ndarray, list[tuple[str, float]]]:
    """What is estimated and commanded at each tick, and events with the time that has passed, as
    the clock began at [s].
    """
    estimator = scenario.estimator()
    controller = scenario.controller()
    robot = scenario.robot
    suite = SensorSuite(robot, scenario.environment.seafloor, scenario.sensors, 0)
    command = None
    rows = []
    q = np.array(scenario.start)
    v = np.zeros(robot.n_v)
    for k in range(TICKS):
        passed = k * scenario.dt
        readings = suite.read(State(q=q, v=v, a=np.zeros(robot.n_v)), passed)
        estimate = estimator(_shifted(readings, began), began + passed, command)
        command = controller(estimate, began + passed)
        v = command.v
        q = pin.integrate(robot.model, q, v * scenario.dt)
        rows.append(np.concatenate([estimate.q, command.v, command.thrust, command.torque]))
    return np.array(rows), [
        (event.target, event.t - began) for event in controller.kinematic.events
    ]


def _shifted(readings: Readings, began: float) -> Readings:
    shifted = {}
    for name in CHANNELS:
        reading = getattr(readings, name)
        if reading is not None:
            shifted[name] = Reading(value=reading.value, t=reading.t + began)
    return Readings(**shifted)


BEGINNINGS = [-64.0, 50.0, 1e3, 1.76e9]
OTHERS = [
    name
    for name in list_robots()
    if uo.load_robot(name).n_vehicle and uo.load_robot(name).n_joints > 1
][1:]


@pytest.mark.sampled
@pytest.mark.parametrize("sensors", SENSORS)
@pytest.mark.parametrize("began", BEGINNINGS)
def test_commands_are_the_same_whatever_the_clock_shows(sensors: str, began: float) -> None:
    _same_commands(uo.load_robot("bluerov2_alpha5"), SENSORS[sensors], began)


@pytest.mark.slow
@pytest.mark.parametrize("began", BEGINNINGS)
@pytest.mark.parametrize("name", OTHERS)
def test_commands_of_every_robot_are_the_same_whatever_the_clock_shows(
    name: str, began: float
) -> None:
    _same_commands(uo.load_robot(name), SENSORS["noisy"], began, fastest=1e4)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ODD)
def test_commands_of_robots_with_an_odd_joint_are_the_same_whatever_the_clock_shows(
    kind: str,
) -> None:
    _same_commands(pair_of(kind).odd, SENSORS["noisy"], 1e3, joints=("turn0", "turn2"))


def _same_commands(
    robot: uo.Robot,
    specs: SensorSpecs,
    began: float,
    joints: Sequence[str] = (),
    fastest: float = 1e3,
) -> None:
    """But for what changes within the resolution of the clock, at most this fast [N/s and the
    like].
    """
    study = replace(scenario_of(robot, joints or robot.joint_names[:2]), sensors=specs)
    expected, events = commands(study, 0.0)
    assert [target for target, _ in events][:1] == ["on"]
    shifted, found_events = commands(study, began)
    resolution = np.spacing(abs(began))  # [s] of times
    np.testing.assert_allclose(shifted, expected, rtol=0, atol=1e-9 + fastest * resolution)
    assert [target for target, _ in found_events] == [target for target, _ in events]
    np.testing.assert_allclose(
        [t for _, t in found_events], [t for _, t in events], rtol=0, atol=1e-9 + 2 * resolution
    )
