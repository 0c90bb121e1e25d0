"""Whether the estimator errs as much as it says, over truths drawn from its own model: NEES and NIS
of every part.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from scipy.stats import chi2

from estimation.drawn import Watched
from uvms_ocp.estimation.filter_memory import MAIN, Part
from uvms_ocp.estimation.tuning import EstimatorTuning
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import ACCELEROMETER, CHANNELS, SensorSpec, SensorSpecs
from uvms_ocp.types import Array

SPECS = SensorSpecs(
    specific_force=ACCELEROMETER, joint_velocities=SensorSpec(rate=50.0, sigma=0.01)
)
"""Every channel."""
DELAYS = {
    "position": 1.5,
    "linear_velocity": 0.3,
    "altimeter_range": 0.2,
    "attitude": 0.2,
    "angular_velocity": 0.05,
    "joint_positions": 0.05,
}
"""[s] of channels as late as they usually are."""
CALM = EstimatorTuning(angular_jerk=0.003)
"""Turns so little that the altimeter keeps the floor in sight."""
TOGETHER = 0.95
"""chance that a filter which errs as much as it says passes all tests."""
SETTLED = 4.0
"""[s] after which errors are looked at."""
APART = {
    "attitude": 1.0,
    "spin": 1.0,
    "spin_up": 1.0,
    "speed": 2.0,
    "altitude": 2.0,
    "joints": 1.0,
    "joint_rates": 1.0,
}
"""[s] after which errors of a part are no longer correlated; once per run where none is given."""
_PARTS = {
    "attitude": Part.TURN,
    "position": Part.PLACE,
    "speed": Part.SPEED,
    "acceleration": Part.ACCELERATION,
    "spin": Part.SPIN,
    "spin_up": Part.SPIN_UP,
    "gyro_bias": Part.GYRO_BIAS,
    "dvl_bias": Part.DVL_BIAS,
    "force_bias": Part.FORCE_BIAS,
}


@dataclass(slots=True)
class Sum:
    """Squared errors, each divided by its variance."""

    squared: float = 0.0
    degrees: int = 0

    def add(self, squared: float, degrees: int) -> None:
        """One more."""
        self.squared = self.squared + squared
        self.degrees = self.degrees + degrees

    @property
    def mean(self) -> float:
        """1 is right."""
        return self.squared / max(1, self.degrees)


@dataclass(slots=True)
class Ledger:
    """Sums by what they are of; NEES of parts, NIS of channels."""

    sums: dict[str, Sum] = field(default_factory=dict)

    def add(self, name: str, squared: float, degrees: int) -> None:
        """Add squared errors to the sum of that name."""
        self.sums.setdefault(name, Sum()).add(squared, degrees)


def late(specs: SensorSpecs, delays: Mapping[str, float]) -> SensorSpecs:
    """The channels with those delays [s]."""
    delayed = {}
    for name, delay in delays.items():
        delayed[name] = replace(getattr(specs, name), delay=delay)
    return replace(specs, **delayed)


def consistency(
    robot: Robot, specs: SensorSpecs, *, seeds: int, duration: float, first: int = 0
) -> list[dict[str, object]]:
    """One row per part and channel: its mean and what it may be, with a chance of `TOGETHER` for
    all rows together.
    """
    ledger = Ledger()
    for seed in range(first, first + seeds):
        run = Watched(robot, specs, EstimatorTuning(), seed=seed)
        _watch(run, ledger, duration, skipped=("NIS altimeter_range", "NEES altitude"))
        calm = Watched(robot, specs, CALM, seed=1000 + seed)
        _watch(calm, ledger, 0.6 * duration, only=("NIS altimeter_range", "NEES altitude"))
    return list(_judged(ledger))


def _judged(ledger: Ledger) -> Iterator[dict[str, object]]:
    share = (1.0 - TOGETHER) / len(ledger.sums)
    for name, total in sorted(ledger.sums.items()):
        low = chi2.ppf(share / 2, total.degrees) / total.degrees
        high = chi2.ppf(1.0 - share / 2, total.degrees) / total.degrees
        inside = bool(low <= total.mean <= high)
        yield {
            "of": name,
            "mean": total.mean,
            "least": low,
            "most": high,
            "n": total.degrees,
            "inside": inside,
        }


def _watch(
    run: Watched,
    ledger: Ledger,
    duration: float,
    *,
    skipped: tuple[str, ...] = (),
    only: tuple[str, ...] = (),
) -> None:
    last: dict[str, float] = dict.fromkeys(CHANNELS, -np.inf)
    due: dict[str, float] = {}
    ticks = round(duration / run.truth.dt)
    for k in range(ticks + 1):
        run.tick()
        if run.t < SETTLED - 1e-9:
            continue
        squares = [*_innovations(run, last), *_errors(run, due, final=k == ticks)]
        for name, squared, degrees in squares:
            if name not in skipped and (not only or name in only):
                ledger.add(name, squared, degrees)


def _innovations(run: Watched, last: dict[str, float]) -> Iterator[tuple[str, float, int]]:
    for channel in CHANNELS:
        outcome = run.estimator.outcome(channel)
        if outcome is not None and outcome.t > last[channel]:
            last[channel] = outcome.t
            yield f"NIS {channel}", outcome.squared, outcome.degrees


def _errors(
    run: Watched, due: dict[str, float], *, final: bool
) -> Iterator[tuple[str, float, int]]:
    names = []
    for name in (*_PARTS, "altitude", "joints", "joint_rates"):
        is_due = run.t >= due.get(name, 0.0) - 1e-9 if name in APART else final
        if is_due:
            names.append(name)
            due[name] = run.t + APART.get(name, np.inf)
    if not names:
        return
    error = error_of(run)
    P = run.estimator.covariance
    joints = run.estimator.memory.joint_P
    for name in names:
        if name in _PARTS:
            part = slice(_PARTS[name], _PARTS[name] + 3)
            squared = error[part] @ np.linalg.solve(P[part, part], error[part])
            yield f"NEES {name}", float(squared), 3
        elif name == "altitude":
            yield f"NEES {name}", *_altitude_error(run)
        else:
            order = int(name == "joint_rates")
            wrong = run.estimator.memory.joint_x[:, order] - run.truth.joints[order]
            yield f"NEES {name}", float((wrong**2 / joints[:, order, order]).sum()), len(wrong)


def error_of(run: Watched) -> Array:
    """(MAIN,) truth minus estimate, as the filter's error state has it."""
    truth = run.truth
    memory = run.estimator.memory
    R = pin.Quaternion(memory.turn).toRotationMatrix()
    channels = ("angular_velocity", "linear_velocity", "specific_force")
    biases = [truth.biases[name] for name in channels]
    x = np.concatenate([truth.place.ravel(), truth.spin.ravel(), *biases, [truth.floor.z]])
    error = np.zeros(MAIN)
    error[:3] = pin.log3(R.T @ truth.R)
    error[3:] = x - memory.x[3:]
    return error


def _altitude_error(run: Watched) -> tuple[float, int]:
    """Return the normalised squared error of the range along the beam, and its degrees of freedom."""
    estimated, spread = run.estimator.memory.range
    down = run.truth.R[2]
    memory = run.estimator.memory
    cosine = float(down @ memory.beam_up)
    true = (run.truth.place[0, 2] + float(down @ memory.beam_at) - run.truth.floor.z) / cosine
    if not np.isfinite(estimated):
        return 0.0, 0
    return float((estimated - true) ** 2 / spread**2), 1
