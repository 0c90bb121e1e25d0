"""Parts of a user's own: they fly the mission, and keep record, report, figures, scene and
pre-flight.
"""

from __future__ import annotations

import multiprocessing
import pickle
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from compiler import long_without_compiler
from own_examples import (
    Bursts,
    ComplementaryFilter,
    CopiedFilter,
    CopiedKinematics,
    DoubleIntegrator,
    ExtraDrag,
    Pid,
)

from uvms_ocp.campaign.distributions import Uniform
from uvms_ocp.campaign.mission_job import MissionJob
from uvms_ocp.campaign.sampling_design import Design
from uvms_ocp.campaign.variations import Variation, available_parameters
from uvms_ocp.record.record import Record
from uvms_ocp.report import summarize
from uvms_ocp.scenario.cases import case1
from uvms_ocp.scenario.part_factories import our_controller, our_estimator
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.watched_estimator import WatchedGates, watched_estimator
from uvms_ocp.viz.run_figures import write_figures
from uvms_ocp.viz.scene.show import write_scene

TIMES = ("tick_time", "solve_time", "controller_time")
"""Series that no two runs have in common."""


def flown(**options: Any) -> Scenario:
    return case1(dt=0.02, **{"duration": 3.0, **options})


def all_own() -> Scenario:
    """Nothing in it is the toolkit's."""
    scenario = flown(noise=True)
    parts = {"plant": ExtraDrag(rate=0.3), "estimator": ComplementaryFilter, "controller": Pid()}
    return replace(scenario, sensors=Bursts(share=0.3, specs=scenario.specs), **parts)


def same(record: Record, ours: Record) -> Iterator[str]:
    """Series that differ; own ones may have more."""
    for name in ours.series.keys() - set(TIMES):
        if not np.allclose(record[name], ours[name], rtol=0.0, atol=1e-9, equal_nan=True):
            yield name


@pytest.mark.slow
@long_without_compiler
@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize(
    ("plant", "parts"),
    [
        ("dynamic", {"plant": ExtraDrag()}),
        ("kinematic", {"plant": CopiedKinematics}),
        ("dynamic", {"estimator": CopiedFilter}),
        ("dynamic", {"estimator": our_estimator, "controller": our_controller}),
        ("dynamic", {"controller": lambda scenario: our_controller(scenario)}),
    ],
)
def test_the_toolkits_own_part_as_somebody_elses_gives_the_same_record(
    plant: str, parts: Any, noise: bool
) -> None:
    ours = flown(plant=plant, noise=noise)
    study = replace(ours, **parts)
    assert list(same(study.run(), ours.run())) == []


@pytest.mark.sampled
@long_without_compiler
@pytest.mark.parametrize("noise", [False, True])
def test_the_toolkits_sensors_as_somebody_elses_give_the_same_record(noise: bool) -> None:
    ours = flown(noise=noise)
    study = replace(ours, sensors=Bursts(share=0.0, specs=ours.specs))
    assert list(same(study.run(), ours.run())) == []


@long_without_compiler
def test_a_plant_of_ones_own_is_struck_by_the_faults_that_it_says_it_suffers() -> None:
    ours = flown(faults=("thruster3:dead@1",))
    record = replace(ours, plant=ExtraDrag()).run()
    sound = replace(ours, faults=()).run()
    assert list(same(record, ours.run())) == []
    assert "thrust" in list(same(record, sound))


@pytest.mark.slow
@long_without_compiler
def test_a_pid_brings_the_vehicle_to_its_way_point() -> None:
    record = replace(flown(duration=30.0), controller=Pid()).run()
    assert [event.target for event in record.run_meta.events] == ["B"]
    np.testing.assert_array_equal(record["command"], 0.0)
    assert record["pull"].shape == (len(record), 3)


@pytest.mark.slow
@long_without_compiler
def test_drag_that_nobody_knows_of_costs_thrust_and_stops_the_mission_nowhere() -> None:
    ours = flown(duration=30.0)
    records = [scenario.run() for scenario in (ours, replace(ours, plant=ExtraDrag(rate=0.3)))]
    first, second = ([event.target for event in record.run_meta.events] for record in records)
    assert first == second == ["B", "C"]
    light, heavy = (np.square(record["thrust"]).sum() for record in records)
    assert heavy > 1.1 * light


@long_without_compiler
def test_a_plant_that_takes_velocities_gets_them_alone_and_lags_behind() -> None:
    record = replace(flown(), plant=DoubleIntegrator).run()
    assert "thrust" not in record.series
    lag = record["v"][1:] - record["v"][:-1]
    np.testing.assert_allclose(lag, 0.1 * (record["command"] - record["v"])[:-1], atol=1e-12)


