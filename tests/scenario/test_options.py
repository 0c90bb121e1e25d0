"""Options of the same meaning have the same name and the same default in every scenario."""

from __future__ import annotations

import inspect
from dataclasses import MISSING, fields
from functools import cache

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.robot.description import TrimBody
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import IDEAL_SENSORS
from uvms_ocp.scenario.cases import SCENARIOS
from uvms_ocp.scenario.options import RunOptions, apply_options, run_options
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.icat import Icat

LONGER = {"two_targets": 240.0, "current_drift": 150.0}
"""[s] Missions in which the vehicle lands twice."""
SAMPLE = TrimBody(name="sample", link="base_link", position=(0.0, 0.0, 0.0), mass=1.0, volume=0.0)


@cache
def default(name: str) -> Scenario:
    return SCENARIOS[name]()


@cache
def chosen(name: str) -> Scenario:
    return SCENARIOS[name](
        solver=Icat(),
        plant="kinematic",
        current=(0.1, 0.0, 0.0),
        seabed=-41.0,
        noise=True,
        observer=False,
        payload=SAMPLE,
        seed=3,
        dt=0.01,
        duration=7.0,
    )


@pytest.mark.parametrize("name", SCENARIOS)
def test_defaults_are_those_of_every_other_scenario(name: str) -> None:
    scenario = default(name)
    assert isinstance(scenario.solver, LexicographicActiveSet)
    assert (scenario.plant, scenario.dt, scenario.seed) == ("dynamic", 1 / 200, 0)
    assert scenario.duration == LONGER.get(name, 120.0)
    assert scenario.sensors == IDEAL_SENSORS


@pytest.mark.parametrize(
    "name", [name for name in SCENARIOS if name != "case2"]
)  # whose plan depends on the floor
def test_every_common_option_reaches_the_scenario(name: str) -> None:
    scenario = chosen(name)
    assert isinstance(scenario.solver, Icat)
    assert (scenario.plant, scenario.seed, scenario.dt, scenario.duration) == (
        "kinematic",
        3,
        0.01,
        7.0,
    )
    np.testing.assert_array_equal(
        scenario.environment.current.velocity(np.zeros((1, 3)), 0.0)[0], [0.1, 0.0, 0.0]
    )
    assert scenario.sensors != IDEAL_SENSORS
    assert scenario.gains.observer_vehicle == 0.0
    assert scenario.plant_robot is not None
    assert scenario.plant_robot.description.trim[-1] == SAMPLE
    floor = scenario.environment.seafloor.height(100.0, 100.0)
    assert floor == pytest.approx(-41.0, abs=0.01)


@pytest.mark.parametrize(
    "name", [name for name in SCENARIOS if name != "current_drift"]
)  # which has its own
def test_the_observer_is_on_unless_it_is_turned_off(name: str) -> None:
    assert default(name).gains.observer_vehicle > 0.0


def test_options_default_to_what_a_scenario_made_by_hand_has() -> None:
    def defaults(cls: type) -> dict[str, object]:
        return {
            item.name: item.default if item.default_factory is MISSING else item.default_factory
            for item in fields(cls)
        }

    by_hand = defaults(Scenario)
    common = defaults(RunOptions)
    shared = ("solver", "plant", "seed", "dt", "duration")
    assert {name: common[name] for name in shared} == {name: by_hand[name] for name in shared}


def test_an_option_that_there_is_not_is_told_those_there_are() -> None:
    with pytest.raises(
        NameNotFound,
        match=(
            r"unknown option of all scenarios 'durration'; known: robot, .*Did you mean 'duration'"
        ),
    ):
        SCENARIOS["reach"](durration=3.0)


def test_a_robot_may_be_given_by_name_and_none_is_the_default() -> None:
    robot = load_robot("bluerov2_alpha5")
    assert run_options({"robot": robot}).robot is robot
    assert run_options({"robot": "bluerov2_alpha5"}).robot.name == robot.name
    assert run_options({"robot": None}).robot.name == "girona_maris7_full"
    with pytest.raises(InvalidInput, match="finite numbers"):
        run_options({"current": (0.1, 0.2)})


def test_options_need_nothing_that_has_a_default() -> None:
    assert not [
        item.name
        for item in fields(RunOptions)
        if item.default is MISSING and item.default_factory is MISSING
    ]
    alone = RunOptions()
    named = run_options({})
    assert (alone.robot, alone.seabed) == (named.robot, named.seabed)


@pytest.mark.parametrize("name", SCENARIOS)
def test_signatures_name_the_options_of_all_scenarios(name: str) -> None:
    parameters = inspect.signature(SCENARIOS[name]).parameters
    assert {each.name for each in fields(RunOptions)} <= set(parameters)
    assert "options" not in parameters
    assert all(each.kind is each.KEYWORD_ONLY for each in parameters.values())


@pytest.mark.parametrize("name", SCENARIOS)
def test_signatures_tell_the_defaults_that_scenarios_have(name: str) -> None:
    scenario = default(name)
    parameters = inspect.signature(SCENARIOS[name]).parameters
    assert parameters["robot"].default == scenario.robot.name
    for option in ("plant", "seed", "dt", "duration", "faults"):
        assert parameters[option].default == getattr(scenario, option)
    assert parameters["current"].default == scenario.environment.current
    assert SCENARIOS[name](duration=None, current=None).duration == scenario.duration


@pytest.mark.parametrize("faults", [0, 1j, object(), 0.5, True])
def test_faults_that_are_no_list_are_refused_with_what_a_fault_looks_like(faults: object) -> None:
    refused = pytest.raises(
        InvalidInput, match=r"^faults = .*; give a list of faults, each as TARGET:"
    )
    with refused:
        SCENARIOS["case1"](faults=faults)
    with refused:
        apply_options(default("reach"), {"faults": faults})


@pytest.mark.parametrize("noise", [(), np.zeros(0), np.zeros(2), "yes", 1])
def test_noise_that_is_neither_true_nor_false_is_refused(noise: object) -> None:
    with pytest.raises(InvalidInput, match=r"^RunOptions: noise = .*; give True or False"):
        apply_options(default("reach"), {"noise": noise})
