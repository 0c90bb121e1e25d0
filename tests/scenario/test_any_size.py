"""A toy of ten grams and a machine of ten tonnes are judged and flown as the robot that they are models of:
no tolerance of pre-flight or control is a number of newtons or metres for robots of one size.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from compiler import long_without_compiler
from scaled_robots import reach_at, scaled_files, scaled_reach, scaled_robot
from studies.drawn_robots import drawn_body, write_robot

from uvms_ocp.control.payload import heaviest_load
from uvms_ocp.mission_plan import Margins
from uvms_ocp.robot import list_robots, load_robot
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.size import size
from uvms_ocp.scenario.preflight.robot_check import check_robot
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.nearest_passage import closest_approach
from uvms_ocp.sim.seafloor import FlatSeafloor

MASSES = {"toy": 0.01, "machine": 1e4}
"""[kg]"""
LENGTHS = (0.2, 5.0)
DRAWN = (912, 1404)
"""Seeds of drawn robots with an arm."""
FLOWN = ("bluerov2_alpha5", "girona_maris7_full")
SITUATIONS: dict[str, dict[str, Any]] = {
    "still water": {},
    "a current": {"current": (0.15, 0.1, 0.03)},
    "too much of a current": {"current": (2.0, 0.0, 0.0)},
    "a little heavy": {"ballast": 1e-3},
    "heavy": {"ballast": 0.02},
}


def _mass(robot: Robot) -> float:
    return sum(float(inertia.mass) for inertia in robot.model.inertias)


def length_of(name: str, mass: float) -> float:
    """Times that a robot of this mass [kg] is as long as the shipped one."""
    return math.cbrt(mass / _mass(load_robot(name)))


def judgement(scenario: Scenario) -> list[tuple[str, str, str]]:
    return [
        (finding.severity.name, finding.check, finding.phase)
        for finding in scenario.check().findings
    ]


@pytest.mark.sampled
@pytest.mark.parametrize("mass", MASSES.values(), ids=MASSES)
@pytest.mark.parametrize("name", list_robots())
def test_forces_of_a_scaled_robot_are_those_of_the_robot(name: str, mass: float) -> None:
    length = length_of(name, mass)
    robot = load_robot(name)
    same = scaled_robot(name, length)
    rng = np.random.default_rng(2)
    v = rng.uniform(-0.3, 0.3, robot.n_v)
    a = rng.uniform(-0.3, 0.3, robot.n_v)
    q = np.array(robot.configuration())
    unit = np.ones(robot.n_v)  # of displacements
    unit[: 3 if robot.n_vehicle else 0] = length
    for joint in robot.joints:
        unit[joint.v] = length if joint.slides else 1.0
    tau = robot_dynamics(robot).inverse_dynamics(q, v, a)
    tau_same = robot_dynamics(same).inverse_dynamics(
        q, v * unit / math.sqrt(length), a * unit / length
    )
    np.testing.assert_allclose(tau_same * unit / length**4, tau, atol=1e-8 * np.abs(tau).max())


@pytest.mark.parametrize("mass", MASSES.values(), ids=MASSES)
@pytest.mark.parametrize("name", list_robots())
def test_a_scaled_robot_is_found_as_good_as_the_robot(name: str, mass: float) -> None:
    """A tonne out of trim by 0.5 N was warned of, and ten grams, that weigh 0.1 N, never."""
    reports = [
        check_robot(robot)
        for robot in (load_robot(name), scaled_robot(name, length_of(name, mass)))
    ]
    as_is, scaled = (
        [(finding.verdict, finding.subject) for finding in report.findings] for report in reports
    )
    assert scaled == as_is


@pytest.mark.sampled
@long_without_compiler
@pytest.mark.parametrize("mass", MASSES.values(), ids=MASSES)
@pytest.mark.parametrize("situation", SITUATIONS)
@pytest.mark.parametrize("name", [*FLOWN, "torpedo_auv", "bluerov2_six_alpha5"])
def test_pre_flight_judges_a_scaled_mission_as_the_mission(
    name: str, situation: str, mass: float
) -> None:
    """A vehicle without thrust in heave was refused for 0.5 N, 500 times a toy's weight or 5 parts
    in a million of a machine's.
    """
    as_is, scaled = (
        scaled_reach(name, length, **SITUATIONS[situation])
        for length in (1.0, length_of(name, mass))
    )
    assert judgement(scaled) == judgement(as_is)


@long_without_compiler
@pytest.mark.slow
@pytest.mark.parametrize("mass", MASSES.values(), ids=MASSES)
@pytest.mark.parametrize("situation", ["still water", "a current"])
@pytest.mark.parametrize("name", FLOWN)
def test_a_scaled_mission_is_flown_as_the_mission(name: str, situation: str, mass: float) -> None:
    """A toy swung by 0.2 rad for ever: its accelerations rose as slowly as those of a vehicle."""
    durations = []
    for length in (1.0, length_of(name, mass)):
        scenario = scaled_reach(name, length, **SITUATIONS[situation])
        record = scenario.run()
        limit = scenario.robot.limits.velocity[6:]
        assert record.run_meta.completed
        assert (np.abs(record["v"][:, 6:]) <= limit).all()
        durations.append(record["t"][-1] / math.sqrt(length))
    as_is, scaled = durations
    assert scaled == pytest.approx(as_is, rel=0.02)


@pytest.mark.parametrize("mass", MASSES.values(), ids=MASSES)
@pytest.mark.parametrize("name", list_robots())
def test_what_is_not_stated_is_of_the_size_of_the_robot(name: str, mass: float) -> None:
    """A toy of ten grams was taken to carry 200 N, and planned with 3 cm between links of 1 cm."""
    length = length_of(name, mass)
    robot = load_robot(name)
    same = scaled_robot(name, length)
    assert heaviest_load(same) == pytest.approx(length**3 * heaviest_load(robot))
    margins = Margins().of(same)
    shares = {"position": (0.08, 0.02), "altitude": (0.04, 0.01), "links": (0.12, 0.03)}
    for lengthy, (share, largest) in shares.items():
        expected = min(share * size(same.model), largest)
        assert getattr(margins, lengthy) == pytest.approx(expected), lengthy
    given = Margins(position=0.5, altitude=0.0, links=0.7).of(same)
    assert (given.position, given.altitude, given.links) == (0.5, 0.0, 0.7)


@long_without_compiler
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "length"), [(name, LENGTHS[0]) for name in FLOWN] + [(FLOWN[1], LENGTHS[1])]
)
def test_a_scaled_mission_is_given_up_as_the_mission(name: str, length: float) -> None:
    """By up to a quarter later: what a lock of brakes lasts is of no size. A light vehicle at five times
    its size is left out: it tumbles in 4.5 m/s, where fixes, depths and the DVL are of other times.
    """
    current = SITUATIONS["too much of a current"]["current"]
    ended = []
    for sized in (1.0, length):
        events = scaled_reach(name, sized, current=current).run().run_meta.events
        reasons = [(event.source, event.target, event.reason.partition(":")[0]) for event in events]
        ended.append((reasons, [event.t / math.sqrt(sized) for event in events]))
    (as_is, times), (scaled, scaled_times) = ended
    assert scaled == as_is
    assert as_is[0][1] == "climb"
    assert scaled_times == pytest.approx(times, rel=0.3)


@long_without_compiler
@pytest.mark.slow
@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("seed", DRAWN)
def test_a_drawn_robot_is_judged_and_flown_at_any_size(
    seed: int, length: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UVMS_OCP_CFLAGS", "-O0")  # what is compiled runs once
    rng = np.random.default_rng(seed)
    write_robot(drawn_body(rng), rng, tmp_path)
    judged = []
    durations = []
    for sized in (1.0, length):
        scenario = reach_at(scaled_files(tmp_path, sized), sized)
        judged.append(judgement(scenario))
        record = scenario.run()
        assert record.run_meta.completed
        durations.append(record["t"][-1] / math.sqrt(sized))
    assert judged[1] == judged[0]
    assert durations[1] == pytest.approx(durations[0], rel=0.02)


def test_the_floor_is_seen_below_all_of_a_large_robot() -> None:
    """It ended 4 m from the vehicle's origin: of what lay beyond, its edge was the nearest."""
    distances = []
    for length in (1.0, 10.0):
        robot = scaled_robot("girona_maris7", length)
        q = robot.configuration(
            position=(0.0, 0.0, 2.0 * length),
            quaternion=pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.4, 0.0)).coeffs(),
        )
        environment = Environment(seafloor=FlatSeafloor(z=0.0))
        distances.append(closest_approach(robot, environment, q[None]).distance)
    assert distances[1] == pytest.approx(10.0 * distances[0], rel=1e-6)


def test_of_no_configurations_nothing_is_near() -> None:
    robot = load_robot("bluerov2")
    environment = Environment(seafloor=FlatSeafloor(z=0.0))
    assert closest_approach(robot, environment, np.zeros((0, robot.n_q))).distance == np.inf
