"""Laws of the tick: the same rows, events and alarms to the last bit whichever of its parts are
kernels and whichever are asked, many ticks at once or one by one, with a compiler or without.
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
from uvms_ocp.errors import InvalidInput, UvmsError
from uvms_ocp.interrupts import Interrupted
from uvms_ocp.record.record import Record
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import ACCELEROMETER, Command, SensorSpec, SensorSpecs, State
from uvms_ocp.scenario import Scenario, case1, obstacle_field, reach
from uvms_ocp.sim import loop, simulate, tick as sim_tick
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


ALL = sim_tick._AsKernels(plant=True, sensors=True, estimator=True, controller=True, gives=True)
ASKED: dict[str, sim_tick._AsKernels] = {
    "plant": ALL._replace(plant=False, gives=False),
    "sensors": ALL._replace(sensors=False),
    "estimator": ALL._replace(sensors=False, estimator=False),
    "controller": ALL._replace(controller=False, gives=False),
    "all": sim_tick._AsKernels(),
    "all but the plant": sim_tick._AsKernels(plant=True),
}
"""Which parts are kernels, by those that are asked."""


def _tick_by_tick(scenario: Scenario) -> Record:
    return scenario.run(observer=lambda t, state, command: None)


def _asking(scenario: Scenario, asked: str, monkeypatch: pytest.MonkeyPatch) -> Record:
    """The record of a run in which these parts are asked."""
    with monkeypatch.context() as patch:
        patch.setattr(sim_tick._AsKernels, "of", lambda *parts: ASKED[asked])
        return scenario.run()


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


@pytest.mark.sampled
@needs_compiler
@pytest.mark.parametrize("name", SCENARIOS)
def test_rows_events_and_alarms_are_those_of_single_ticks(name: str) -> None:
    scenario = SCENARIOS[name]()
    _require_same(scenario.run(), _tick_by_tick(scenario))


@pytest.mark.sampled
@needs_compiler
@pytest.mark.parametrize("asked", ASKED)
@pytest.mark.parametrize("name", ["noise", "all sensors", "a sensor that fails", "kinematic"])
def test_a_part_that_is_asked_gives_the_rows_of_its_kernels(
    name: str, asked: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = SCENARIOS[name]()
    expected = scenario.run()
    _require_same(_asking(scenario, asked, monkeypatch), expected)


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_parts_that_are_all_asked_give_the_rows_of_their_kernels(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = SCENARIOS[name]()
    expected = scenario.run()
    _require_same(_asking(scenario, "all", monkeypatch), expected)


def _own(scenario: Scenario) -> Scenario:
    """With a controller of a user's own, which asks the toolkit's."""
    ours = scenario.controller

    def asking(scenario: Scenario) -> Any:
        loop = ours()
        return lambda measurement, t: replace(loop(measurement, t), telemetry={})

    return replace(scenario, controller=asking)


PARTLY_PYTHON: dict[str, Callable[[], Scenario]] = {
    "a controller of one's own": lambda: _own(case1(**SHORT)),
    "a load that is learnt": lambda: case1(**NOISY, learn_load=True),
    "a joint that jams": lambda: case1(**NOISY, faults=("joint2:jam@1",)),
    "a joint that jams, kinematic": lambda: case1(
        **NOISY, plant="kinematic", faults=("joint2:jam@1-2",)
    ),
    "a load that is dropped": lambda: case1(**NOISY, faults=("payload:mass=2@1-2",)),
}
"""Scenarios in which Python takes part, at every tick or now and then."""


@pytest.mark.sampled
@needs_compiler
@pytest.mark.parametrize("name", PARTLY_PYTHON)
def test_python_that_takes_part_changes_no_row(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = PARTLY_PYTHON[name]()
    record = scenario.run()
    assert len(record) == round(4.0 * 200) + 1
    _require_same(record, _tick_by_tick(scenario))
    _require_same(record, _asking(scenario, "all", monkeypatch))


def test_what_a_part_raises_ends_the_run_at_once() -> None:
    """And not after the ticks that machine code would make meanwhile."""
    calls = []

    def failing(scenario: Scenario) -> Any:
        def read(state: Any, t: float) -> Any:
            calls.append(t)
            raise UvmsError("broken")

        return read

    failing.specs = case1(**NOISY).specs  # type: ignore[attr-defined]
    with pytest.raises(UvmsError, match="broken"):
        replace(case1(**NOISY), sensors=failing).run()
    assert calls == [0.0]


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


@pytest.mark.sampled
@needs_compiler
@pytest.mark.parametrize("asked", [None, "controller"])
def test_ctrl_c_leaves_the_rows_so_far(asked: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = case1(**SHORT)
    caught = list[float]()
    advance = loop.Loop.advance

    def press(running: loop.Loop, most: int) -> int:
        n_rows = advance(running, most)
        if running.t > 1.0 and not caught:
            caught.append(running.t)
            signal.raise_signal(signal.SIGINT)
        return n_rows

    if asked is not None:
        monkeypatch.setattr(sim_tick._AsKernels, "of", lambda *parts: ASKED[asked])
    monkeypatch.setattr(loop.Loop, "advance", press)
    with pytest.raises(Interrupted) as stop:
        scenario.run()
    record = stop.value.result
    assert record["t"][-1] == caught[0]
    assert record.run_meta.stopped == "stopped"
    whole = _tick_by_tick(scenario)
    np.testing.assert_array_equal(record["q"], whole["q"][: len(record)])


def test_ctrl_c_within_a_part_of_ones_own_ends_the_run_after_that_tick() -> None:
    scenario = case1(**SHORT)
    ours = scenario.controller
    caught = list[float]()

    def pressing(scenario: Scenario) -> Any:
        controller = ours()

        def control(estimate: Any, t: float) -> Any:
            if t > 1.0 and not caught:
                caught.append(t)
                signal.raise_signal(signal.SIGINT)
            return replace(controller(estimate, t), telemetry={})

        return control

    with pytest.raises(Interrupted) as stop:
        replace(scenario, controller=pressing).run()
    assert stop.value.result["t"][-1] == caught[0]


TOLD: dict[str, Any] = {
    "turned": np.arange(6.0).reshape(2, 3).T,
    "backwards": np.arange(6.0)[::-2],
    "whole": np.arange(3, dtype=np.int32),
    "saturated": 0.25,
    "thruster_health": np.array([1.5, 3.0]),
    "joint_health": 7,
}
"""Telemetry of a user: of any layout, and under names that other controllers use."""


def test_telemetry_of_ones_own_is_recorded_as_it_is() -> None:
    scenario = case1(duration=0.05)
    ours = scenario.controller

    def telling(scenario: Scenario) -> Any:
        controller = ours()
        return lambda estimate, t: replace(controller(estimate, t), telemetry=TOLD)

    record = replace(scenario, controller=telling).run()
    for name, told in TOLD.items():
        for row in record[name]:
            np.testing.assert_array_equal(row, told, err_msg=name)


def _supervised() -> Scenario:
    """With a controller of a user's own, which never says that it has finished."""
    scenario = case1(duration=60.0, dt=1 / 100)
    ours = scenario.controller

    def telling(scenario: Scenario) -> Any:
        loop = ours()
        return lambda estimate, t: replace(loop(estimate, t), telemetry={"own": t}, finished=False)

    return replace(scenario, controller=telling)


