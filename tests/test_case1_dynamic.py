"""Case 1 on the physical plant: still water, noise, current, too few thrusters, a payload nobody
told of.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from compiler import long_without_compiler

from uvms_ocp.control.force.dynamic import VelocityGains
from uvms_ocp.record.record import Record
from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.description import TrimBody
from uvms_ocp.scenario.cases.bluerov import reach
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.scenario import Scenario

CASES: dict[str, tuple[dict[str, Any], float, float]] = {
    "still water": ({}, 2e-3, 5e-3),
    "noise": ({"noise": True, "seed": 1}, 1e-2, 2e-2),
    "current": ({"current": (0.3, 0.0, 0.0)}, 2e-3, 5e-3),
    "cross current without observer": ({"current": (0.0, 0.3, 0.0), "observer": False}, 2e-3, 5e-3),
    "under-actuated": ({"robot": "girona_maris7"}, 2e-3, 5e-3),
    "payload": (
        {
            "payload": TrimBody(
                name="sample", link="tool", position=(0, 0, 0), mass=1.5, volume=5e-4
            )
        },
        2e-3,
        5e-3,
    ),
}
"""Options, and the largest true error of the tool in m and rad."""
SHORT = ("still water", "noise")  # runs without a compiler too


@dataclass(frozen=True)
class Run:
    scenario: Scenario
    record: Record
    report: dict[str, Any]
    position: float
    orientation: float


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(name, marks=() if name in SHORT else long_without_compiler) for name in CASES
    ],
)
def run(request: pytest.FixtureRequest) -> Run:
    options, position, orientation = CASES[request.param]
    scenario = case1(**options)
    record = scenario.run()
    return Run(scenario, record, summarize(record), position, orientation)


@pytest.mark.slow
def test_the_mission_completes_with_the_tool_at_the_target(run: Run) -> None:
    assert run.report["completed"], run.report["pending"]
    assert run.report["tool_position_error_m"] < run.position
    assert run.report["tool_orientation_error_rad"] < run.orientation


@pytest.mark.slow
def test_limits_hold_on_the_physical_plant(run: Run) -> None:
    limits = run.scenario.robot.limits
    joints = run.record["q"][:, 7:]
    assert (joints > limits.position_lower).all()
    assert (joints < limits.position_upper).all()
    assert np.abs(run.record["thrust"]).max() <= 150.0
    assert (np.abs(run.record["torque"]) <= limits.effort).all()
    assert run.report["max_velocity_step"] <= 0.011


@pytest.mark.sampled
def test_every_phase_reports_what_it_cost(run: Run) -> None:
    for phase in run.report["phases"]:
        assert phase["energy_j"] == pytest.approx(
            phase["thruster_energy_j"] + phase["joint_energy_j"]
        )
        assert phase["energy_j"] > 0
        assert 0 < phase["peak_thrust_n"] <= 150.0
        assert phase["saturation_time_s"] <= phase["duration_s"]
    total = run.record["thruster_energy"][-1].sum() + run.record["joint_energy"][-1]
    assert sum(phase["energy_j"] for phase in run.report["phases"]) == pytest.approx(
        total, rel=1e-6
    )


def test_the_observer_finds_the_drag_of_the_current() -> None:
    record = case1(current=(0.3, 0.0, 0.0), duration=8.0).run()
    still = case1(duration=8.0).run()
    pushed = record["disturbance"][-1, :3] - still["disturbance"][-1, :3]
    assert np.linalg.norm(pushed) > 5.0


@pytest.mark.slow
def test_the_observer_does_the_work_of_an_integral() -> None:
    """Without integral action a current leaves a velocity error; the observer takes most of it
    away.
    """
    errors = {}
    for bandwidth in (0.0, 3.0):
        scenario = case1(current=(0.0, 0.3, 0.0), duration=10.0)
        gains = VelocityGains(vehicle_reset=0.0, observer_vehicle=bandwidth)
        record = dataclasses.replace(scenario, gains=gains).run()
        settled = record["t"] > 5.0
        errors[bandwidth] = np.abs(record["v"] - record["command"])[settled, :3].max()
    assert errors[3.0] < 0.3 * errors[0.0]


def test_controllers_see_the_measurement_and_not_the_truth() -> None:
    record = case1(noise=True, duration=1.0).run()
    assert (record["q"] != record["q_estimated"]).any()


@pytest.mark.sampled
@pytest.mark.parametrize("seed", [0, 1])
def test_the_small_vehicle_reaches_with_noise_and_other_drag(seed: int) -> None:
    report = summarize(reach(seed=seed, variant="wu", noise=True).run())
    assert report["completed"], report["pending"]
    assert report["tool_position_error_m"] < 0.02
