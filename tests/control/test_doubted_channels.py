"""Whatever becomes of a channel, at any rate of ticks, no change of trust kicks vehicle or arm that
works at the floor.
"""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np
import pytest
from compiler import long_without_compiler

from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.sim.faults import parse_fault

# [s]: the arm reaches for its goal, and the channel is good again
ONSET = 40.0
UNTIL = 43.0
END = 46.0
SIZES = {  # of spikes [unit of the channel], bias [the same], delay [s]
    "position": (50.0, "5,0,0", 1.5),
    "depth": (50.0, "2", 0.5),
    "attitude": (1.0, "0,0,0.2", 0.2),
    "angular_velocity": (2.0, "0,0,0.1", 0.05),
    "linear_velocity": (5.0, "0.3,0,0", 0.3),
    "joint_positions": (1.0, "0.05", 0.05),
    "altimeter_range": (20.0, "0.5", 0.2),
}
DEFECTS = ("frozen", "lost", "nan", "spikes={},0.1", "bias={}", "late={}", "ahead=5")
QUICK = {("linear_velocity", "bias={}", 20), ("joint_positions", "lost", 20)}


def runs() -> list[object]:
    """Channels by defects by rates [Hz]; most are slow."""
    runs = list[object]()
    for case in product(SIZES, DEFECTS, (20, 50)):
        marks = () if case in QUICK else pytest.mark.slow
        runs.append(pytest.param(*case, marks=marks))
    return runs


@cache
def flown(rate: int, fault: str = "") -> tuple[np.ndarray, np.ndarray, float]:
    """After the onset: true velocities as shares of their limits, errors of the linear one [m/s],
    and the largest change.

    That is of the acceleration of a joint that the commanded force makes, in a tick, as a share of
    the limit.
    """
    faults = (parse_fault(fault),) if fault else ()
    scenario = case1(noise=True, dt=1 / rate, duration=END, faults=faults)
    record = scenario.run()
    robot = scenario.robot
    mass_matrix = robot_dynamics(robot).mass_matrix
    joints = robot.joint_v
    requested = np.column_stack([record["wrench"], record["torque"]])
    largest = 0.0
    first = int(np.searchsorted(record["t"], ONSET)) if fault else rate
    for k in range(first, len(requested)):
        change = np.linalg.solve(mass_matrix(record["q"][k]), requested[k] - requested[k - 1])
        largest = max(largest, float(np.abs(change / robot.limits.acceleration)[joints].max()))
    shares = np.abs(record["v"][first:]) / robot.limits.velocity
    return shares, np.abs(record["v_estimated"] - record["v"])[first:, :3], largest


@pytest.mark.slow
@long_without_compiler
@pytest.mark.parametrize(("channel", "defect", "rate"), runs())
def test_no_change_of_trust_kicks(channel: str, defect: str, rate: int) -> None:
    """A DVL with a bias was doubted late: the vehicle went 1.5 times, a joint 1.7 times as fast as
    it may.
    """
    sizes = dict(zip(("spikes={},0.1", "bias={}", "late={}"), SIZES[channel], strict=True))
    size = sizes.get(defect, "")
    shares, errors, change = flown(rate, f"{channel}:{defect.format(size)}@{ONSET:g}-{UNTIL:g}")
    assert shares[:, :6].max() <= 1.0
    assert shares[:, 6:].max() <= 1.2
    assert errors.max() <= 1.2
    assert change <= 1.5 * flown(rate)[2]


ACTUATORS = {  # faults, and what is named
    "thruster3:reversed": "thruster3 reversed",
    "thruster5:reversed": "thruster5 reversed",
    "joint2:jam": "joint2 jammed",
    "thruster3:reversed joint_positions:late=0.05": "thruster3 reversed",
    "attitude:lost angular_velocity:lost": "attitude lost",
}


def struck_runs() -> list[object]:
    """What strikes actuators, alone and with a channel, and blind vehicles, by rates [Hz]."""
    runs = list[object]()
    for faults, rate in product(ACTUATORS, (20, 50, 200)):
        marks = () if rate == 20 else pytest.mark.slow
        runs.append(pytest.param(faults, rate, marks=marks))
    return runs


@pytest.mark.slow
@long_without_compiler
@pytest.mark.parametrize(("faults", "rate"), struck_runs())
def test_no_verdict_and_no_mode_kicks_the_arm_and_faults_are_found_at_every_rate(
    faults: str, rate: int
) -> None:
    """At 20 Hz nobody looked at the thrusters, and a reversed one drove the arm at 17 times its
    limit.
    """
    struck = tuple(parse_fault(f"{fault}@28.6") for fault in faults.split())
    # Brakes that weigh a load are locked for 2 s, in which a joint that jams is not looked for.
    scenario = case1(noise=True, dt=1 / rate, duration=43.5, faults=struck)
    record = scenario.run()
    robot = scenario.robot
    assert any(ACTUATORS[faults] in alarm.text for alarm in record.run_meta.alarms)
    assert (np.abs(record["v"]) / robot.limits.velocity).max() <= 1.2