@pytest.mark.slow
def test_commands_of_a_supervised_controller_tell_the_mission_and_its_end() -> None:
    """To who looks on, such as a page that shows the phase, and to who steps by hand."""
    scenario = _supervised()
    commands = list[Command]()
    record = scenario.run(observer=lambda t, state, command: commands.append(command))
    assert record.run_meta.stopped == ""
    assert commands[-1].finished
    assert not commands[-2].finished
    assert {"own", "phase", "quantities"} <= commands[0].telemetry.keys()
    assert commands[-1].telemetry["phase"] == record["phase"][-1]
    stepped = scenario.simulation()
    assert len(stepped.run()) == len(record)
    assert stepped.finished


@pytest.mark.parametrize("judged_first", [True, False])
def test_an_estimator_that_judges_channels_now_and_then_is_refused(judged_first: bool) -> None:
    """Rows would repeat its last judgement, or have none."""
    scenario = case1(**NOISY)
    parts = scenario.simulation()._parts

    def estimate(readings: Any, t: float, command: Any) -> Any:
        estimate = parts.estimator(readings, t, command)
        return estimate if (t < 0.1) == judged_first else replace(estimate, health=())

    with pytest.raises(InvalidInput, match="health"):
        simulate(
            plant=parts.plant,
            sensors=parts.sensors,
            estimator=estimate,
            controller=parts.controller,
            dt=scenario.dt,
            duration=0.2,
        )


class _Flying:
    """A plant that begins faster than a record holds."""

    takes_forces = False

    def __init__(self, scenario: Scenario) -> None:
        v = np.full(scenario.robot.n_v, 1e120)
        self.state = State(q=np.array(scenario.start), v=v, a=np.zeros_like(v))

    def step(self, command: Command, dt: float) -> None:
        pass

    def telemetry(self) -> dict[str, Any]:
        return {}


@pytest.mark.filterwarnings("ignore:overflow")
def test_a_run_that_begins_diverged_has_its_first_row() -> None:
    record = replace(case1(**SHORT, plant="kinematic"), plant=_Flying).run()
    assert record["t"].tolist() == [0.0]
    assert record.run_meta.stopped == "diverged"


def test_parts_of_robots_of_other_sizes_are_refused_as_tick_by_tick() -> None:
    """Kernels would write past the end of their memories."""
    scenario = case1(**SHORT)
    heavier = load_robot("bluerov2_alpha5")
    with pytest.raises(UvmsError, match=r"allowed: .* finite numbers|has shape"):
        replace(scenario, plant_robot=heavier).run()
