"""Identification with sensors of which little is known: ``python benchmarks/identification_sensors.py``.

Vehicles with drawn numbers are seen by sensors with drawn delays, places, mounting and biases, and
identified by settings that say nothing of these, as a recording of others is. Writes
identification_sensors.csv and identification_sensors.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import erf, sqrt
from pathlib import Path
from time import process_time

import casadi as ca
import numpy as np
from drawn_vehicles.driving import NOISE, RATE, VELOCITY, VERTICAL, drawn, recorded, vehicle
from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import column, rows_where

from uvms_ocp.identification.calibration_robot import calibrated_robot, with_delays
from uvms_ocp.identification.fit import FitContext, Search
from uvms_ocp.identification.held_constants import held_constants
from uvms_ocp.identification.identified_numbers import (
    INTERVAL,
    numbers,
    numbers_at,
)
from uvms_ocp.identification.model import StageFunctions, Vehicle, stage_of
from uvms_ocp.identification.parameters import Free, ParameterStatus, Prior
from uvms_ocp.identification.predictor import Predicted
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.segments import PreparedRecording
from uvms_ocp.identification.settings import CalibrationSettings
from uvms_ocp.identification.whiteness import variance_inflation
from uvms_ocp.robot.spatial import quaternion_exp, quaternion_multiply

ROBOTS = 40
DURATION = 60.0  # [s] of the recording of each
SENT = 0.1  # [s] between two commands
HELD = 2.0  # [s] for which a drawn thrust is commanded
THRUST = 8.0  # [N] standard deviation of a drawn thrust
GYRO_BIAS = 0.002  # [rad/s] standard deviation
LONG_STEP = 0.1
"""[s] of a simulation, which is too long for these vehicles."""
DRAWN = {
    **{name: Prior(sigma=0.03) for name in ("gain", "reverse")},
    "lag": Prior(sigma=0.1),
    **{name: Prior(sigma=0.35) for name in ("delay", "velocity_delay")},
    "velocity_point": Prior(sigma=0.02),
    "attitude_turn": Prior(sigma=0.01),
}
"""What is drawn beside added mass and drag, how far from what is believed: shares, logarithms of
delays, [m] and [rad].
"""
WATER: dict[str, ParameterStatus] = dict.fromkeys(
    ("added_mass", "linear_drag", "quadratic_drag"), Free()
)
SETTINGS = {
    "robot": "bluerov2_alpha5",
    "arm": "taken off",
    "hull": [[-0.25, -0.2, -0.15], [0.25, 0.2, 0.15]],
    "dead_zone": 0.3,
    "learn": {"added_mass": {}, "linear_drag": {}, "quadratic_drag": {}, "lag": {"prior": 0.1}},
    "noise": {"velocity": VELOCITY, "rate": RATE, "vertical": VERTICAL, "process": 0.02},
}
"""Settings that say nothing of thrusters' gains, delays and places of sensors."""
PROSE = """
{robots} vehicles like a BlueROV2 without its arm, a recording of {duration:g} s of each. Drawn are
added mass and drag (a third), gains of thrusters ahead and astern ({gain:.0f} %), their lag
({lag:.0f} %), delays of commands and of velocity by a factor of about two, where velocity is
measured ({point:.0f} cm), how the sensor of attitude sits ({turn:.1f} degrees), and biases of the
gyroscope ({bias:g} rad/s); noise is {velocity:g} m/s, {rate:g} rad/s and {vertical:g} in the
vertical, ten times a second. Settings name what is to be learnt and the noise alone. Steps of
{step:g} s: {inside:.1f} % of {n} true numbers lie within their intervals of {share:.0f} %,
{narrow:.1f} % without what is assumed. Of the first {few} vehicles with steps of {long:g} s, too
long for them: {coarse:.1f} %, and {coarse_narrow:.1f} % without. A fit takes {seconds:.0f} s of a
processor in the median.
"""


def recorded_by_own_sensors(
    auv: Vehicle, stage: StageFunctions, truth: np.ndarray, rng: np.random.Generator
) -> Recording:
    """A recording of a vehicle by its own sensors, which are turned and biased."""
    t = np.arange(0.0, DURATION, SENT)
    thrust = THRUST * rng.normal(size=(round(DURATION / HELD), len(auv.actuators.names)))
    commands = Channel(t=t, values=np.repeat(thrust, round(HELD / SENT), axis=0))
    recording = recorded(auv, stage, truth, rng, commands)
    turn = np.array(ca.evalf(auv.values(ca.SX(ca.DM(truth)))["attitude_turn"])).ravel()
    attitude = recording.channels["attitude"]
    rate = recording.channels["angular_velocity"]
    turned = [np.ravel(quaternion_multiply(q, quaternion_exp(turn))) for q in attitude.values]
    biased = rate.values + GYRO_BIAS * rng.normal(size=3)
    changed = {
        "attitude": replace(attitude, values=np.array(turned)),
        "angular_velocity": replace(rate, values=biased),
    }
    return replace(recording, channels={**recording.channels, **changed})


