"""Laws of the loop in machine code: the same rows, events and alarms as tick by tick, to the last
bit, or it is not used.
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from compiler import needs_compiler

from uvms_ocp.control import VelocityGains
from uvms_ocp.errors import UvmsError
from uvms_ocp.interrupts import Interrupted
from uvms_ocp.record.record import Record
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import ACCELEROMETER, SensorSpec, SensorSpecs
from uvms_ocp.scenario import Scenario, case1, obstacle_field, reach
from uvms_ocp.sim import compiled_loop
from uvms_ocp.sim.currents import GustyCurrent, UniformCurrent
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.rough_seafloor import HeightField, Relief
from uvms_ocp.solvers import Icat

CLOCKED = ("solve_time", "tick_time", "controller_time")
"""Series that a clock measures."""
SHORT: dict[str, Any] = {"duration": 4.0}
NOISY: dict[str, Any] = {**SHORT, "noise": True, "seed": 3}


def _rough() -> Scenario:
    scenario = case1(**NOISY)
    relief = Relief(height=(0.2, 0.8), radius=(1.0, 3.0), spacing=2.0)
    floor = HeightField.random(relief, z=-40.5, centre=(0.0, 0.0), extent=120.0, seed=1)
    current = GustyCurrent(base=UniformCurrent([0.2, -0.1, 0.0]))
    return replace(scenario, environment=Environment(seafloor=floor, current=current))


def _all_sensors() -> Scenario:
    """Late, lost, biased, of other axes, at every tick and at their own rate."""
    specs = SensorSpecs(
        specific_force=ACCELEROMETER,
        joint_velocities=SensorSpec(sigma=0.01, delay=0.02, dropout=0.3),
        depth=SensorSpec(rate=30.0, bias=0.05, dropout=0.5),
        attitude=SensorSpec(rate=50.0, sigma=0.01, bias=(0.01, 0.0, -0.02), delay=0.03),
    )
    return replace(case1(**NOISY), sensors=specs)


SCENARIOS: dict[str, Callable[[], Scenario]] = {
    "case1": lambda: case1(**SHORT),
    "to the end": lambda: case1(duration=60.0, noise=True, seed=3, dt=1 / 100),
    "kinematic": lambda: case1(**SHORT, plant="kinematic"),
    "kinematic with noise": lambda: case1(**NOISY, plant="kinematic"),
    "noise": lambda: case1(**NOISY),
    "the regularised solver": lambda: case1(**NOISY, solver=Icat()),
    "a current": lambda: case1(**NOISY, current=(0.1, 0.05, 0.0)),
    "gusts over a rough floor": _rough,
    "all sensors": _all_sensors,
    "obstacles": lambda: obstacle_field(**SHORT),
    "six thrusters": lambda: reach(**NOISY),
    "thrusters that fail": lambda: case1(
        **NOISY, faults=("thruster3:dead@1.003", "thruster5:weak=0.3@1-2.5")
    ),
    "a sensor that fails": lambda: case1(
        **NOISY, faults=("linear_velocity:lost@1-2", "position:spikes=3,0.2@2")
    ),
    "readings in the wrong order": lambda: case1(
        **NOISY, faults=("attitude:late=0.05@1-2", "depth:ahead=0.1@1")
    ),
    "a current that comes up": lambda: case1(**NOISY, faults=("current:step=0.2,0,0@1",)),
    "few rows": lambda: replace(case1(**NOISY), record_rate=7.0),
    "a period of 3 ms": lambda: replace(case1(**NOISY), dt=0.003, duration=1.0),
}
"""Scenarios of the toolkit's parts."""


def _tick_by_tick(scenario: Scenario) -> Record:
    return scenario.run(observer=lambda t, state, command: None)


def _require_same(actual: Record, expected: Record) -> None:
    assert list(actual.series) == list(expected.series)
    for name, values in actual.series.items():
        assert values.dtype == expected[name].dtype, name
        if name.removesuffix("_least").removesuffix("_most") in CLOCKED:
            assert (np.asarray(values) >= 0.0).all()
            assert values.shape == expected[name].shape
        else:
            np.testing.assert_array_equal(values, expected[name], err_msg=name)
    told = [
        {
            key: value
            for key, value in record.run_meta.model_dump().items()
            if key not in ("wall_s", "created")
        }
        for record in (actual, expected)
    ]
    assert told[0] == told[1]


@needs_compiler
@pytest.mark.parametrize("name", SCENARIOS)
def test_rows_events_and_alarms_are_those_of_single_ticks(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    used = []
    run = compiled_loop.CompiledLoop.run
    monkeypatch.setattr(
        compiled_loop.CompiledLoop, "run", lambda *arguments: used.append(1) or run(*arguments)
    )
    scenario = SCENARIOS[name]()
    quick = scenario.run()
    assert used
    _require_same(quick, _tick_by_tick(scenario))
    assert len(used) == 1


def _own(scenario: Scenario) -> Scenario:
    """With a controller of a user's own, which asks the toolkit's."""
    ours = scenario.controller

    def asking(scenario: Scenario) -> Any:
        loop = ours()
        return lambda measurement, t: replace(loop(measurement, t), telemetry={})

    return replace(scenario, controller=asking)


ASKING: dict[str, Callable[[], Scenario]] = {
    "a controller of one's own": lambda: _own(case1(**SHORT)),
    "a load that is learnt": lambda: case1(**NOISY, learn_load=True),
    "a joint that jams": lambda: case1(**NOISY, faults=("joint2:jam@1",)),
    "a load that is dropped": lambda: case1(**NOISY, faults=("payload:mass=2@1-2",)),
}
"""Scenarios in which Python is asked at every tick."""


@pytest.mark.parametrize("name", ASKING)
def test_who_has_to_be_asked_is(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*arguments: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(compiled_loop.CompiledLoop, "run", refuse)
    assert len(ASKING[name]().run()) == round(4.0 * 200) + 1


@needs_compiler
def test_a_run_that_diverges_ends_as_tick_by_tick(caplog: pytest.LogCaptureFixture) -> None:
    """Thrusts that grow: the gains are far beyond what the period allows."""
    wild = replace(
        case1(duration=30.0),
        gains=VelocityGains(vehicle=3000.0, joints=9000.0, observer_vehicle=0.0),
        dt=1 / 20,
    )
    quick = wild.run()
    messages = [record.getMessage() for record in caplog.records]
    caplog.clear()
    _require_same(quick, _tick_by_tick(wild))
    assert messages == [record.getMessage() for record in caplog.records]


@needs_compiler
def test_ctrl_c_leaves_the_rows_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = case1(**SHORT)
    caught = []
    look = compiled_loop.CompiledLoop._look

    def press(quick: compiled_loop.CompiledLoop, *arguments: Any) -> None:
        look(quick, *arguments)
        if quick.memory.t > 1.0 and not caught:
            caught.append(quick.memory.t)
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(compiled_loop.CompiledLoop, "_look", press)
    with pytest.raises(Interrupted) as stop:
        scenario.run()
    record = stop.value.result
    assert record["t"][-1] == caught[0]
    assert record.run_meta.stopped == "stopped"
    whole = _tick_by_tick(scenario)
    np.testing.assert_array_equal(record["q"], whole["q"][: len(record)])


def test_parts_of_robots_of_other_sizes_are_refused_as_tick_by_tick() -> None:
    """Kernels would write past the end of their memories."""
    scenario = case1(**SHORT)
    heavier = load_robot("bluerov2_alpha5")
    with pytest.raises(UvmsError, match=r"allowed: .* finite numbers|has shape"):
        replace(scenario, plant_robot=heavier).run()
