"""The filter in C and in Python: the same numbers, whatever is read and however late."""

from __future__ import annotations

import numpy as np
import pytest
from compiler import needs_compiler
from estimation.consistency import DELAYS, SPECS, late

from uvms_ocp.checks import unchecked_constructor
from uvms_ocp.estimation.estimator import Estimator
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import (
    CHANNELS,
    IDEAL_SENSORS,
    Command,
    Reading,
    Readings,
    SensorSpec,
    SensorSpecs,
)
from uvms_ocp.types import Array

EVERYTHING_LATE = late(SPECS, {name: 0.03 + 0.1 * k for k, name in enumerate(CHANNELS)})


class Babble:
    """Readings at random: of any motion, at times lost, not finite, of the future, or out of
    order.
    """

    def __init__(self, robot: Robot, specs: SensorSpecs, seed: int) -> None:
        self.robot = robot
        self.specs = specs
        self.rng = np.random.default_rng(seed)
        self.sizes = {"depth": (), "altimeter_range": (), "attitude": (4,)}
        self.sizes |= dict.fromkeys(("joint_positions", "joint_velocities"), (robot.n_joints,))

    def readings(self, t: float) -> Readings:
        present = [name for name in CHANNELS if getattr(self.specs, name) is not None]
        return Readings(
            **{name: self.reading(name, t) for name in present if self.rng.random() < 0.5}
        )

    def reading(self, name: str, t: float) -> Reading:
        spec: SensorSpec = getattr(self.specs, name)
        value = self.value(name)
        fate = self.rng.random()
        if fate < 0.02:
            value = value * np.nan
        elif fate < 0.04:
            value = value + (0.0 if name == "attitude" else 1.0)
        at = t - spec.delay * self.rng.choice([1.0, 0.5, 1.3]) + (1.0 if fate > 0.98 else 0.0)
        return Reading(value=value, t=float(at))

    def value(self, name: str) -> Array | float:
        drawn = 0.02 * self.rng.standard_normal(self.sizes.get(name, (3,)))
        if name == "attitude":
            drawn[3] = 1.0
            return drawn / np.linalg.norm(drawn)
        if name == "specific_force":
            drawn[2] += 9.81
        if np.ndim(drawn) > 0:
            return drawn
        middle = 5.0 if name == "altimeter_range" else 0.0
        return float(drawn) + middle

    def command(self) -> Command | None:
        if self.rng.random() < 0.1:
            return None
        return Command(v=0.1 * self.rng.standard_normal(self.robot.n_v))


@pytest.mark.sampled
@needs_compiler
@pytest.mark.parametrize("name", ["girona_maris7", "planar5"])
@pytest.mark.parametrize(
    "specs", [SensorSpecs(), SPECS, late(SPECS, DELAYS), EVERYTHING_LATE], ids=range(4)
)
def test_in_c_and_in_python_the_numbers_are_the_same(name: str, specs: SensorSpecs) -> None:
    robot = load_robot(name)
    compiled = Estimator(robot, specs)
    plain = Estimator(robot, specs, compiled=False)
    babble = Babble(robot, specs, seed=len(name))
    t = 0.0
    for _ in range(300):
        t += float(babble.rng.choice([0.0, 0.005, 0.01, 0.02]))
        readings = babble.readings(t)
        command = babble.command()
        a = compiled(readings, t, command)
        b = plain(readings, t, command)
        for part in ("q", "v", "std", "age", "altimeter_range"):
            np.testing.assert_array_equal(getattr(a, part), getattr(b, part), err_msg=part)
    np.testing.assert_array_equal(compiled.memory.outcome, plain.memory.outcome)
    np.testing.assert_array_equal(compiled.covariance, plain.covariance)


@pytest.mark.slow
@pytest.mark.parametrize(
    "specs", [SensorSpecs(), IDEAL_SENSORS, late(SPECS, DELAYS)], ids=["default", "ideal", "late"]
)
def test_covariances_stay_symmetric_and_positive(specs: SensorSpecs) -> None:
    """Of the vehicle with its clones, and of the joints, after 3e4 ticks."""
    robot = load_robot("girona_maris7")
    by_channel = {
        name: getattr(specs, name) for name in CHANNELS if getattr(specs, name) is not None
    }
    values = {name: np.zeros(3) for name in by_channel} | {"depth": 0.0, "altimeter_range": 5.0}
    values |= {name: np.zeros(robot.n_joints) for name in ("joint_positions", "joint_velocities")}
    values |= {
        "attitude": np.array([0.0, 0.0, 0.0, 1.0]),
        "specific_force": np.array([0.0, 0.0, 9.81]),
    }
    estimator = Estimator(robot, specs)
    dt = 0.01
    reading = unchecked_constructor(Reading)
    all_readings = unchecked_constructor(Readings)
    steps = {name: max(1, round(1.0 / (spec.rate * dt))) for name, spec in by_channel.items()}
    for k in range(30_000):
        readings = {}
        for name, spec in by_channel.items():
            stamp = (k - round(spec.delay / dt)) // steps[name] * steps[name]
            if stamp >= 0:
                readings[name] = reading(value=values[name], t=stamp * dt)
        estimator(all_readings(**readings), k * dt)
    m = estimator.memory
    n = len(estimator.covariance) + 3 * (int(np.flatnonzero(m.owner >= 0).max(initial=-1)) + 1)
    upper = np.triu(m.P[:n, :n])
    is_used = np.concatenate([np.ones(28, dtype=bool), np.repeat(m.owner[: (n - 28) // 3] >= 0, 3)])
    is_used &= np.diag(upper) > 0.0  # channels with one row have two of zeros
    P = (upper + np.triu(upper, 1).T)[np.ix_(is_used, is_used)]
    scale = 1.0 / np.sqrt(np.diag(P))
    assert np.linalg.eigvalsh(P * scale[:, None] * scale).min() > -1e-9
    for joint in m.joint_P:
        np.testing.assert_allclose(joint, joint.T, atol=1e-12)
        assert np.linalg.eigvalsh(joint[:2, :2]).min() > 0.0
    assert np.linalg.eigvalsh(estimator.covariance * scale[:28, None] * scale[:28]).min() > 0.0
