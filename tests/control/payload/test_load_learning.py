"""What the tool carries, learnt in simulation and set beside the truth of the plant."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from actuators.hovering import DT, Hover, run
from compiler import long_without_compiler

from uvms_ocp import load_robot, without_arm
from uvms_ocp.control.force.dynamic import DynamicController
from uvms_ocp.control.load_filter import LoadLearning
from uvms_ocp.control.payload import LoadEstimate
from uvms_ocp.errors import InvalidInput, UvmsError
from uvms_ocp.export import export_controller
from uvms_ocp.record.record import Record
from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.description import TrimBody
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.robot import Robot
from uvms_ocp.scenario.cases.bluerov import reach
from uvms_ocp.scenario.preflight.findings import Severity
from uvms_ocp.scenario.preflight.forces import check_load
from uvms_ocp.scenario.scenario import Scenario

ROBOTS = ("girona_maris7_full", "bluerov2_alpha5")
CALM = Hover(load=LoadLearning(), duration=46.0, stays=30.0, noise=False, current=0.0, gusts=0.0)
ROUGH = replace(CALM, noise=True, current=0.3, gusts=0.03, seed=1)
TWO_KG = {"load": 2.0 * 9.81, "float": (2.0 - 1.2 * 0.998) * 9.81}
"""[N] net weight of two kilograms, and of those with 1.2 l."""
PAYLOADS = {"load": (2.0, 0.0), "float": (2.0, 1.2e-3), "none": (0.0, 0.0)}

pytestmark = long_without_compiler


@lru_cache
def learnt(robot: str, payload: str, *, rough: bool) -> list[LoadEstimate]:
    """At each tick: at rest for 30 s, then on the move."""
    return run(replace(ROUGH if rough else CALM, robot=robot, payload=PAYLOADS[payload])).learnt


def at(estimates: list[LoadEstimate], t: float) -> LoadEstimate:
    return estimates[round(t / DT)]


@pytest.mark.slow
@pytest.mark.parametrize("rough", [False, True])
@pytest.mark.parametrize("payload", TWO_KG)
@pytest.mark.parametrize("robot", ROBOTS)
def test_after_30_s_the_net_weight_of_two_kilograms_is_known_within_a_tenth(
    robot: str, payload: str, rough: bool
) -> None:
    load = at(learnt(robot, payload, rough=rough), 30.0)
    true = TWO_KG[payload]
    assert abs(load.weight - true) < 0.1 * true
    assert abs(load.weight - true) < 2.0 * load.weight_error


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_a_mass_is_undetermined_until_the_robot_has_accelerated(robot: str) -> None:
    estimates = learnt(robot, "float", rough=False)
    still = at(estimates, 30.0)
    moved = estimates[-1]
    assert isnan(still.mass)
    assert abs(moved.mass - 2.0) < 2.0 * moved.mass_error < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_with_noise_in_a_gusty_current_the_mass_is_within_its_interval_once_it_is_determined(
    robot: str,
) -> None:
    estimates = [
        load for load in learnt(robot, "load", rough=True)[:: round(1 / DT)] if not isnan(load.mass)
    ]
    assert estimates
    assert all(abs(load.mass - 2.0) < 2.0 * load.mass_error for load in estimates)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_without_a_payload_nothing_is_learnt_beyond_its_interval(robot: str) -> None:
    for load in learnt(robot, "none", rough=True)[:: round(1 / DT)]:
        assert abs(load.weight) < 2.0 * load.weight_error
        assert isnan(load.mass) or abs(load.mass) < 2.0 * load.mass_error


@pytest.fixture(scope="module")
def runs() -> dict[str, Record]:
    """Of one mission with two kilograms, by what is made of the load."""
    kinds = {"none": None, "learnt": LoadLearning(feed_forward=False), "carried": LoadLearning()}
    plain = reach(
        payload=TrimBody(name="load", link="tool", position=(0.0, 0.0, 0.0), mass=2.0, volume=0.0)
    )
    return {name: replace(plain, load=load).run() for name, load in kinds.items()}


@pytest.mark.slow
def test_learning_alone_changes_nothing_of_the_run(runs: dict[str, Record]) -> None:
    for name in ("q", "thrust", "torque", "disturbance"):
        np.testing.assert_array_equal(runs["learnt"][name], runs["none"][name])


def test_a_weight_that_follows_the_arm_disturbs_the_vehicle_less(runs: dict[str, Record]) -> None:
    errors = {}
    for name, record in runs.items():
        learnt_already = record["t"] > 5.0
        errors[name] = np.abs(record["v"] - record["command"])[learnt_already, 3:6].mean()
    assert errors["carried"] < 0.6 * errors["none"]


def test_the_record_has_the_load_and_the_report_tells_it(runs: dict[str, Record]) -> None:
    record = runs["carried"]
    report = summarize(runs["carried"])
    for name in ("weight", "weight_error", "mass", "mass_error"):
        assert record[f"load_{name}"].shape == record["t"].shape
    assert report["load"]["weight_n"] == pytest.approx(2.0 * 9.81, rel=0.1)
    assert report["load"]["weight_error_n"] == record["load_weight_error"][-1]
    assert summarize(runs["none"])["load"] is None


@pytest.mark.slow
def test_two_tools_have_a_load_each() -> None:
    learnt_load = reach(
        robot="bluerov2_two_alpha5", learn_load=True, faults=("payload2:mass=1@0",), duration=5.0
    ).run()
    report = summarize(learnt_load)
    assert learnt_load["load_weight"].shape == (len(learnt_load), 2)
    assert (
        learnt_load.to_dataframe()
        .columns.isin(["load_weight.port_tool", "load_weight.starboard_tool"])
        .sum()
        == 2
    )
    assert [*report["loads"]] == ["port_tool", "starboard_tool"]
    assert report["load"] == report["loads"]["port_tool"]
    for tool, weight in (("port_tool", 0.0), ("starboard_tool", 9.81)):
        load = report["loads"][tool]
        assert abs(load["weight_n"] - weight) < 2.0 * load["weight_error_n"] < 6.0


def test_pre_flight_says_what_is_learnt_and_where_nothing_can_be() -> None:
    def said(**options: object) -> list[str]:
        return [
            item.text
            for item in reach(learn_load=True, **options).check().findings
            if item.check == "load"
        ]

    assert "is learnt" in said()[0]
    assert "use the dynamic plant" in said(plant="kinematic")[0]
    assert "observer" in said(observer=False)[0]
    assert not reach(learn_load=True, observer=False).check().accepted


UNLIMITED = replace(load_robot("girona_maris7_full").limits, effort=np.full(7, np.inf))
LEARNERS = {
    "sound": {},
    "no thrust sideways": {"robot": "girona_maris7"},
    "no observer": {"observer": False},
    "no limits of effort": {"robot": replace(load_robot("girona_maris7_full"), limits=UNLIMITED)},
    "no tool": {"robot": without_arm(load_robot("girona_maris7_full"))},
}


@pytest.mark.sampled
@pytest.mark.parametrize("options", LEARNERS.values(), ids=LEARNERS)
def test_pre_flight_and_controller_agree_on_who_can_learn_a_load(options: dict[str, Any]) -> None:
    robot = options.get("robot", "bluerov2_alpha5")
    if isinstance(robot, str):
        robot = load_robot(robot)
    # A mission of a robot with a tool: where there is none, only who learns is another.
    who_reaches = robot if robot.tools else load_robot("bluerov2_alpha5")
    scenario = reach(robot=who_reaches, learn_load=True, observer=options.get("observer", True))
    setup = replace(scenario.setup(), robot=robot, start=np.array(robot.configuration()))
    (finding,) = check_load(setup)
    refusal = refused(robot, scenario)
    assert (finding.severity is Severity.ERROR) == bool(refusal)
    assert refusal in ("", finding.text)


def refused(robot: Robot, scenario: Scenario) -> str:
    """By our controller of this robot, if it is, and with which words."""
    options: dict[str, Any] = {"gains": scenario.gains, "load": scenario.load}
    try:
        DynamicController(
            robot=robot,
            dynamics=robot_dynamics(robot),
            kinematic=scenario.kinematic_controller(),
            **options,
        )
    except UvmsError as error:
        return str(error)
    return ""


def test_a_controller_that_learns_a_load_has_no_form_in_c(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="no form in C: load LoadLearning"):
        export_controller(reach(learn_load=True, duration=0.1), tmp_path / "controller")


def test_a_measurement_that_is_no_number_is_forgotten() -> None:
    controller = reach(learn_load=True).controller()
    robot = controller.kinematic.robot
    learner = controller.learner
    q = np.array(robot.configuration())
    v = np.zeros(robot.n_v)
    estimate = np.zeros(robot.n_v)
    share = np.ones(robot.n_v)
    nothing = np.full(robot.n_v, np.nan)
    spoilt = 301
    for k in range(800):
        learner.carry(q, nothing if k == spoilt else v, estimate)
        if k != spoilt:  # where no force was possible
            learner.learn(q, v, estimate, share, True)
    assert np.isfinite(estimate).all()
    assert np.isfinite(learner.filter.x).all()
    assert learner.loads[0].weight_error < 2.0


def test_what_cannot_be_learnt_is_refused() -> None:
    with pytest.raises(InvalidInput, match="disturbance observer"):
        reach(learn_load=True, observer=False).controller()