@long_without_compiler
def test_a_complementary_filter_flies_the_mission() -> None:
    record = replace(flown(noise=True, duration=30.0), estimator=ComplementaryFilter).run()
    assert [event.target for event in record.run_meta.events] == ["B", "C"]
    missed = np.linalg.norm((record["q"] - record["q_estimated"])[:, :3], axis=1)
    assert 1e-3 < missed.max() < 0.05


@long_without_compiler
def test_sensors_of_ones_own_are_judged_by_the_monitor() -> None:
    scenario = flown(noise=True)
    record = replace(scenario, sensors=Bursts(share=0.9, specs=scenario.specs)).run()
    assert any(
        alarm.text.startswith("linear_velocity suspect: silent") for alarm in record.run_meta.alarms
    )


@pytest.mark.slow
@long_without_compiler
def test_runs_with_parts_of_ones_own_are_the_same_again_for_the_same_seed_alone() -> None:
    scenario = all_own()
    first = scenario.run()
    again = scenario.run()
    reseeded = replace(scenario, seed=1).run()
    assert list(same(first, again)) == []
    assert {"q", "q_estimated"} <= set(same(first, reseeded))


def ran(scenario: Scenario) -> np.ndarray:
    return scenario.run()["q"]


@pytest.mark.slow
@long_without_compiler
def test_parts_of_ones_own_go_to_another_process_with_their_scenario() -> None:
    scenario = all_own()
    expected = scenario.run()["q"]
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(scenario)).run()["q"], expected)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as workers:
        np.testing.assert_array_equal(workers.submit(ran, scenario).result(), expected)


@pytest.mark.slow
@long_without_compiler
def test_records_and_reports_name_the_parts() -> None:
    ours = flown(duration=0.1)
    study = replace(all_own(), duration=0.1)
    names = ("plant", "sensors", "estimator", "controller")
    assert [summarize(ours.run())[name] for name in names] == [
        "dynamic",
        "SensorSuite",
        "PassThrough",
        "DynamicController",
    ]
    assert [summarize(study.run())[name] for name in names] == [
        "ExtraDrag",
        "Bursts",
        "ComplementaryFilter",
        "Pid",
    ]
    assert replace(ours, controller=partial(our_controller, guide=None)).own_parts == {
        "controller": "our_controller"
    }


@pytest.mark.slow
@long_without_compiler
def test_figures_scene_and_file_of_a_run_without_any_part_of_the_toolkit(tmp_path: Path) -> None:
    record = all_own().run()
    record.save(tmp_path / "record.npz")
    again = Record.load(tmp_path / "record.npz")
    assert again.meta == record.meta
    np.testing.assert_array_equal(again["lost_speed"], record["lost_speed"])
    assert "efforts.png" in {path.name for path in write_figures(again, tmp_path)}
    assert write_scene(again, all_own().robot, tmp_path / "scene.html").stat().st_size > 0


def test_pre_flight_says_of_every_part_what_it_cannot_tell() -> None:
    findings = all_own().check().of_check("parts")
    assert [finding.text.split(" is your own")[0] for finding in findings] == [
        *("plant ExtraDrag", "sensors Bursts", "estimator ComplementaryFilter", "controller Pid")
    ]
    assert "cannot be exported" in findings[-1].text
    assert flown().check().of_check("parts") == ()


def a_slowed_mission() -> Scenario:
    return replace(flown(duration=0.5), plant=ExtraDrag(rate=0.1))


@pytest.mark.slow
def test_campaigns_vary_the_numbers_of_parts_of_ones_own() -> None:
    drag = Variation("parts.plant.rate", Uniform(1.0, 2.0))
    design = Design(sampler="random", runs=2, parameters=1, seed=3)
    work = MissionJob(
        scenario=a_slowed_mission, variations=[drag], names=(drag.name,), design=design
    )
    sent = pickle.loads(pickle.dumps(work))
    for run in range(2):
        plant = sent.scenario_of(run).plant
        assert isinstance(plant, ExtraDrag)
        assert plant.rate == work.make(run).row["parts.plant.rate"]
        assert 1.0 < plant.rate < 2.0
    assert sent.make(1).row == work.make(1).row
    assert not [name for name in available_parameters(flown()) if name.startswith("parts.")]


class Doubtful(CopiedFilter):
    """Writes down how it is told that nothing measures velocities."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        self.told: list[bool] = []
        self.inflate_velocity_variance = lambda *, rests=False: self.told.append(rests)


def test_an_estimator_of_ones_own_hears_from_the_monitor_whether_the_vehicle_rests() -> None:
    scenario = flown(noise=True)
    theirs = Doubtful(scenario)
    watched = watched_estimator(theirs, scenario.robot, "Doubtful")
    assert isinstance(watched, WatchedGates)
    watched.inflate_velocity_variance()
    watched.inflate_velocity_variance(rests=True)
    watched.inflate_velocity_variance(rests=False)
    assert theirs.told == [False, True, False]
