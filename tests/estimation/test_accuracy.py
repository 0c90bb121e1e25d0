"""What the sensors allow: the spread that is promised is the spread that the estimator has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.estimation.estimator import Estimator, std_at_rest
from uvms_ocp.mission.phase import Below
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import CHANNELS, Reading, Readings, SensorSpec, SensorSpecs, State
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.preflight.checks import quantity_stds
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.sim.sensors import SensorSuite

SPECS = SensorSpecs()


def test_the_estimate_of_a_robot_at_rest_spreads_as_promised() -> None:
    robot = load_robot("girona_maris7")
    q = robot.configuration(position=(0.0, 0.0, -5.0))
    dt = 0.01
    state = State(q=q, v=np.zeros(robot.n_v))
    estimator = Estimator(robot, SPECS)
    sensors = SensorSuite(robot, FlatSeafloor(z=-20.0), SPECS, seed=5)
    errors = []
    for k in range(7000):
        measured = estimator(sensors.read(state, k * dt), k * dt).q
        if k * dt > 10.0:
            error = pin.difference(robot.model, q, measured)
            errors.append(np.concatenate([measured[:3] - q[:3], error[3:]]))
    share = np.sqrt(np.mean(np.square(errors), axis=0)) / std_at_rest(robot, SPECS)
    # The filter expects more motion than there is at rest, so that it knows a little more than it
    # says.
    assert share.max() < 1.5
    assert share.min() > 0.25


def test_between_readings_the_spread_grows_with_what_may_have_happened_since() -> None:
    """Of a position fix a second: nothing else tells where the vehicle is."""
    robot = load_robot("girona_maris7")
    estimator = Estimator(robot, SPECS)
    spreads = []
    for k in range(3000):
        fix = k // 100
        dt = 0.01
        readings = Readings(position=Reading(value=np.zeros(3), t=float(fix)))
        estimator(readings, k * dt)
        spreads.append(estimator.std[0])
    last = np.array(spreads[-100:])
    assert (np.diff(last) > 0.0).all()
    assert last[-1] > 5.0 * last[0]


@pytest.mark.sampled
@pytest.mark.parametrize("name", ["girona_maris7", "planar5"])
def test_better_sensors_allow_more(name: str) -> None:
    robot = load_robot(name)
    noisy = std_at_rest(robot, SPECS)
    fields = {item: getattr(SPECS, item) for item in CHANNELS if getattr(SPECS, item) is not None}
    better = SensorSpecs(
        **{item: replace(spec, sigma=spec.sigma / 4) for item, spec in fields.items()}
    )
    assert (std_at_rest(robot, better) < 0.7 * noisy).all()
    biased = replace(SPECS, joint_positions=replace(SPECS.joint_positions, bias=0.01))
    np.testing.assert_allclose(std_at_rest(robot, biased)[-1], np.hypot(noisy[-1], 0.01))
    silent = replace(SPECS, joint_positions=SensorSpec(rate=200.0, sigma=1e-4, dropout=1.0))
    assert std_at_rest(robot, silent)[-1] > 1.0


def with_limit(scenario: Scenario, limit: float) -> Scenario:
    """The tool's position must come nearer than that."""
    phases = [
        replace(
            phase,
            transitions=tuple(
                replace(
                    transition,
                    when=tuple(
                        Below(quantity=c.quantity, limit=limit)
                        if c.quantity == "T.position_error"
                        else c
                        for c in transition.when
                    ),
                )
                for transition in phase.transitions
            ),
        )
        for phase in scenario.mission.phases
    ]
    return replace(scenario, mission=replace(scenario.mission, phases=tuple(phases)))


@pytest.mark.sampled
@pytest.mark.parametrize("noise", [True, False])
def test_a_threshold_below_what_the_sensors_allow_is_a_warning(noise: bool) -> None:
    scenario = case1(noise=noise, plant="kinematic")
    allowed = quantity_stds(scenario.setup(), scenario.start).get("T.position_error", 0.0)
    assert (allowed > 1e-3) == noise
    for limit in (1e-3, 0.99 * allowed, 1.01 * allowed):
        findings = with_limit(scenario, max(limit, 1e-6)).check().of_check("accuracy")
        assert [f.phase for f in findings] == (["D"] if noise and limit < allowed else [])
        assert all("T.position_error" in f.text for f in findings)


def test_it_is_computed_once_for_a_robot_and_its_sensors() -> None:
    robot = load_robot("bluerov2_alpha5")
    first = std_at_rest(robot, SensorSpecs())
    assert std_at_rest(robot, SensorSpecs()) is first
    assert std_at_rest(robot, replace(SensorSpecs(), position=SensorSpec(sigma=0.1))) is not first
    assert not first.flags.writeable
