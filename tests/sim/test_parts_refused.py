"""A user's part whose results no run can use is refused in one line that names it and says what is
allowed.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from compiler import needs_compiler
from own_examples import Bursts, ComplementaryFilter, CopiedFilter, DoubleIntegrator, ExtraDrag, Pid

from uvms_ocp import export_controller
from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.export import exported_controller
from uvms_ocp.robot.signals import IDEAL_SENSORS, Command, Reading, Readings, State, StateEstimate
from uvms_ocp.scenario.cases import case1
from uvms_ocp.scenario.scenario import Scenario

NAN = float("nan")


def short(**parts: Any) -> Scenario:
    return replace(case1(dt=0.02, duration=0.2), **parts)


class Odd(DoubleIntegrator):
    """A plant whose state changes in one field, or whose telemetry is another, from its first step
    on.
    """

    def __init__(
        self, scenario: Scenario, state: dict[str, Any] | None = None, told: Any = None
    ) -> None:
        super().__init__(scenario)
        self.change = state or {}
        self.told = {} if told is None else told

    def step(self, command: Command, dt: float) -> None:
        super().step(command, dt)
        fields = {"q": self.state.q, "v": self.state.v}
        self.state = State(**{**fields, **self.change})

    def telemetry(self) -> dict[str, Any]:
        return self.told


class OddPlant:
    takes_forces = False

    def __init__(self, **odd: Any) -> None:
        self.odd = odd

    def __call__(self, scenario: Scenario) -> Odd:
        return Odd(scenario, **self.odd)


EFFORTS = {
    "thrust": np.zeros(8),
    "torque": np.zeros(7),
    "thruster_energy": np.full(8, NAN),
    "joint_energy": 0,
}


@pytest.mark.parametrize(
    ("odd", "message"),
    [
        (
            {"state": {"q": np.zeros(3)}},
            r"the state of plant OddPlant has q of shape \(3,\); give 14 finite numbers",
        ),
        (
            {"state": {"v": np.full(13, NAN)}},
            "the state of plant OddPlant has v not finite; give 13 finite numbers",
        ),
        (
            {"state": {"v": np.zeros(13, int)}},
            "plant OddPlant has v of type int64; give 13 finite numbers",
        ),
        (
            {"state": {"a": np.full(13, NAN)}},
            "plant OddPlant has a not finite; give 13 finite numbers",
        ),
        (
            {"state": {"q": np.full(14, 0.1)}},
            "plant OddPlant has q with an attitude .* not of norm 1; normalize it",
        ),
        ({"told": []}, "telemetry of plant OddPlant is list; give a dict, empty for none"),
        (
            {"told": {"q": 1.0}},
            "telemetry of plant OddPlant has 'q', which means something else in records; rename it",
        ),
        (
            {"told": {"current": np.zeros(2)}},
            r"has current of shape \(2,\); give finite numbers of shape \(3,\)",
        ),
        (
            {"told": {"contact": np.zeros(3)}},
            r"has contact of shape \(3,\); give finite numbers of shape \(4,\)",
        ),
        (
            {"told": {"wrench": np.zeros(6)}},
            "has 'wrench', which means something else in records; rename it",
        ),
        (
            {"told": {"note": "text"}},
            r"has note of shape \(\) and type <U4; give numbers \(n,\), or one",
        ),
        (
            {"told": {"grid": np.eye(2)}},
            r"has grid of shape \(2, 2\) and type float64; give numbers \(n,\), or one",
        ),
        (
            {"told": {"thrust": np.zeros(8)}},
            "has 'thrust'; give all of thrust, torque, thruster_energy, joint_energy",
        ),
        (
            {"told": {**EFFORTS, "torque": np.zeros(3)}},
            r"has torque of shape \(3,\); give finite numbers of shape \(7,\)",
        ),
        (
            {"told": {**EFFORTS, "thrust": np.full(8, NAN)}},
            r"has thrust not finite; give finite numbers of shape \(8,\)",
        ),
    ],
)
def test_a_state_or_telemetry_that_cannot_be_recorded(odd: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidInput, match=message) as refused:
        short(plant=OddPlant(**odd)).run()
    assert "\n" not in str(refused.value)


def test_energy_that_is_not_known_is_no_mistake() -> None:
    record = short(plant=OddPlant(told=EFFORTS)).run()
    assert np.isnan(record["thruster_energy"]).all()
    assert record["joint_energy"].dtype == float


def measuring(scenario: Scenario, change: dict[str, Any]) -> Any:
    right = {
        "q": np.array(scenario.start),
        "v": np.zeros(scenario.robot.n_v),
        "altimeter_range": 3.0,
    }
    return lambda readings, t, command: StateEstimate(**{**right, **change})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"q": np.zeros(3)},
            r"the measurement of estimator measuring has q of shape \(3,\); give 14 finite numbers",
        ),
        ({"v": np.full(13, NAN)}, "estimator measuring has v not finite; give 13 finite numbers"),
        (
            {"q": np.zeros(14)},
            "estimator measuring has q with an attitude .* not of norm 1; normalize it",
        ),
        (
            {"std": np.full(13, NAN)},
            "estimator measuring has std not finite; give 13 finite numbers",
        ),
    ],
)
def test_a_measurement_that_no_controller_can_take(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        short(estimator=partial(measuring, change=change)).run()


@pytest.mark.parametrize("outcomes", [np.zeros((9, 3)), np.zeros((9, 4), int), np.zeros((4, 9)).T])
def test_outcomes_that_the_monitor_cannot_share(outcomes: np.ndarray) -> None:
    def made(scenario: Scenario) -> CopiedFilter:
        estimator = CopiedFilter(replace(scenario, sensors=replace(IDEAL_SENSORS, depth=None)))
        estimator.outcomes = outcomes
        return estimator

    with pytest.raises(
        InvalidInput, match=r"outcomes of estimator made .*; give \(9, 4\), floats row by row"
    ):
        short(estimator=made).run()


def reading(change: dict[str, Any]) -> Any:
    def sensors(state: State, t: float) -> Readings:
        return Readings(**{name: Reading(value=value, t=t) for name, value in change.items()})

    return sensors


class OddSensors:
    specs = replace(IDEAL_SENSORS, depth=None)

    def __init__(self, readings: Any) -> None:
        self.made = readings

    def __call__(self, scenario: Scenario) -> Any:
        return self.made


@pytest.mark.parametrize(
    ("readings", "message"),
    [
        (3.0, r"sensors OddSensors made float; make a callable \(State, t\) -> Readings"),
        (lambda state, t: None, "sensors OddSensors returned NoneType; return Readings"),
        (
            reading({"joint_positions": np.zeros(3)}),
            r"OddSensors read joint_positions of shape \(3,\); give \(7,\)",
        ),
        (
            reading({"depth": -3.0}),
            "OddSensors read depth, which their specs leave out; add it to them",
        ),
    ],
)
def test_readings_that_are_none(readings: Any, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        short(sensors=OddSensors(readings)).run()


def test_a_reading_that_is_no_number_is_a_sensor_that_fails() -> None:
    class Blinded(Bursts):
        def __call__(self, scenario: Scenario) -> Any:
            sensors = super().__call__(scenario)
            spoilt = Reading(value=np.full(3, NAN), t=0.0)
            return lambda state, t: replace(
                sensors(state, t), **({"linear_velocity": spoilt} if t > 0.1 else {})
            )

    record = short(sensors=Blinded(share=0.0, specs=IDEAL_SENSORS)).run()
    assert any(alarm.text.startswith("linear_velocity") for alarm in record.run_meta.alarms)


def test_what_sensors_do_to_the_state_they_see_changes_nothing() -> None:
    class Greedy(Bursts):
        def __call__(self, scenario: Scenario) -> Any:
            sensors = super().__call__(scenario)

            def read(state: State, t: float) -> Readings:
                readings = sensors(state, t)
                state.q[:3] += 1.0
                return readings

            return read

    ours = short()
    np.testing.assert_array_equal(
        replace(ours, sensors=Greedy(share=0.0, specs=IDEAL_SENSORS)).run()["q"], ours.run()["q"]
    )


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (
            {"plant": Pid()},
            (
                "plant Pid has no takes_forces; give it True for thrust and torque, False for"
                " velocities alone"
            ),
        ),
        ({"plant": 3.0}, "plant = 3.0; give a string or a function"),
        (
            {"sensors": ComplementaryFilter},
            "sensors ComplementaryFilter have no specs, a SensorSpecs; give it",
        ),
        ({"estimator": 3.0}, "estimator = 3.0; give a function"),
    ],
)
def test_what_makes_no_part_is_refused_before_the_run(parts: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        short(**parts)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (
            {"estimator": lambda scenario: 3.0},
            r"estimator made float; make a callable \(Readings, t, command\)",
        ),
        (
            {"estimator": lambda scenario: lambda *given: 3.0},
            "estimator lambda returned float; return a StateEstimate",
        ),
    ],
)
def test_what_is_no_part_is_refused_as_the_run_begins(parts: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        short(**parts).run()


def test_a_maker_of_what_is_no_plant() -> None:
    class Nothing:
        takes_forces = False

        def __call__(self, scenario: Scenario) -> Any:
            return 3.0

    with pytest.raises(
        InvalidInput, match="plant Nothing made float without state, step, telemetry; make a Plant"
    ):
        short(plant=Nothing()).run()


def test_the_names_of_plants_are_known() -> None:
    with pytest.raises(NameNotFound, match="unknown plant 'statc'; known: dynamic, kinematic"):
        short(plant="statc")


@pytest.mark.parametrize(
    ("parts", "fault", "message"),
    [
        (
            {"plant": ExtraDrag()},
            "joint2:jam@1",
            "joint2:jam@1: plant ExtraDrag has no 'joint' in its simulated_faults",
        ),
        (
            {"plant": DoubleIntegrator},
            "current:step=0.1,0,0@1",
            "plant DoubleIntegrator has no 'current' in its simulated_faults",
        ),
        (
            {"sensors": Bursts(share=0.0, specs=IDEAL_SENSORS)},
            "depth:lost@1",
            "sensors Bursts has no 'depth'",
        ),
    ],
)
def test_a_fault_that_an_own_part_does_not_have_is_refused(
    parts: dict[str, Any], fault: str, message: str
) -> None:
    with pytest.raises(InvalidInput, match=message):
        replace(case1(faults=(fault,)), **parts)


@needs_compiler
def test_parts_that_are_not_exported_do_not_stand_in_the_way(tmp_path: Path) -> None:
    scenario = short(plant=DoubleIntegrator, estimator=CopiedFilter)
    export_controller(scenario, tmp_path / "c")
    record = replace(scenario, controller=exported_controller(tmp_path / "c")).run()
    assert record.run_meta.controller == "exported"
    np.testing.assert_array_equal(record["q"], scenario.run()["q"])


def test_what_cannot_be_exported_is_told_by_its_name(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="no form in C: controller Pid; the toolkit's own has"):
        export_controller(short(controller=Pid()), tmp_path)
