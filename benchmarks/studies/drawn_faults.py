"""Drawn single faults of sensors of shipped robots that hover or sway: which channels the robot
names, and which sound ones it gives up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from recording.rows import column, known_values, rows_where

from studies.study import Study, seeded_study
from uvms_ocp.campaign.jobs import Row
from uvms_ocp.mission.phase import Above, Phase, Transition
from uvms_ocp.record.meta_values import DONE
from uvms_ocp.record.record import Record
from uvms_ocp.report.end_of_run import cause_of_end
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import SensorSpec, Trust
from uvms_ocp.scenario.options import activate, mission_of, run_options
from uvms_ocp.scenario.scenario import Scenario, pose_at
from uvms_ocp.sim.faults import parse_fault
from uvms_ocp.tasks import (
    HorizontalAttitude,
    JointLimits,
    JointTracking,
    MinimumAltitude,
    Task,
    VehiclePose,
)
from uvms_ocp.types import Count

ROBOTS = (
    "bluerov2",
    "bluerov2_alpha5",
    "bluerov2_six_alpha5",
    "bluerov2_two_alpha5",
    "girona_maris7",
    "girona_maris7_full",
)
PERIODS = (0.01, 0.02, 0.05)  # [s]
JOINT_RATES = SensorSpec(rate=200.0, sigma=2e-3)
"""Sensor of joint rates, which half of the robots have."""
ONSET = 5.0  # [s] at the earliest
LONGEST_ONSET = 3.0  # [s] by which it is later at most
AFTER = 12.0  # [s] that are run after the end of a fault
SHORT = (3.0, 8.0)  # [s] that faults last that come at once
SLOW = 25.0  # [s] that drifts last at most
TOLD = 0.5  # [s] in which what two channels disagree in is told of both
GIVEN_UP = 2.0  # [s] for which no sound channel may be lost
TRUSTED = 8.0  # [s] after the end of a fault when all is trusted again
_PLACE = (0.0, 0.0, -15.0)  # [m]
_SEABED = -18.0  # [m]
_RATES = ("linear_velocity", "angular_velocity", "joint_velocities")


@dataclass(frozen=True, kw_only=True, slots=True)
class Strength:
    """Least and largest faults of a channel, which others can show."""

    bias: tuple[float, float]
    """[unit of the channel]"""
    drift: tuple[float, float]
    """[unit of the channel per s]"""
    spikes: tuple[float, float]
    """[unit of the channel]"""
    components: int
    """Components of an error; 0 of all joints."""


STRENGTHS = {
    "position": Strength(bias=(0.5, 20.0), drift=(0.03, 0.3), spikes=(1.0, 50.0), components=3),
    "depth": Strength(bias=(0.3, 5.0), drift=(0.02, 0.3), spikes=(0.5, 50.0), components=1),
    "attitude": Strength(bias=(0.1, 1.0), drift=(0.02, 0.3), spikes=(0.2, 1.0), components=3),
    "angular_velocity": Strength(
        bias=(0.08, 1.0), drift=(0.01, 0.2), spikes=(0.5, 3.0), components=3
    ),
    "linear_velocity": Strength(
        bias=(0.12, 1.0), drift=(0.01, 0.2), spikes=(0.3, 5.0), components=3
    ),
    "joint_positions": Strength(
        bias=(0.1, 1.0), drift=(0.02, 0.3), spikes=(0.1, 1.0), components=0
    ),
    "joint_velocities": Strength(
        bias=(0.1, 1.0), drift=(0.02, 0.3), spikes=(1.0, 5.0), components=0
    ),
    "altimeter_range": Strength(
        bias=(0.5, 20.0), drift=(0.1, 0.5), spikes=(0.5, 20.0), components=1
    ),
}
"""Strengths of faults by channel."""
KINDS = ("bias", "drift", "spikes", "frozen", "lost", "nan")


@dataclass(frozen=True, kw_only=True, slots=True)
class DrawnFault:
    """A fault, and the robot that it strikes."""

    robot: str
    dt: float
    """[s]"""
    has_joint_rates: bool
    sways: bool
    channel: str
    kind: str
    text: str
    """The fault with its times."""
    onset: float
    """[s]"""
    end: float
    """[s]"""


def drawn_fault(seed: int) -> DrawnFault:
    """Draw a robot, a channel that others can show, the way it fails and for how long."""
    rng = np.random.default_rng(seed)
    name = str(rng.choice(ROBOTS))
    dt = float(rng.choice(PERIODS))
    n_joints = load_robot(name).n_joints
    has_joint_rates = bool(n_joints and rng.random() < 0.5)
    sways = bool(rng.random() < 0.5)
    channels = [channel for channel in STRENGTHS if not channel.startswith("joint")]
    if has_joint_rates:
        channels += ["joint_positions", "joint_velocities"]
    channel = str(rng.choice(channels))
    kind = str(rng.choice(KINDS))
    onset = round(ONSET + float(rng.uniform(0.0, LONGEST_ONSET)), 2)
    lasts = float(rng.uniform(*SHORT))
    if kind == "drift":
        lasts = SLOW
    end = round(onset + lasts, 2)
    values = _values(channel, kind, n_joints, rng)
    text = f"{channel}:{kind}{values}@{onset:g}-{end:g}"
    return DrawnFault(
        robot=name,
        dt=dt,
        has_joint_rates=has_joint_rates,
        sways=sways,
        channel=channel,
        kind=kind,
        text=text,
        onset=onset,
        end=end,
    )


def _values(channel: str, kind: str, n_joints: int, rng: np.random.Generator) -> str:
    """Draw the numbers of a fault as they stand in its text."""
    if kind not in ("bias", "drift", "spikes"):
        return ""
    strength = STRENGTHS[channel]
    low, high = getattr(strength, kind)
    size = float(np.exp(rng.uniform(math.log(low), math.log(high))))
    if kind == "spikes":
        return f"={size:.3g},{rng.uniform(0.05, 0.5):.2f}"
    error = np.zeros(strength.components or n_joints)
    if rng.random() < 0.5:
        error[rng.integers(len(error))] = rng.choice((-1.0, 1.0))
    else:
        error = rng.normal(size=len(error))
    error *= size / np.linalg.norm(error)
    return "=" + ",".join(f"{value:.4f}" for value in error)


class Sway:
    """A place and heading that go to and fro: a reference."""

    def __call__(self, t: float) -> tuple[pin.SE3, np.ndarray]:
        """Pose and rate (6,) at time t [s]."""
        amplitude = np.array([0.5, 0.4, 0.3, 0.4])
        frequency = np.array([0.31, 0.23, 0.37, 0.19])
        eased = 1.0 - math.exp(-t / 3.0)
        value = eased * amplitude * np.sin(frequency * t)
        rate = eased * amplitude * frequency * np.cos(frequency * t)
        rate += (1.0 - eased) / 3.0 * amplitude * np.sin(frequency * t)
        x, y, z = (np.array(_PLACE) + value[:3]).tolist()
        pose = pose_at((x, y, z), (0.0, 0.0, float(value[3])))
        return pose, np.array([*rate[:3], 0.0, 0.0, rate[3]])


def hovering(drawn: DrawnFault, seed: int) -> Scenario:
    """The robot that keeps its place, or sways about it, with its arm at home."""
    robot = load_robot(drawn.robot)
    goal: Any = Sway() if drawn.sways else pose_at(_PLACE)
    tasks: list[Task] = [MinimumAltitude(), HorizontalAttitude(), VehiclePose(goal=goal)]
    if robot.n_joints:
        tasks.insert(0, JointLimits())
        tasks.append(JointTracking(joints=robot.joint_names, goal=robot.home))
    duration = drawn.end + AFTER
    over = Transition(to=DONE, when=(Above(quantity="mission.time", limit=duration - 1.0),))
    names = [task.name for task in tasks]
    hold = Phase(name="hold", activations=activate(*names), transitions=(over,))
    options = {"robot": robot, "noise": True, "seed": seed, "dt": drawn.dt, "duration": duration}
    run = run_options(options, seabed=_SEABED)
    scenario = run.scenario(
        name="hover",
        mission=mission_of(robot, tasks, (hold,)),
        start=run.start(pose_at(_PLACE)),
        markers={},
    )
    sensors = scenario.specs
    if drawn.has_joint_rates:
        sensors = replace(sensors, joint_velocities=JOINT_RATES)
    return replace(scenario, sensors=sensors, faults=(parse_fault(drawn.text),))


def run_drawn_fault(case: dict[str, Any]) -> Row:
    """One run, and whom it blames."""
    drawn = drawn_fault(case["seed"])
    row: dict[str, Any] = {
        **case,
        "robot": drawn.robot,
        "dt": drawn.dt,
        "joint_rates": drawn.has_joint_rates,
        "sways": drawn.sways,
        "channel": drawn.channel,
        "kind": drawn.kind,
        "fault": drawn.text,
        "duration_s": round(drawn.end + AFTER, 2),
    }
    scenario = hovering(drawn, case["seed"])
    try:
        record = scenario.run()
    except Exception as error:  # whatever it is: the study has to tell
        text = " ".join(f"{type(error).__name__}: {error}".split())
        return {**row, **dict.fromkeys(_COLUMNS), "end": "error", "cause": text, "passed": False}
    return {**row, **_judged(scenario.robot, record, drawn)}


_COLUMNS = (
    "end",
    "cause",
    "found_s",
    "named_s",
    "blamed",
    "outcome",
    "sound_lost",
    "sound_lost_s",
    "sound_bad_s",
    "trusted_after_s",
    "rate_share",
    "turn_rate",
    "astray_m",
    "passed",
)


def _judged(robot: Robot, record: Record, drawn: DrawnFault) -> Row:
    channels = record.run_meta.channels
    t = record["t"]
    trust = record["health"]
    bad = trust != Trust.GOOD
    is_during = (t >= drawn.onset) & (t <= drawn.end + TOLD)
    first_of = {}
    for k, channel in enumerate(channels):
        times = t[bad[:, k] & is_during]
        if len(times):
            first_of[channel] = float(times[0]) - drawn.onset
    first = min(first_of.values(), default=math.inf)
    blamed = sorted(channel for channel, s in first_of.items() if s <= first + TOLD)
    lost_of = {}
    doubted = 0.0
    for k, channel in enumerate(channels):
        if channel != drawn.channel:
            lost_of[channel] = drawn.dt * int((trust[:, k] == Trust.LOST).sum())
            doubted = max(doubted, drawn.dt * int(bad[:, k].sum()))
    lost_longest = max(lost_of, key=lambda channel: lost_of[channel])
    outcome = _outcome(drawn.channel, blamed)
    last_bad = t[bad.any(axis=1)]
    trusted_after = float(last_bad[-1]) - drawn.end if len(last_bad) else 0.0
    end = "completed" if record.run_meta.completed else cause_of_end(record)["kind"]
    shares = np.abs(record["v"][:, robot.joint_v]) / robot.limits.velocity[robot.joint_v]
    values = {
        "end": end,
        "cause": "" if record.run_meta.completed else cause_of_end(record)["text"],
        "found_s": first if first_of else None,
        "named_s": first_of.get(drawn.channel),
        "blamed": " ".join(blamed),
        "outcome": outcome,
        "sound_lost": lost_longest if lost_of[lost_longest] > 0.0 else "",
        "sound_lost_s": lost_of[lost_longest],
        "sound_bad_s": doubted,
        "trusted_after_s": trusted_after,
        "rate_share": float(shares.max(initial=0.0)),
        "turn_rate": float(np.linalg.norm(record["v"][:, 3:6], axis=1).max()),
        "astray_m": float(np.linalg.norm(record["q"][:, :3] - _PLACE, axis=1).max()),
        "passed": outcome in ("named", "one of two") and lost_of[lost_longest] <= GIVEN_UP,
    }
    return {name: values[name] for name in _COLUMNS}


def _outcome(channel: str, blamed: Sequence[str]) -> str:
    if not blamed:
        return "unnoticed"
    if channel not in blamed:
        return "wrong"
    return {1: "named", 2: "one of two"}.get(len(blamed), "one of many")


def drawn_faults(*, n: Count = 100, seed: Count = 0) -> Study:
    """Make a study of n drawn faults from a seed on."""
    title = "Drawn faults of sensors"
    return seeded_study(
        "drawn_faults", title, n=n, seed=seed, run_case=run_drawn_fault, summarize=totals
    )


def totals(rows: Sequence[Row]) -> list[Row]:
    """Outcomes, by channel and by kind."""
    groups = {"all": list(rows)}
    for channel in STRENGTHS:
        groups[channel] = rows_where(rows, "channel", channel)
    for kind in KINDS:
        groups[kind] = rows_where(rows, "kind", kind)
    return [_total(name, group) for name, group in groups.items()]


def _total(name: str, rows: Sequence[Row]) -> Row:
    outcomes = column(rows, "outcome")
    lost = known_values(rows, "sound_lost_s")
    return {
        "faults": name,
        "runs": len(rows),
        "named": outcomes.count("named"),
        "one_of_two": outcomes.count("one of two"),
        "one_of_many": outcomes.count("one of many"),
        "wrong": outcomes.count("wrong"),
        "unnoticed": outcomes.count("unnoticed"),
        "errors": outcomes.count(None),
        "sound_lost": sum(seconds > GIVEN_UP for seconds in lost),
        "not_trusted": sum(seconds > TRUSTED for seconds in known_values(rows, "trusted_after_s")),
        "passed": sum(map(bool, column(rows, "passed"))),
    }
