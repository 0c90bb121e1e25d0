"""A made-up sensor, the range to a beacon, is one row and one function: sensors sample it, the filter
fuses it, health judges it, faults act on it, and records have it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from compiler import needs_compiler

import uvms_ocp as uo
from uvms_ocp.campaign.sensor_parameters import sensor_parameters
from uvms_ocp.codegen.kernel_layout import view
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation import Estimator
from uvms_ocp.estimation.filter_memory import MAIN, N_CHANNELS, Part
from uvms_ocp.estimation.vehicle_model import predict_measurement, turn_by
from uvms_ocp.robot import (
    IDEAL_SENSORS,
    Channel,
    Readings,
    Robot,
    SensorSpec,
    SensorSpecs,
    State,
)
from uvms_ocp.robot.measurement import MeasuredState
from uvms_ocp.scenario import estimate_recording, reach
from uvms_ocp.sim import SensorSuite
from uvms_ocp.sim.faults import FAMILIES, parse_faults

BEACON = np.array([8.0, -4.0, -8.0])
DT = 0.05


def range_to_beacon(state: MeasuredState) -> ca.SX:
    _, position = state.pose("base_link")
    return ca.norm_2(position - ca.DM(BEACON))


def bearing_of_tool(state: MeasuredState) -> ca.SX:
    """Direction of the beacon seen from the tool, and how fast the tool rises."""
    rotation, position = state.pose("tool")
    away = rotation.T @ (ca.DM(BEACON) - position)
    return ca.vertcat(ca.atan2(away[1], away[0]), state.velocity("tool")[2])


RANGE = Channel(
    name="beacon_range",
    unit="m",
    sensor=SensorSpec(rate=5.0, sigma=0.02),
    measure=range_to_beacon,
)
BEARING = Channel(
    name="beacon_bearing",
    unit="rad, m/s",
    size=2,
    sensor=SensorSpec(rate=10.0, sigma=0.01),
    measure=bearing_of_tool,
)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return uo.load_robot("bluerov2_alpha5")


def true_range(q: np.ndarray) -> Any:
    return np.linalg.norm(q[..., :3] - BEACON, axis=-1)


def readings_at(robot: Robot, specs: SensorSpecs, n: int, *faults: str) -> list[Readings]:
    """Readings of a robot that moves along x at 0.2 m/s."""
    suite = SensorSuite(robot, uo.FlatSeafloor(z=-20.0), specs, faults=parse_faults(faults))
    v = np.zeros(robot.n_v)
    v[0] = 0.2
    readings = []
    for k in range(n):
        q = robot.configuration(position=(0.2 * k * DT, 0.0, -5.0))
        readings.append(suite.read(State(q=q, v=v), k * DT))
    return readings


def with_own(*own: Channel, **sensors: SensorSpec | None) -> SensorSpecs:
    return replace(SensorSpecs(), **sensors, own=own)


@pytest.mark.sampled
@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=needs_compiler)])
def test_what_it_reads_is_fused(robot: Robot, compiled: bool) -> None:
    """Rough fixes leave the place along the beam less known without it."""
    rough = {"position": SensorSpec(rate=5.0, sigma=0.5), "linear_velocity": None}
    stds = []
    for own in ((), (replace(RANGE, sensor=SensorSpec(rate=5.0, sigma=0.01)),)):
        specs = with_own(*own, **rough)
        estimator = Estimator(robot, specs, compiled=compiled)
        for k, readings in enumerate(readings_at(robot, specs, 40)):
            estimate = estimator(readings, k * DT)
        towards = (BEACON - estimate.q[:3]) / np.linalg.norm(BEACON - estimate.q[:3])
        covariance = estimator.covariance[Part.PLACE : Part.SPEED, Part.PLACE : Part.SPEED]
        stds.append(np.sqrt(towards @ covariance @ towards))
    assert stds[1] < 0.03 < 0.1 < stds[0]
    outcome = estimator.outcome("beacon_range")
    assert outcome is not None
    assert outcome.accepted
    assert outcome.degrees == 1


@needs_compiler
def test_numbers_are_the_same_without_a_compiler(robot: Robot) -> None:
    specs = with_own(replace(RANGE, sensor=SensorSpec(rate=5.0, sigma=0.02, delay=0.12)), BEARING)
    readings = readings_at(robot, specs, 30)
    both = []
    for compiled in (True, False):
        estimator = Estimator(robot, specs, compiled=compiled)
        both.append([estimator(reading, k * DT).q for k, reading in enumerate(readings)])
    np.testing.assert_array_equal(both[0], both[1])


def test_without_own_channels_nothing_changes(robot: Robot) -> None:
    """A channel that never reads leaves the estimate as it was, to the last bit."""
    silent = replace(RANGE, sensor=SensorSpec(rate=5.0, sigma=0.02, dropout=1.0))
    estimates = []
    for own in ((), (silent,)):
        specs = with_own(*own)
        estimator = Estimator(robot, specs, compiled=False)
        readings = readings_at(robot, specs, 20)
        estimates.append([estimator(reading, k * DT).q for k, reading in enumerate(readings)])
    np.testing.assert_array_equal(estimates[0], estimates[1])


@pytest.mark.parametrize("seed", range(3))
def test_its_slopes_and_its_rate_are_those_of_what_it_measures(robot: Robot, seed: int) -> None:
    memory = Estimator(robot, with_own(RANGE, BEARING), compiled=False).structure
    step = 1e-6

    def place() -> None:
        rng = np.random.default_rng(seed)
        turn = pin.rpy.rpyToMatrix(np.array([*rng.uniform(-0.6, 0.6, 2), rng.uniform(-3, 3)]))
        view(memory.turn)[:] = pin.Quaternion(turn).coeffs()
        view(memory.x)[:MAIN] = rng.normal(size=MAIN)
        view(memory.joint_x)[:] = rng.uniform(-0.5, 0.5, view(memory.joint_x).shape)

    for k, channel in enumerate((RANGE, BEARING)):
        n = channel.size

        def predicted(number: int = N_CHANNELS + k, n: int = n) -> np.ndarray:
            predict_measurement(memory, number, MAIN)
            return np.array(memory.predicted.h)[:n]

        place()
        predicted()
        slopes = np.array([list(row) for row in memory.predicted.H])[:n]
        rate = np.array(memory.predicted.rate)[:n]
        for i in range(MAIN):
            ends = []
            for sign in (-1.0, 1.0):
                place()
                if i < Part.PLACE:
                    by = [0.0, 0.0, 0.0]
                    by[i] = sign * step
                    turn_by(memory.turn, by)
                else:
                    memory.x[i] += sign * step
                ends.append(predicted())
            np.testing.assert_allclose(slopes[:, i], (ends[1] - ends[0]) / (2 * step), atol=1e-7)
        ends = []
        for h in (-step, step):
            place()
            x = view(memory.x)
            spin = x[Part.SPIN : Part.SPIN + 3].copy()
            x[Part.PLACE : Part.PLACE + 3] += h * x[Part.SPEED : Part.SPEED + 3]
            x[Part.SPEED : Part.SPEED + 3] += h * x[Part.ACCELERATION : Part.ACCELERATION + 3]
            x[Part.SPIN : Part.SPIN + 3] += h * x[Part.SPIN_UP : Part.SPIN_UP + 3]
            view(memory.joint_x)[:, 0] += h * view(memory.joint_x)[:, 1]
            turn_by(memory.turn, (h * spin).tolist())
            ends.append(predicted())
        np.testing.assert_allclose(rate, (ends[1] - ends[0]) / (2 * step), atol=1e-6)
    assert list(memory.orders)[N_CHANNELS:] == [2, 1]


def changed_by(robot: Robot, fault: str) -> tuple[list[Any], list[Any]]:
    """Ranges and their stamps at each tick, sound and with a fault from 0.5 s on."""
    exact = with_own(replace(RANGE, sensor=SensorSpec(rate=20.0)))
    both = []
    for faults in ((), (fault,)):
        told = [
            readings.own.get("beacon_range") for readings in readings_at(robot, exact, 40, *faults)
        ]
        both.append([(reading.value, reading.t) for reading in told if reading is not None])
    return both[0], both[1]


VALUES = {"spikes": "=3,0.5", "bias": "=1", "drift": "=0.5", "stuck": "=2", "late": "=0.3"}


@pytest.mark.parametrize("kind", FAMILIES["sensor"])
def test_every_kind_of_fault_of_sensors_acts_on_it(robot: Robot, kind: str) -> None:
    values = VALUES.get(kind, "=0.2" if kind == "ahead" else "")
    sound, faulty = changed_by(robot, f"own_beacon_range:{kind}{values}@0.5")
    assert sound[:9] == faulty[:9]
    assert sound != faulty


def test_sensors_read_what_the_function_says(robot: Robot) -> None:
    exact = with_own(replace(RANGE, sensor=SensorSpec()))
    for k, readings in enumerate(readings_at(robot, exact, 5)):
        q = robot.configuration(position=(0.2 * k * DT, 0.0, -5.0))
        reading = readings.own["beacon_range"]
        assert (reading.value, reading.t) == (pytest.approx(true_range(q), abs=1e-12), k * DT)


@pytest.mark.slow
def test_exact_sensors_give_the_exact_state() -> None:
    exact = replace(IDEAL_SENSORS, own=(replace(RANGE, sensor=SensorSpec()),))
    record = replace(reach(duration=2.0), sensors=exact).run()
    assert not record.run_meta.alarms
    np.testing.assert_allclose(record["q_estimated"], record["q"], atol=1e-4)
    measured = record["measured_beacon_range"]
    np.testing.assert_allclose(measured[:, 0], true_range(record["q"]), atol=1e-12)
    np.testing.assert_allclose(measured[:, 1], record["t"], atol=1e-9)


@pytest.mark.slow
def test_one_that_is_biased_is_named_and_is_good_again_and_the_estimate_stays() -> None:
    scenario = reach(noise=True, duration=7.0)
    noisy = replace(scenario, sensors=replace(scenario.specs, own=(RANGE,)))
    record = replace(noisy, faults="own_beacon_range:bias=1@2-5").run()
    alarms = [alarm for alarm in record.run_meta.alarms if alarm.text.startswith("beacon_range")]
    words = [alarm.text.split(":")[0].removeprefix("beacon_range ") for alarm in alarms]
    assert words == ["suspect", "lost", "suspect", "good again"]
    assert 2.0 < alarms[0].t < 3.0
    assert alarms[-1].t > 5.0
    assert len(alarms) == len(record.run_meta.alarms)
    off = np.linalg.norm(record["q_estimated"][:, :3] - record["q"][:, :3], axis=1)
    assert off[record["t"] > 1.0].max() < 0.05
    assert record.run_meta.channels[-1] == "beacon_range"
    assert estimate_recording(record, noisy.robot, specs=noisy.specs).same


def test_campaigns_vary_it() -> None:
    scenario = reach(noise=True)
    noisy = replace(scenario, sensors=replace(scenario.specs, own=(RANGE,)))
    parameters = {parameter.name: parameter for parameter in sensor_parameters(noisy)}
    assert parameters["sensors.beacon_range.bias"].unit == "m"
    changed = parameters["sensors.beacon_range.sigma"].apply(noisy, 0.5)
    assert changed.real_sensors is not None
    assert changed.real_sensors.present["beacon_range"].sigma == 0.5
    assert changed.specs.present["beacon_range"].sigma == 0.02


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": "depth"}, "channel 'depth' twice; give each a name of its own"),
        ({"name": "my range"}, "channel 'my range'; give a name of letters, digits and _"),
        ({"size": 4}, "channel beacon_range of 4 numbers; give 1 to 3"),
        (
            {"measure": None},
            "channel beacon_range without measure; give a channel of your own both",
        ),
        ({"sensor": None}, "channel beacon_range without sensor; give a channel of your own both"),
    ],
)
def test_rows_that_cannot_be(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        with_own(replace(RANGE, **changes))


def test_functions_that_cannot_be(robot: Robot) -> None:
    two = replace(RANGE, size=2)
    message = r"beacon_range returned SX of shape \(1, 1\); return a CasADi expression of its state"
    with pytest.raises(InvalidInput, match=message):
        Estimator(robot, with_own(two))
    with pytest.raises(InvalidInput, match="beacon_range returned float"):
        Estimator(robot, with_own(replace(RANGE, measure=lambda state: 1.0)))


def test_faults_of_channels_that_there_are_not(robot: Robot) -> None:
    with pytest.raises(InvalidInput, match=r"there is no sensor other; there are .*, beacon_range"):
        readings_at(robot, with_own(RANGE), 1, "own_other:lost@1")
