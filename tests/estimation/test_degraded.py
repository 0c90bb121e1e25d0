"""Channels lost or suspect at any time in any phase of Case 1: what the controller does meanwhile,
and how the mission ends.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from broken_sensors import BrokenSensors
from compiler import long_without_compiler

from uvms_ocp.codegen.kernel_layout import structure_of
from uvms_ocp.estimation.degraded_modes import (
    DEGRADED_MODES,
    FREE,
    Restriction,
    RestrictionMemory,
    degraded_channels,
    read_restriction,
    restrict,
    write_modes,
    write_trust,
)
from uvms_ocp.record.meta_values import ABORT, DONE, EventMeta
from uvms_ocp.record.record import Record
from uvms_ocp.report.end_of_run import cause_of_end
from uvms_ocp.robot.signals import CHANNELS, ChannelHealth, Trust
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.scenario import Scenario

DT = 0.04
PHASES = ("A", "B", "C", "D")
PAIRS = (("position", "linear_velocity"), ("attitude", "angular_velocity"))
LOSSES = (*((name,) for name in CHANNELS), *PAIRS)
HELD = (*PAIRS, ("attitude",))
CLIMBING = (("altimeter_range",), ("position",), ("joint_positions",))
Run = Callable[..., Record]


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return case1(plant="kinematic", dt=DT)


@pytest.fixture(scope="module")
def sound(scenario: Scenario) -> Record:
    return scenario.run()


@pytest.fixture
def run(scenario: Scenario, monkeypatch: pytest.MonkeyPatch) -> Run:
    """A run of Case 1, or of another scenario, with broken sensors."""

    def of(study: Scenario = scenario, **broken: object) -> Record:
        monkeypatch.setattr(
            Scenario, "estimator", lambda self: BrokenSensors(robot=self.robot, **broken)
        )
        return study.run()

    return of


def some_time_in(sound: Record, phase: str, seed: int) -> float:
    """[s] not in the last second of it."""
    ends = [event.t for event in sound.run_meta.events]
    index = PHASES.index(phase)
    start = 0.0
    if index > 0:
        start = ends[index - 1]
    return float(np.random.default_rng(seed).uniform(start, ends[index] - 1.0))


def after(record: Record, name: str, t: float) -> np.ndarray:
    return np.asarray(record[name][record["t"] >= t])


def events_after(record: Record, t: float) -> list[EventMeta]:
    return [event for event in record.run_meta.events if event.t >= t]


@pytest.mark.slow
@long_without_compiler
@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("lost", LOSSES, ids="+".join)
def test_whatever_is_lost_limits_hold_and_the_run_ends_for_a_reason_that_names_it(
    scenario: Scenario, sound: Record, run: Run, lost: tuple[str, ...], phase: str
) -> None:
    robot = scenario.robot
    start = some_time_in(sound, phase, CHANNELS.index(lost[0]))
    record = run(channels=lost, start=start)
    steps = np.abs(np.diff(record["command"], axis=0, prepend=0.0))
    assert (steps <= robot.limits.acceleration * DT * (1 + 1e-9)).all()
    joints = record["q"][:, robot.joint_q]
    assert (joints >= robot.limits.position_lower - 1e-9).all()
    assert (joints <= robot.limits.position_upper + 1e-9).all()
    rests_on = scenario.kinematic_controller().problem.rests_on
    ended = [
        c.quantity
        for event in events_after(record, start)
        if event.source != "climb"
        for c in event.conditions
    ]
    for channel in set(lost) & rests_on.keys():
        assert not [q for q in ended if rests_on[channel][record.meta.quantities.index(q)]]
    cause = cause_of_end(record)
    last = record.run_meta.events[-1]
    goes_on = lost not in (*CLIMBING, *HELD) or (lost == ("altimeter_range",) and phase == "D")
    expected_end = (DONE, "completed") if goes_on else (ABORT, "aborted")
    assert (last.target, cause["kind"]) == expected_end
    assert goes_on or all(
        f"{name} lost: broken by a test since {start:.1f} s" in cause["text"] for name in lost
    )
    if lost in CLIMBING and not goes_on:
        (entered,) = (event for event in record.run_meta.events if event.target == "climb")
        floor = record.meta.surroundings.floor_z
        z = float(after(record, "q", entered.t)[0, 2])
        safe = max(z, floor + 3.0)
        if lost == ("altimeter_range",):
            safe = z + 3.0
        assert record["q"][-1, 2] > safe - 0.35
    if lost in HELD:
        assert np.abs(after(record, "command", start + 1.5)).max() < 1e-9


@pytest.mark.sampled
@long_without_compiler
@pytest.mark.parametrize("trust", [Trust.SUSPECT, Trust.LOST])
@pytest.mark.parametrize("phase", ["A", "C"])
def test_without_altimeter_nothing_sinks_for_longer_than_it_takes_to_stop(
    sound: Record, run: Run, phase: str, trust: Trust
) -> None:
    start = some_time_in(sound, phase, 3)
    record = run(channels=("altimeter_range",), start=start, end=start + 4.0, trust=trust)
    during = (record["t"] >= start) & (record["t"] < start + 4.0)
    z = record["q"][during, 2]
    sinking = max(0.0, -(z[1] - z[0]) / DT)
    assert z[0] - z.min() <= sinking**2 / 2.0 + 4.0 * sinking * DT + 1e-6
    assert [event.target for event in record.run_meta.events] == ["B", "C", "D", DONE]


@pytest.mark.sampled
@long_without_compiler
@pytest.mark.parametrize(
    "channel", ["position", "linear_velocity", "attitude", "joint_positions", "altimeter_range"]
)
def test_a_suspect_channel_holds_the_mission_back_until_it_is_good_again(
    scenario: Scenario, sound: Record, run: Run, channel: str
) -> None:
    start = some_time_in(sound, "C", 5)
    record = run(channels=(channel,), start=start, end=start + 30.0, trust=Trust.SUSPECT)
    assert record.run_meta.completed
    limits = scenario.robot.limits
    if channel != "altimeter_range":
        slow = record["command"][(record["t"] > start + 1.0) & (record["t"] < start + 30.0)]
        assert (np.abs(slow) <= 0.5 * limits.velocity * (1 + 1e-9)).all()
    if channel in ("attitude", "altimeter_range"):
        assert events_after(record, start)[0].t >= start + 30.0


@long_without_compiler
def test_a_channel_that_comes_back_in_time_lets_the_mission_go_on(sound: Record, run: Run) -> None:
    start = some_time_in(sound, "A", 1)
    record = run(channels=("attitude",), start=start, end=start + 6.0)
    assert record.run_meta.completed
    assert (
        np.abs(record["command"][(record["t"] > start + 2.0) & (record["t"] < start + 5.9)]).max()
        < 1e-9
    )


@long_without_compiler
def test_without_an_abort_phase_the_robot_holds_and_says_what_holds_it_back(
    scenario: Scenario, run: Run
) -> None:
    mission = replace(scenario.mission, abort=None)
    record = run(
        replace(scenario, mission=mission, duration=25.0), channels=("joint_positions",), start=8.0
    )
    assert np.abs(after(record, "command", 20.0)).max() < 1e-9
    assert not record.run_meta.events
    assert record.run_meta.pending.endswith("; joint_positions lost: broken by a test since 8.0 s")


@pytest.mark.sampled
@long_without_compiler
@pytest.mark.parametrize("start", [4.0, 8.9, 12.3])
def test_a_doubt_that_is_over_leaves_no_haste_behind(
    scenario: Scenario, sound: Record, run: Run, start: float
) -> None:
    """In phase A the robot only ever gets slower as it comes nearer, and whether it paused to doubt
    makes no difference.
    """
    short = replace(scenario, duration=start + 6.0)
    record = run(short, channels=("position",), start=start, end=start + 2.0, trust=Trust.SUSPECT)
    before = np.abs(sound["command"][sound["t"] < start][-1])
    assert (np.abs(after(record, "command", start))[:, :3] <= 1.01 * before[:3] + 1e-3).all()
    way = sound["q"][:, :3]
    gone = record["q"][:, :3]
    assert max(np.linalg.norm(way - place, axis=1).min() for place in gone) < 0.02


@long_without_compiler
def test_a_slower_robot_goes_the_same_way(scenario: Scenario, sound: Record, run: Run) -> None:
    """Else a strict hierarchy lets other axes join in for what one may not do."""
    ends = [
        record["q"][-1, :2] for record in (sound, run(channels=("linear_velocity",), start=8.0))
    ]
    assert np.linalg.norm(ends[1] - ends[0]) < 0.03


@long_without_compiler
def test_where_every_channel_is_good_nothing_is_other_than_where_nobody_judges(
    sound: Record, run: Run
) -> None:
    judged = run(channels=(), start=0.0)
    np.testing.assert_array_equal(judged["command"], sound["command"])
    np.testing.assert_array_equal(judged["q"], sound["q"])


def restriction_for(health: Sequence[ChannelHealth], t: float) -> Restriction:
    memory = structure_of(RestrictionMemory)()
    bad = degraded_channels(health)
    write_modes(memory)
    write_trust(memory.level, memory.since, bad)
    restrict(memory, t, True)
    return read_restriction(memory, bad)


def test_nobody_who_judges_and_only_good_channels_restrict_nothing() -> None:
    good = tuple(ChannelHealth(channel=name, trust=Trust.GOOD) for name in CHANNELS)
    assert restriction_for((), 0.0) is FREE
    assert restriction_for(good, 0.0) is FREE


def test_every_mode_says_what_is_still_known_and_losing_more_never_allows_more() -> None:
    assert all(mode.substitute and mode.without <= set(CHANNELS) for mode in DEGRADED_MODES)

    def lost(names: set[str]) -> tuple[float, ...]:
        restriction = restriction_for(
            [ChannelHealth(channel=name, trust=Trust.LOST) for name in names], 60.0
        )
        bars = (
            restriction.no_descent,
            restriction.joints_held,
            restriction.hold,
            restriction.blind,
            restriction.attitude_open,
            not restriction.can_ascend,
            bool(restriction.abort),
        )
        return (1.0 - restriction.speed, *map(float, bars))

    for first in CHANNELS:
        for second in CHANNELS:
            assert all(a <= b for a, b in zip(lost({first}), lost({first, second}), strict=True))


@pytest.mark.parametrize("gyro_back", [0.5, 5.0, 15.0])
def test_an_attitude_that_stays_suspect_is_open_for_no_longer_than_its_mode_allows(
    gyro_back: float,
) -> None:
    """Once the gyro was good again no mode told when the hold ends, and it lasted for ever."""
    longest = next(mode.max_duration for mode in DEGRADED_MODES if mode.attitude_open)
    memory = structure_of(RestrictionMemory)()
    write_modes(memory)
    ended = list[float]()
    attitude = ChannelHealth(channel="attitude", trust=Trust.SUSPECT, since=0.0)
    gyro = ChannelHealth(channel="angular_velocity", trust=Trust.SUSPECT, since=0.0)
    for k in range(300):
        t = 0.1 * k
        bad = [attitude, gyro] if t < gyro_back else [attitude]
        write_trust(memory.level, memory.since, bad)
        restrict(memory, t, True)
        restriction = read_restriction(memory, bad)
        assert restriction.attitude_open
        assert restriction.hold
        if restriction.abort:
            assert "attitude suspect" in restriction.abort
            ended.append(t)
    assert ended[0] == pytest.approx(longest, abs=0.11)
    assert len(ended) == pytest.approx((30.0 - longest) / 0.1, abs=1.0)


def test_an_attitude_that_comes_back_and_goes_again_has_its_time_anew() -> None:
    memory = structure_of(RestrictionMemory)()
    write_modes(memory)
    for begin in (0.0, 15.0):
        for t in (begin, begin + 10.0):
            names = ("attitude", "angular_velocity")
            bad = [ChannelHealth(channel=name, trust=Trust.SUSPECT, since=begin) for name in names]
            write_trust(memory.level, memory.since, bad)
            restrict(memory, t, True)
            assert memory.attitude_open
            assert not memory.ended
        write_trust(memory.level, memory.since, [])
        restrict(memory, begin + 14.0, True)
        assert not memory.attitude_open
