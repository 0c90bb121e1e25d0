"""A fault that is put into a good recording is named, and good recordings raise no doubt."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from driven import drive, known, vehicle_of
from motions import DOWN, changed, recorded
from scipy.spatial.transform import Rotation

from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.model import stage_of
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.resampling import rotations
from uvms_ocp.identification.run_recordings import run_recording
from uvms_ocp.scenario.cases.bluerov import bluerov_inspection

Change = Callable[[np.ndarray], np.ndarray]
FORCES = slice(0, 3)
MOMENTS = slice(3, 6)


@cache
def driven() -> Recording:
    """By its commands, with late thrusters, delays and noise."""
    auv = vehicle_of(known())
    return drive(stage_of(auv), auv.shared.start, seed=1, noise=0.01, t_end=60.0)


@cache
def moved() -> Recording:
    """All that sensors tell of smooth motion, with what an accelerometer feels and an arm that
    waves.
    """
    rng = np.random.default_rng(3)
    good = recorded()
    t = good.channels["position"].t
    attitude = good.channels["attitude"]
    noisy = {
        name: replace(
            channel, values=channel.values + 0.002 * rng.normal(size=channel.values.shape)
        )
        for name, channel in good.channels.items()
    }
    felt = 9.81 * rotations(attitude, t)[:, 2] + 0.05 * rng.normal(size=(len(t), 3))
    f = np.array([0.4, 0.7, 1.1])
    angles = np.sin(f * t[:, None])
    rates = f * np.cos(f * t[:, None])
    more = {"specific_force": felt, "joint_positions": angles, "joint_velocities": rates}
    channels = {
        **noisy,
        "attitude": attitude,
        **{name: Channel(t=t, values=values) for name, values in more.items()},
    }
    return replace(good, channels=channels)


def told(recording: Recording) -> str:
    return "; ".join(map(str, check_data_quality(recording)))


def with_values(recording: Recording, name: str, change: Change) -> Recording:
    return changed(recording, name, values=change(recording.channels[name].values))


def with_times(recording: Recording, name: str, change: Change) -> Recording:
    return changed(recording, name, t=change(recording.channels[name].t))


def test_good_recordings_raise_no_doubt() -> None:
    assert told(driven()) == ""
    assert told(moved()) == ""


@pytest.mark.slow
@pytest.mark.parametrize("noise", [False, True])
def test_a_run_of_our_own_raises_no_doubt(noise: bool) -> None:
    record = bluerov_inspection(noise=noise, seed=1, duration=15.0).run()
    recording = run_recording(record, "run")
    assert {
        "position",
        "attitude",
        "linear_velocity",
        "joint_positions",
        "thrust",
    } <= recording.channels.keys()
    assert told(recording) == ""


VALUES: list[tuple[str, Change, str]] = [
    ("position", lambda x: x @ DOWN, "position: z is .*NED|position: its rate .*NED"),
    (
        "position",
        lambda x: x[:, [1, 0, 2]] * [1, 1, -1],
        r"position: its rate fits .* \(y, x, -z\): NED against ENU",
    ),
    ("position", lambda x: 1000 * x, "position: up to .* is it in mm"),
    ("position", lambda x: 1000 * x, "linear_velocity: 0.001 times .* the other in mm"),
    ("linear_velocity", lambda x: x[:, [2, 1, 0]], r"linear_velocity: its axes fit .* \(z, y, x\)"),
    ("linear_velocity", lambda x: x * [1, -1, 1], r"linear_velocity: its axes fit .* \(x, -y, z\)"),
    ("linear_velocity", lambda x: 1000 * x, "linear_velocity: 1e.03 times .* in mm"),
    (
        "angular_velocity",
        lambda x: x[:, [1, 0, 2]],
        r"angular_velocity: its axes fit .* \(y, x, z\)",
    ),
    ("angular_velocity", np.degrees, "angular_velocity: 58 times .* in deg/s"),
    ("angular_velocity", lambda x: x * [1, 1e-9, 1], "angular_velocity: dead: y"),
    ("specific_force", lambda x: x @ DOWN, r"specific_force: points down .* \(FRD\)"),
    ("specific_force", lambda x: x[:, [2, 1, 0]], "specific_force: .* axes swapped"),
    ("specific_force", lambda x: x / 9.81, "specific_force: .* in g"),
    ("specific_force", lambda x: x - [0, 0, 9.81], "specific_force: .* gravity taken out"),
    ("joint_positions", np.degrees, "joint_positions: .* in deg"),
    ("joint_velocities", np.degrees, "joint_velocities: 58 times .* in deg/s"),
    (
        "joint_velocities",
        lambda x: x[:, [1, 0, 2]],
        "joint_velocities: 0 fits the rate of position 1",
    ),
    (
        "joint_velocities",
        lambda x: x * [1, -1, 1],
        "joint_velocities: 1 fits minus the rate of position 1",
    ),
    ("joint_velocities", lambda x: x * [1, 1, 0], "joint_velocities: dead: 2"),
    ("joint_positions", lambda x: x * [1, 0, 1], "joint_positions: dead: 1"),
]


@pytest.mark.sampled
@pytest.mark.parametrize(("name", "change", "text"), VALUES)
def test_axes_signs_units_and_dead_columns_are_named(name: str, change: Change, text: str) -> None:
    found = told(with_values(moved(), name, change))
    assert re.search(text, found), found


def test_a_recording_that_is_ned_throughout_is_told_by_gravity() -> None:
    """Position, attitude and velocities agree with each other, turned as they are all together."""
    turned = {"position": lambda x: x @ DOWN, "attitude": lambda x: x * [1, -1, -1, 1]}
    turned |= dict.fromkeys(
        ("linear_velocity", "angular_velocity", "specific_force"), turned["position"]
    )
    recording = moved()
    for name, change in turned.items():
        recording = with_values(recording, name, change)
    text = told(recording)
    assert "its axes fit" not in text
    assert re.search(r"attitude: .* z down in W \(NED\)", text), text


ATTITUDES: dict[str, Change] = {
    "world: NED, body: FRD": lambda x: x * [1, -1, -1, 1],
    "the opposite of its x, y and z, as it turns from W to B": lambda x: x * [-1, -1, -1, 1],
    "format: quaternion wxyz": lambda x: x[:, [3, 0, 1, 2]],
    "format: quaternion xyzw": lambda x: x[:, [1, 2, 3, 0]],
}


@pytest.mark.sampled
@pytest.mark.parametrize(
    "beside",
    [
        (),
        ("specific_force",),
        ("position", "linear_velocity"),
        ("position", "linear_velocity", "specific_force"),
    ],
)
@pytest.mark.parametrize("how", ATTITUDES)
def test_an_attitude_that_is_read_wrong_is_told_as_such_and_not_as_other_axes_of_all_else(
    how: str, beside: tuple[str, ...]
) -> None:
    channels = {name: moved().channels[name] for name in ("attitude", "angular_velocity", *beside)}
    issues = check_data_quality(
        with_values(replace(moved(), channels=channels), "attitude", ATTITUDES[how])
    )
    text = "; ".join(map(str, issues))
    if how == "world: NED, body: FRD" and not beside:  # which a gyroscope with z down is as well
        assert "angular_velocity: its axes fit the rate of the attitude as (x, -y, -z)" in text
        return
    assert f"attitude: reads better with {how}: it agrees with" in text
    assert "its axes fit" not in text
    assert {issue.channel for issue in issues} <= {"attitude", "position"}


@pytest.mark.parametrize("how", [how for how in ATTITUDES if how.startswith("format")])
def test_a_quaternion_alone_is_in_the_order_in_which_the_vehicle_is_level(how: str) -> None:
    t = np.arange(0.0, 60.0, 0.1)
    angles = np.column_stack(
        [0.3 * t, 0.1 * np.sin(t), 0.1 * np.cos(0.7 * t)]
    )  # turning round and round
    alone = Recording(
        name="dive",
        channels={"attitude": Channel(t=t, values=Rotation.from_euler("ZYX", angles).as_quat())},
    )
    assert told(alone) == ""
    assert f"attitude: reads better with {how}: it is level then" in told(
        with_values(alone, "attitude", ATTITUDES[how])
    )
    tumbling = Rotation.from_euler(
        "xyz", np.column_stack([0.3 * t, 0.9 * np.sin(t), 0.2 * t])
    ).as_quat()
    assert "reads better" not in told(with_values(alone, "attitude", lambda _: tumbling))


@pytest.mark.sampled
@pytest.mark.parametrize("name", ["angular_velocity", "linear_velocity", "specific_force"])
def test_a_sensor_along_other_axes_is_not_told_as_an_attitude_that_is_read_wrong(name: str) -> None:
    text = told(with_values(moved(), name, lambda x: x[:, [1, 0, 2]] * [1, -1, 1]))
    assert "reads better" not in text
    assert re.search(rf"{name}: its axes fit the (rate|tilt) of the \w+ as \(-y, x, z\)", text), (
        text
    )


@pytest.mark.sampled
@pytest.mark.parametrize("angle", [-120.0, -60.0, 45.0, 130.0, 150.0])
def test_a_yaw_from_elsewhere_is_told_by_where_velocities_point(angle: float) -> None:
    """Other axes would explain two thirds of the motion, and that is not what they do where they
    are right.
    """
    turn = Rotation.from_rotvec([0.0, 0.0, np.radians(angle)])
    turned = with_values(moved(), "attitude", lambda q: (turn * Rotation.from_quat(q)).as_quat())
    assert (
        "attitude: with it the velocity is as large as the rate of the position, and points"
        " elsewhere" in told(turned)
    )


@pytest.mark.sampled
@pytest.mark.parametrize("angle", [-55.0, -35.0, 35.0, 55.0])
def test_a_heading_that_is_turned_is_told_by_how_much(angle: float) -> None:
    half = np.deg2rad(angle) / 2
    turn = Rotation.from_quat([0.0, 0.0, np.sin(half), np.cos(half)])
    text = told(
        with_values(
            moved(), "attitude", lambda x: np.asarray((turn * Rotation.from_quat(x)).as_quat())
        )
    )
    (said,) = re.findall(r"points elsewhere, by (-?\d+) deg about z", text)
    assert float(said) == pytest.approx(angle, abs=3.0)


def test_a_velocity_with_an_axis_reversed_is_doubted_and_commands_are_not() -> None:
    """Motion follows no command by such an axis, and the command is right."""
    t = driven().channels["linear_velocity"].t
    still = np.einsum(
        "nij,nj->ni",
        rotations(driven().channels["attitude"], t),
        driven().channels["linear_velocity"].values,
    )
    place = Channel(
        t=t, values=np.cumsum(np.gradient(t)[:, None] * still, axis=0) - [0.0, 0.0, 20.0]
    )
    recording = replace(driven(), channels={**driven().channels, "position": place})
    text = told(with_values(recording, "linear_velocity", lambda x: x * [1, -1, 1]))
    assert "linear_velocity: its axes fit" in text
    assert "acceleration" not in text


@pytest.mark.parametrize("factor", [1.0, 1.0 / 9.81])
def test_what_an_accelerometer_feels_has_its_size_whichever_way_a_vehicle_tilts(
    factor: float,
) -> None:
    t = np.arange(0.0, 60.0, 0.1)
    tilt = 1.4 * np.sin(0.5 * t)
    felt = 9.81 * factor * np.column_stack([np.sin(tilt), 0.0 * t, np.cos(tilt)])
    text = told(Recording(name="swing", channels={"specific_force": Channel(t=t, values=felt)}))
    assert ("in g, not in m/s2" in text) == (factor < 1.0)
    assert "its units" not in text


def test_a_value_that_a_channel_jumps_to_and_back_is_named() -> None:
    lost = np.arange(len(moved().channels["position"].t)) % 40 == 17
    text = told(
        with_values(moved(), "position", lambda x: np.where(lost[:, None], x * [1, 1, 0], x))
    )
    assert re.search(r"position: z jumps to -?0 and back \d+ times: give missing: \[-?0\]", text), (
        text
    )


def test_times_that_are_too_short_or_not_the_same_are_said() -> None:
    short = replace(
        moved(),
        channels={
            name: replace(channel, t=channel.t / 60.0) for name, channel in moved().channels.items()
        },
    )
    assert re.search(
        r"0\.6\d* s are in all channels, which are too few to look at: .* such as min", told(short)
    ), told(short)
    apart = with_times(moved(), "attitude", lambda t: t + 1e5)
    assert "no time is in all channels" in told(apart)


def test_an_accelerometer_proves_a_world_whose_zero_is_not_the_surface() -> None:
    above = with_values(moved(), "position", lambda x: x + np.array([0, 0, 5.0]))
    assert told(above) == ""
    del (channels := dict(above.channels))["specific_force"]
    assert "position: z is" in told(replace(above, channels=channels))


TIMES: list[tuple[str, Change, str]] = [
    (
        "linear_velocity",
        lambda t: t + 0.3,
        "linear_velocity: 0.30 s late against the rate of the position",
    ),
    (
        "angular_velocity",
        lambda t: t - 0.4,
        "angular_velocity: 0.40 s early against the rate of the attitude",
    ),
    (
        "joint_velocities",
        lambda t: t + 0.5,
        "joint_velocities: 0.50 s late against the rate of the positions",
    ),
    ("linear_velocity", lambda t: t + 0.7 * (t > 20.0), "linear_velocity: its clock .* a jump"),
    (
        "linear_velocity",
        lambda t: t + 30.0 * (t > 20.0),
        "linear_velocity: 1 gaps, the longest 30.* a clock that was set",
    ),
    ("position", lambda t: 1e3 * t, "position: 50 s between samples: the unit of its times"),
    ("position", lambda t: 1e-9 * t, "position: .* s between samples: the unit of its times"),
    ("attitude", lambda t: 1e9 * t, "attitude: .* s between samples: the unit of its times"),
    ("attitude", lambda t: t + 1.7e9 * (t > 0.0), "attitude: 1 gaps, .* a clock that was set"),
]


@pytest.mark.sampled
@pytest.mark.parametrize(("name", "change", "text"), TIMES)
def test_clocks_that_differ_or_jump_are_named(name: str, change: Change, text: str) -> None:
    found = told(with_times(moved(), name, change))
    assert re.search(text, found), found


def test_times_that_went_back_or_were_repeated_in_the_file_are_told() -> None:
    assert "position: times go back by up to 2.5 s" in told(changed(moved(), "position", back=2.5))
    assert "position: 700 samples had the time of another" in told(
        changed(moved(), "position", repeated=700)
    )


@pytest.mark.sampled
@pytest.mark.parametrize("shift", [0.7, 1.2, -1.5])
@pytest.mark.parametrize("command", ["wrench", "thrust"])
def test_a_command_of_another_clock_is_named(command: str, shift: float) -> None:
    """By what thrusters cannot do: act before they are told, or long after."""
    late = with_times(commanded(command), command, lambda t: t + shift)
    text = told(late)
    said = re.search(
        rf"{command}: the vehicle accelerates ([\d.]+)(?: \+- [\d.]+)? s (before|after)", text
    )
    assert said, text
    found = float(said[1]) * (1 if said[2] == "before" else -1)
    assert found == pytest.approx(shift - LAG, abs=0.1)
    assert told(changed(late, command, delay=shift)) == ""


LAG = 0.3
"""[s] by which the vehicle of the tests accelerates after its commands: delay and lag."""


def commanded(command: str) -> Recording:
    """By a wrench, or by eight thrusters that make up one."""
    if command == "wrench":
        return driven()
    channel = driven().channels["wrench"]
    mixed = np.linalg.qr(np.random.default_rng(0).normal(size=(8, 8)))[0][:6]
    channels = {name: channel for name, channel in driven().channels.items() if name != "wrench"}
    return replace(
        driven(),
        channels=channels | {"thrust": Channel(t=channel.t, values=channel.values @ mixed)},
    )


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("change", "text"),
    [
        (
            lambda x: x[:, [1, 0, 2, 3, 4, 5]],
            r"wrench: its forces fit the acceleration as \(y, x, z\)",
        ),
        (
            lambda x: x * [1, -1, -1, 1, -1, -1],
            r"wrench: its forces .* as \(x, -y, -z\); wrench: its moments .* -z\)",
        ),
        (
            lambda x: x * [-1, 1, 1, 1, 1, 1],
            r"wrench: its forces fit the acceleration as \(-x, y, z\)",
        ),
        (
            lambda x: x[:, [0, 1, 2, 5, 4, 3]],
            r"wrench: its moments fit the acceleration as \(z, y, x\)",
        ),
        (lambda x: 0 * x + 1.0, "wrench: dead"),
    ],
)
def test_a_wrench_of_other_axes_is_named(change: Change, text: str) -> None:
    found = told(with_values(driven(), "wrench", change))
    assert re.search(text, found), found


def test_a_wrench_in_the_world_frame_is_named() -> None:
    channel = driven().channels["wrench"]
    t = np.arange(0.0, driven().span[1], 0.05)  # turned with the vehicle, while it is held
    held = channel.values[np.searchsorted(channel.t, t, side="right") - 1]
    R = rotations(driven().channels["attitude"], t)
    outside = np.hstack([np.einsum("nij,nj->ni", R, held[:, part]) for part in (FORCES, MOMENTS)])
    text = told(changed(driven(), "wrench", t=t, values=outside))
    assert "wrench: its forces fit the acceleration as in W" in text, text


def test_a_robot_that_rests_at_first_has_lost_no_samples() -> None:
    resting = with_values(
        moved(), "linear_velocity", lambda x: x * (np.arange(len(x)) >= 3)[:, None]
    )
    slow = with_values(
        resting, "linear_velocity", lambda x: x * np.minimum(np.arange(len(x)) / 2000, 1)[:, None]
    )
    assert "exactly zero" not in told(slow)
    holes = with_values(
        moved(), "linear_velocity", lambda x: x * (np.arange(len(x)) % 50 > 0)[:, None]
    )
    assert "15 of 800 samples are exactly zero" in told(holes)  # of the first it may be so


@pytest.mark.sampled
@pytest.mark.parametrize("name", ["position", "attitude", "linear_velocity", "angular_velocity"])
def test_a_sensor_that_stops_while_the_vehicle_moves_is_named(name: str) -> None:
    stopped = with_values(
        moved(), name, lambda x: np.where(np.arange(len(x))[:, None] < 400, x, x[400])
    )
    assert re.search(rf"{name}: stays exactly as it is from 20.0 to 40.0 s", told(stopped)), told(
        stopped
    )


def test_commands_that_are_all_zero_are_doubtful_where_the_vehicle_never_comes_to_rest() -> None:
    silent = with_values(driven(), "wrench", lambda x: 0 * x)
    assert (
        told(silent) == "wrench: zero throughout, and the vehicle moves to the end: what drove it?"
    )
    resting = with_values(
        silent, "linear_velocity", lambda x: x * np.exp(-np.arange(len(x)) / 50)[:, None]
    )
    assert "zero throughout" not in told(resting)


def test_a_vehicle_that_rolls_over_is_not_taken_for_one_with_z_down() -> None:
    good = recorded()
    attitude = good.channels["attitude"]
    t = attitude.t
    roll = np.pi * np.clip((t - t[0]) / 2.0 - 1.0, 0.0, 1.0)  # on its back from 4 s on, of 40 s
    turned = np.column_stack([np.sin(roll / 2), 0 * t, 0 * t, np.cos(roll / 2)])
    alone = Recording(name="r", channels={"attitude": replace(attitude, values=turned)})
    assert "on its back" not in told(alone)
    assert "on its back" in told(
        with_values(alone, "attitude", lambda x: np.tile([1.0, 0.0, 0.0, 0.0], (len(x), 1)))
    )


@pytest.mark.sampled
@pytest.mark.parametrize("name", ["linear_velocity", "angular_velocity", "specific_force"])
@pytest.mark.parametrize("share", [0.4, 0.8])
def test_a_sensor_at_the_end_of_its_range_is_named(name: str, share: float) -> None:
    limit = share * np.abs(moved().channels[name].values[:, 0]).max()
    assert f"{name}: x is never beyond" in told(
        with_values(moved(), name, lambda x: np.clip(x, -limit, limit))
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["linear_velocity", "angular_velocity", "specific_force"])
def test_readings_with_few_digits_or_held_for_some_samples_are_not_saturated(name: str) -> None:
    for digits in (1e-3, 1e-2, 5e-2):
        rounded = with_values(moved(), name, lambda x, d=digits: d * np.round(x / d))  # type: ignore[misc]
        held = with_values(
            moved(),
            name,
            lambda x, d=digits: np.repeat(d * np.round(x[::3] / d), 3, axis=0)[: len(x)],
        )  # type: ignore[misc]
        assert "saturated" not in told(rounded) + told(held)
