"""Laws of both controllers as callables: what they do follows from their measurements alone, each
looked at once.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.codegen.kernel_layout import assign
from uvms_ocp.control.force.dynamic import DynamicController, VelocityGains
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.control.velocity.tick_state import TickInputs
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.fallbacks import LastValidEstimate
from uvms_ocp.robot.dynamics import Dynamics, robot_dynamics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import Command, StateEstimate
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.scenario import Scenario

Controller = KinematicController | DynamicController
Build = Callable[[Scenario], Controller]


def kinematic(scenario: Scenario) -> KinematicController:
    return scenario.kinematic_controller()


def dynamic(scenario: Scenario) -> DynamicController:
    robot = scenario.robot
    return DynamicController(
        robot=robot, dynamics=robot_dynamics(robot), kinematic=scenario.kinematic_controller()
    )


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return case1(plant="kinematic", dt=1 / 50)


@pytest.fixture(scope="module")
def measurements(scenario: Scenario) -> list[StateEstimate]:
    """Noisy ones along Case 1, with numbers that are none, lost echoes, and a blackout towards the
    end.
    """
    robot = scenario.robot
    rng = np.random.default_rng(8)
    control = kinematic(scenario)
    q = scenario.start
    v = np.zeros(robot.n_v)
    estimates = []
    for k in range(600):
        noise = 1e-3 * rng.standard_normal(robot.n_v)
        measured = np.array(pin.integrate(robot.model, q, noise))
        measured[k % robot.n_q] = np.nan if k % 37 == 5 else measured[k % robot.n_q]
        echo = np.nan if k % 11 < 3 else q[2] + 40.0
        age = max(0.0, (k - 500) * scenario.dt)
        estimates.append(
            StateEstimate(q=measured, v=v + noise, altimeter_range=echo, age=age, joint_age=age)
        )
        v = control(estimates[-1], k * scenario.dt).v
        q = pin.integrate(robot.model, q, v * scenario.dt)
    return estimates


def fed(control: Controller, measurements: list[StateEstimate], dt: float) -> list[Command]:
    return [control(measurement, k * dt) for k, measurement in enumerate(measurements)]


def assert_same(first: Any, second: Any) -> None:
    if first is None:
        assert second is None
    else:
        np.testing.assert_array_equal(first, second)


@pytest.mark.sampled
@pytest.mark.parametrize("build", [kinematic, dynamic])
def test_the_same_measurements_give_the_same_commands(
    scenario: Scenario, measurements: list[StateEstimate], build: Build
) -> None:
    runs = [fed(build(scenario), measurements, scenario.dt) for _ in range(2)]
    for first, second in zip(*runs, strict=True):
        for name in ("v", "thrust", "torque", "hold", "stop", "brakes", "finished"):
            assert_same(getattr(first, name), getattr(second, name))
        for name in set(first.telemetry) - {"tick_time", "solve_time"}:
            assert_same(first.telemetry[name], second.telemetry[name])
    assert any(command.hold for command in runs[0])
    assert not all(command.hold for command in runs[0])


def test_the_dynamic_layer_leaves_the_velocities_of_the_kinematic_one_as_they_are(
    scenario: Scenario, measurements: list[StateEstimate]
) -> None:
    pairs = zip(
        fed(kinematic(scenario), measurements, scenario.dt),
        fed(dynamic(scenario), measurements, scenario.dt),
        strict=True,
    )
    for first, second in pairs:
        np.testing.assert_array_equal(first.v, second.v)
        assert first.hold == second.hold


@pytest.mark.sampled
@pytest.mark.parametrize("build", [kinematic, dynamic])
def test_a_tick_asks_once_whether_its_measurement_is_sound(
    scenario: Scenario,
    measurements: list[StateEstimate],
    build: Build,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls = []
    ask = LastValidEstimate.substitute

    def counting(self: LastValidEstimate, measurement: StateEstimate) -> StateEstimate:
        calls.append(measurement)
        return ask(self, measurement)

    monkeypatch.setattr(LastValidEstimate, "substitute", counting)
    fed(build(scenario), measurements[:50], scenario.dt)
    assert [id(measurement) for measurement in calls] == [
        id(measurement) for measurement in measurements[:50]
    ]


@pytest.mark.sampled
@pytest.mark.parametrize("build", [kinematic, dynamic])
def test_a_controller_has_all_its_memory_from_the_start(
    scenario: Scenario, measurements: list[StateEstimate], build: Build
) -> None:
    control = build(scenario)
    before = set(vars(control))
    fed(control, measurements[:100], scenario.dt)
    assert set(vars(control)) == before


def test_what_a_tick_knows_is_finite_and_cannot_be_changed(
    scenario: Scenario, measurements: list[StateEstimate]
) -> None:
    control = kinematic(scenario)
    for k, measurement in enumerate(measurements[:100]):
        tick = control.observe(measurement, k * scenario.dt)
        assert isinstance(tick, TickInputs)
        assert np.isfinite(tick.estimate.q).all()
        assert np.isfinite(tick.echo)
        assert tick.mission is control.state
        control.command(tick)
    with pytest.raises(AttributeError):
        tick.t = 0.0  # type: ignore[misc]


def test_evaluating_a_measurement_leaves_the_commands_as_they_are(
    scenario: Scenario, measurements: list[StateEstimate]
) -> None:
    plain = kinematic(scenario)
    evaluated = kinematic(scenario)
    for k, measurement in enumerate(measurements[:60]):
        if np.isfinite(measurement.q).all():
            evaluated.evaluate(measurement, k * scenario.dt)
        commands = plain(measurement, k * scenario.dt), evaluated(measurement, k * scenario.dt)
        np.testing.assert_array_equal(commands[0].v, commands[1].v)


class Asking(KinematicController):
    """A velocity layer that asks for v0 + a t on every axis, whatever the mission."""

    def __init__(
        self, scenario: Scenario, *, v0: np.ndarray, a: np.ndarray, dt: float = 0.02
    ) -> None:
        self.memory = scenario.kinematic_controller().memory
        self.memory.awaits_first = False
        self.v0 = v0
        self.a = a
        self.dt = dt
        self.guide = None
        self.watchdog = SimpleNamespace(alarms=[])

    def observe(self, measurement: StateEstimate, t: float) -> SimpleNamespace:
        assign(self.memory, q=measurement.q, v=measurement.v, t=t)
        return SimpleNamespace(t=t)

    def command(self, tick: SimpleNamespace) -> Command:
        command = Command(v=self.v0 + self.a * tick.t)
        assign(self.memory, command=command.v)
        return command


@pytest.fixture(scope="module")
def dynamics(scenario: Scenario) -> Dynamics:
    return robot_dynamics(scenario.robot)


def efforts_after(
    scenario: Scenario, dynamics: Dynamics, asking: Asking, error: np.ndarray, *, later: int = 0
) -> np.ndarray:
    """Wrench and torque (n_v,) that a controller asks for when nothing is amiss, right after 20
    ticks with such errors of velocity, or so many ticks later.
    """
    gains = VelocityGains(observer_vehicle=0.0)
    control = DynamicController(
        robot=scenario.robot, dynamics=dynamics, kinematic=asking, gains=gains
    )
    for k in range(21 + later):
        v = asking.v0 + asking.a * k * asking.dt
        measured = v - error if k < 20 else v
        command = control(
            StateEstimate(q=scenario.start, v=measured, altimeter_range=3.0), k * asking.dt
        )
    return np.concatenate([command.telemetry["wrench"], command.torque])


@pytest.mark.sampled
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("axis", [0, 5, 9])
def test_an_axis_at_the_end_of_its_force_does_not_wind_up(
    scenario: Scenario, dynamics: Dynamics, axis: int, sign: float
) -> None:
    still = Asking(scenario, v0=np.zeros(scenario.robot.n_v), a=np.zeros(scenario.robot.n_v))
    unit = sign * np.eye(scenario.robot.n_v)[axis]
    # Motors make up for thrusters, whose thrust takes some ticks to end.
    fresh, pushed, leaned = (
        efforts_after(scenario, dynamics, still, size * unit, later=150)
        for size in (0.0, 50.0, 1e-3)
    )
    np.testing.assert_allclose(pushed, fresh, atol=1e-9)
    assert (leaned - fresh) @ unit > 1e-6


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("axis", [0, 5])
def test_an_axis_at_the_end_of_its_force_still_unwinds(
    scenario: Scenario, dynamics: Dynamics, axis: int, sign: float
) -> None:
    unit = sign * np.eye(scenario.robot.n_v)[axis]
    hurried = Asking(scenario, v0=unit, a=20.0 * unit)  # too fast from the first tick on
    on_time, ahead = (
        efforts_after(scenario, dynamics, hurried, error * unit) for error in (0.0, -1e-2)
    )
    assert (ahead - on_time) @ unit < -1e-4


def test_a_kinematic_controller_of_another_robot_is_refused() -> None:
    scenario = case1()
    other = load_robot("planar5")
    with pytest.raises(InvalidInput, match="give one of the same robot"):
        DynamicController(
            robot=other, dynamics=robot_dynamics(other), kinematic=kinematic(scenario)
        )