def identified(
    recording: Recording,
    truths: dict[str, float],
    robot: int,
    step: float,
    rollouts: dict[str, Rollout],
) -> list[Row]:
    """A row for each number."""
    settings = CalibrationSettings.model_validate({**SETTINGS, "step": step})
    subject = with_delays(calibrated_robot(settings, Path()), settings, at_once=False)
    rollout = rollouts.setdefault("fit", Rollout(stage_of(subject.vehicle, sharp=True)))
    prepared = (PreparedRecording.of(recording, subject.vehicle),)
    search = Search(step=step)
    begun = process_time()
    fitted = FitContext.searched(
        vehicle=subject.vehicle, rollout=rollout, prepared=prepared, noise=NOISE, search=search
    )
    inflation = variance_inflation(Predicted.joined(list(fitted.residuals().values())), NOISE)
    wide, _ = held_constants(fitted, settings, inflation)
    duration = process_time() - begun
    assumed = numbers(subject.vehicle, wide, inflation)
    without = numbers(subject.vehicle, replace(fitted.estimate, assumed=0.0), inflation)
    rows = list[Row]()
    for number, narrow in zip(assumed, without, strict=True):
        truth = truths[number.name]
        rows.append(
            {
                "robot": robot,
                "step [s]": step,
                "number": number.name,
                "truth": truth,
                "estimate": number.value,
                "standard error": number.sigma,
                "without assumptions": narrow.sigma,
                "inside": number.interval[0] <= truth <= number.interval[1],
                "inside without": narrow.interval[0] <= truth <= narrow.interval[1],
                "determined": number.determined,
                "status": fitted.estimate.status.value,
                "time [s]": duration,
            }
        )
    return rows


def by_number(rows: Sequence[Row]) -> list[Row]:
    """How often each is inside its interval, and how well it is known."""
    names = dict.fromkeys(column(rows, "number"))
    return [_summary(name, rows_where(rows, "number", name)) for name in names]


def _summary(name: str, rows: Sequence[Row]) -> Row:
    return {
        "number": name,
        "inside [%]": share(rows, "inside"),
        "inside without [%]": share(rows, "inside without"),
        "determined [%]": share(rows, "determined"),
        "median standard error": float(np.median(column(rows, "standard error"))),
    }


def share(rows: Sequence[Row], name: str) -> float:
    """[%] of rows of which that is true."""
    if not rows:
        return float("nan")
    return 100.0 * float(np.mean(column(rows, name)))


def main() -> None:
    """Draw, drive and identify."""
    _, run = begin(parser_of(__doc__))
    auv = vehicle({**WATER, **DRAWN})
    rollouts = dict[str, Rollout]()
    stage = stage_of(auv)
    robots = 1 if run.quick else ROBOTS
    fine_step = LONG_STEP / 2 if run.quick else Search().step
    n_coarse = max(1, robots // 4)
    fine = list[Row]()
    coarse = list[Row]()
    for k, truth in enumerate(drawn(auv, np.random.default_rng(0), robots)):
        recording = recorded_by_own_sensors(auv, stage, truth, np.random.default_rng(k))
        true_numbers = numbers_at(auv, truth, np.eye(len(truth)))
        truths = {number.name: number.value for number in true_numbers}
        fine += identified(recording, truths, k, fine_step, rollouts)
        if k < n_coarse:
            coarse += identified(recording, truths, k, LONG_STEP, rollouts)
    figures = {
        "gain": 100.0 * DRAWN["gain"].sigma,
        "lag": 100.0 * DRAWN["lag"].sigma,
        "point": 100.0 * DRAWN["velocity_point"].sigma,
        "turn": np.rad2deg(DRAWN["attitude_turn"].sigma),
        "share": 100.0 * erf(INTERVAL / sqrt(2.0)),
        "robots": robots,
        "duration": DURATION,
        "bias": GYRO_BIAS,
        "velocity": VELOCITY,
        "rate": RATE,
        "vertical": VERTICAL,
        "step": fine_step,
        "inside": share(fine, "inside"),
        "n": len(fine),
        "narrow": share(fine, "inside without"),
        "few": n_coarse,
        "long": LONG_STEP,
        "coarse": share(coarse, "inside"),
        "coarse_narrow": share(coarse, "inside without"),
        "seconds": float(np.median(column(fine, "time [s]"))),
    }
    title = "Identification with sensors of which little is known"
    name = "identification_sensors"
    summary = by_number(fine)
    table = Table(rows=summary, columns={name: _format(name) for name in summary[0]})
    run.write(
        Report(
            name=name,
            title=title,
            prose=PROSE.format(**figures),
            tables=[table],
            data={name: [*fine, *coarse]},
        )
    )


def _format(name: str) -> str:
    """Choose the format of a column by its name."""
    if "error" in name:
        return ".3g"
    return ".0f" if "%" in name else ""


if __name__ == "__main__":
    main()
