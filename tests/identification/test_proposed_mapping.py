"""Mappings are proposed by names and by what values say: recordings come back as they were written,
whatever was done to them.
"""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from motions import DOWN, recorded
from proposals import read_as_proposed
from px4 import write_ulog
from typer.testing import CliRunner

from uvms_ocp.cli.commands import app
from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification import message_columns
from uvms_ocp.identification.channel_mapping import read_mapping
from uvms_ocp.identification.messages import messages as reader
from uvms_ocp.identification.proposed_mapping import propose_mapping
from uvms_ocp.identification.reading import read_recording
from uvms_ocp.identification.recording import (
    CHANNEL_KINDS,
    Channel,
    Recording,
)
from uvms_ocp.identification.resampling import rotations
from uvms_ocp.identification.tables import write_columns, write_recording

GOOD = recorded()


def columns_of(recording: Recording, names: Mapping[str, str]) -> dict[str, np.ndarray]:
    """Columns at the times of the first channel, by the names of each channel's columns."""
    t = next(iter(recording.channels.values())).t
    found = {"t": t}
    for name, said in names.items():
        channel = recording.channels[name]
        columns = np.column_stack([np.interp(t, channel.t, column) for column in channel.values.T])
        found |= dict(zip(said.split(), columns.T, strict=True))
    return found


@pytest.mark.sampled
@pytest.mark.parametrize("kind", CHANNEL_KINDS)
def test_a_recording_that_we_write_is_proposed_as_it_was(kind: str, tmp_path: Path) -> None:
    width = len(CHANNEL_KINDS[kind].columns) or 6
    t = np.arange(0.0, 20.0, 0.1)
    values = 0.4 * np.sin(0.5 * t[:, None] + np.arange(width)) + (
        9.81 * np.eye(3)[2] if kind == "specific_force" else 0.0
    )
    if kind == "attitude":
        values = 0.1 * values + np.eye(4)[3]
        values /= np.linalg.norm(values, axis=1, keepdims=True)
    if kind == "thrust":
        values *= 30.0
    if kind == "position":
        values -= 5.0
    others = {
        name: proposed
        for name, proposed in GOOD.channels.items()
        if kind in ("wrench", "thrust") and name != kind
    }
    write_recording(
        Recording(name="dive", channels={kind: Channel(t=t, values=values), **others}),
        tmp_path / "dive.csv",
    )
    proposed = read_as_proposed(tmp_path / "dive.csv").channels
    np.testing.assert_allclose(proposed[kind].values, values, atol=1e-9)
    assert set(proposed) == {kind, *others}


OTHERS: dict[
    str, tuple[dict[str, str], Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]], str]
] = {
    "millimetres": (
        {"linear_velocity": "vx vy vz"},
        lambda of: {n: x * (1 if n == "t" else 1e4) for n, x in of.items()},
        "mm/s",
    ),
    "sentinels": (
        {"linear_velocity": "u v w"},
        lambda of: {
            n: x if n == "t" else np.where(np.arange(len(x)) % 20 == 3, -32.768, x)
            for n, x in of.items()
        },
        "missing: [-32.768]",
    ),
    "microseconds": (
        {"position": "x y z"},
        lambda of: of | {"t": np.round(1e6 * of["t"])},
        "time_unit: us",
    ),
    "named microseconds": (
        {"position": "x y z"},
        lambda of: {"TimeUS": np.round(1e6 * of["t"]), **of},
        "time: TimeUS",
    ),
    "depth": ({"position": "east north depth"}, lambda of: of | {"depth": -of["depth"]}, "-depth"),
}


@pytest.mark.sampled
@pytest.mark.parametrize(("names", "spoiled", "said"), OTHERS.values(), ids=OTHERS)
def test_what_values_say_is_cured_and_its_evidence_stands_beside_it(
    names: dict[str, str],
    spoiled: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]],
    said: str,
    tmp_path: Path,
) -> None:
    columns = spoiled(columns_of(GOOD, names))
    write_columns(
        tmp_path / "dive.csv",
        {
            name: column
            for name, column in columns.items()
            if name != "t" or "TimeUS" not in columns
        },
    )
    text = propose_mapping(tmp_path / "dive.csv")
    (name,) = names
    channel = next(iter(read_as_proposed(tmp_path / "dive.csv").channels.values()))
    assert said in text
    assert f"{name}: {{" in text
    assert "    # by names: " in text
    wanted = GOOD.channels[name]
    scale = 10.0 if said == "mm/s" else 1.0
    np.testing.assert_allclose(channel.values[0], scale * wanted.values[0], atol=1e-6)
    assert channel.rate == pytest.approx(wanted.rate, rel=0.1)


SIX = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
PLAIN: dict[str, dict[str, tuple[float, ...]]] = {
    "u": {"linear_velocity": (1.0, 0.0, 0.0)},
    "speed [m/s]": {"linear_velocity": (1.0, 0.0, 0.0)},
    "w": {"linear_velocity": (0.0, 0.0, 1.0)},
    "surge_velocity sway_velocity heave_velocity yaw_rate": {
        "linear_velocity": (1.0, 2.0, 3.0),
        "angular_velocity": (0.0, 0.0, 4.0),
    },
    "speed w": {"linear_velocity": (1.0, 0.0, 0.0)},
    "u v u_ref HeadingSet heading": {
        "linear_velocity": (1.0, 2.0, 0.0),
        "attitude": (0.0, 0.0, 5.0),
    },
    "x_pos y_pos depth_setpoint": {"position": (1.0, 2.0, 0.0)},
    "x y theta": {"position": (1.0, 2.0, 0.0), "attitude": (0.0, 0.0, 3.0)},
    "u_velo vm_velo psi_hat r_angvelo": {
        "linear_velocity": (1.0, 2.0, 0.0),
        "attitude": (0.0, 0.0, 3.0),
        "angular_velocity": (0.0, 0.0, 4.0),
    },
    "orientation.x orientation.y orientation.z": {"attitude": (1.0, 2.0, 3.0)},
    "u v w p q r": {"linear_velocity": (1.0, 2.0, 3.0), "angular_velocity": (4.0, 5.0, 6.0)},
    "u v r": {"linear_velocity": (1.0, 2.0, 0.0), "angular_velocity": (0.0, 0.0, 3.0)},
    "u force": {"linear_velocity": (1.0, 0.0, 0.0), "wrench": (2.0, 0.0, 0.0, 0.0, 0.0, 0.0)},
    "speed F [N]": {"linear_velocity": (1.0, 0.0, 0.0), "wrench": (2.0, 0.0, 0.0, 0.0, 0.0, 0.0)},
    "r torque": {"angular_velocity": (0.0, 0.0, 1.0), "wrench": (0.0, 0.0, 0.0, 0.0, 0.0, 2.0)},
    "u tau": {"linear_velocity": (1.0, 0.0, 0.0), "wrench": (2.0, 0.0, 0.0, 0.0, 0.0, 0.0)},
    "X Y Z K M N": {"wrench": SIX},
    "x y z X Y N": {"position": (1.0, 2.0, 3.0), "wrench": (4.0, 5.0, 0.0, 0.0, 0.0, 6.0)},
    "x y z n": {"position": (1.0, 2.0, 3.0)},
    "tau_X tau_Y tau_N": {"wrench": (1.0, 2.0, 0.0, 0.0, 0.0, 3.0)},
    "tau_u tau_v tau_w tau_p tau_q tau_r": {"wrench": SIX},
    "tau_surge tau_yaw": {"wrench": (1.0, 0.0, 0.0, 0.0, 0.0, 2.0)},
    "tau1 tau2 tau3 tau4 tau5 tau6": {"wrench": SIX},
    "fx fy fz tx ty tz": {"wrench": SIX},
    "force_x force_y force_z torque_x torque_y torque_z": {"wrench": SIX},
    "u1 u2 u3 u4": {"propeller_commands": (1.0, 2.0, 3.0, 4.0)},
    "cmd_0 cmd_1 u v": {"propeller_commands": (1.0, 2.0), "linear_velocity": (3.0, 4.0, 0.0)},
    "depth": {"position": (0.0, 0.0, -1.0)},
    "heading": {"attitude": (0.0, 0.0, 1.0)},
    "east north depth": {"position": (1.0, 2.0, -3.0)},
    "east north depth heading": {"position": (2.0, 1.0, 3.0), "attitude": (0.0, 0.0, 4.0)},
    "east north up hdg": {"position": (2.0, 1.0, -3.0), "attitude": (0.0, 0.0, 4.0)},
}
"""Names of columns, and the places, from 1, that each number of a channel has among them, negative
for the opposite; 0: none.
"""


@pytest.mark.parametrize("names", PLAIN)
def test_plain_names_of_columns_are_known(names: str, tmp_path: Path) -> None:
    columns = re.findall(r"\S+(?: \[\S+\])?", names)
    t = np.arange(0.0, 20.0, 0.1)
    write_columns(
        tmp_path / "tow.csv", {"t": t, **{name: np.sin(t + k) for k, name in enumerate(columns)}}
    )
    proposed = yaml.safe_load(propose_mapping(tmp_path / "tow.csv"))["channels"]
    signed = {name: k for k, name in enumerate(columns, start=1)} | {
        f"-{name}": -k for k, name in enumerate(columns, start=1)
    }
    assert {
        name: tuple(signed.get(one, one) for one in each["columns"])
        for name, each in proposed.items()
    } == PLAIN[names]


def test_a_heading_is_clockwise_from_north(tmp_path: Path) -> None:
    t = np.arange(0.0, 60.0, 0.05)
    heading = 0.6 * np.sin(0.3 * t) + 0.05 * t
    north, east = (np.cumsum(0.05 * 0.4 * way(heading)) for way in (np.cos, np.sin))
    columns = {"t": t, "east": east, "north": north, "depth": 5.0 + 0.01 * t, "heading": heading}
    write_columns(tmp_path / "swim.csv", columns)
    (tmp_path / "mapping.yaml").write_text(propose_mapping(tmp_path / "swim.csv"), encoding="utf-8")
    read = read_recording(tmp_path / "swim.csv", read_mapping(tmp_path / "mapping.yaml"))
    way = np.gradient(read.channels["position"].values, 0.05, axis=0)
    ahead = np.array(
        [pin.Quaternion(q).toRotationMatrix()[:, 0] for q in read.channels["attitude"].values]
    )
    np.testing.assert_allclose(np.sum(way * ahead, axis=1)[2:-2], 0.4, rtol=0.01)


@pytest.mark.slow
def test_of_mavlink_only_messages_are_proposed_whose_meaning_is_laid_down(tmp_path: Path) -> None:
    """What is sent once, remote control and magnetic fields are no channels of it; axes are those
    of its protocol.
    """
    mavlink = pytest.importorskip(
        "pymavlink.dialects.v20.ardupilotmega", reason='needs pip install "uvms-ocp[mavlink]"'
    )
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    with (tmp_path / "dive.tlog").open("wb") as file:
        for k in range(200):
            t = 0.1 * k
            ms = 100 * k
            sent = [
                sender.attitude_encode(
                    ms, 0.1 * np.sin(t), 0.05, 0.3 * t, 0.1 * np.cos(t), 0.0, 0.3
                ),
                sender.local_position_ned_encode(
                    ms, np.sin(t), 0.2 * t, 3.0 + 0.1 * t, np.cos(t), 0.2, 0.1
                ),
                sender.servo_output_raw_encode(
                    1000 * ms, 0, *(1500 + 10 * (k % 20) + one for one in range(8))
                ),
                sender.rc_channels_raw_encode(ms, 0, *(8 * [1500 + k % 7]), 100),
                *(
                    [
                        sender.home_position_encode(
                            0, 0, 0, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0
                        )
                    ]
                    if k == 3
                    else []
                ),
            ]
            for one in sent:
                file.write(
                    (1_700_000_000_000_000 + 1000 * ms).to_bytes(8, "big") + one.pack(sender)
                )
    proposed = yaml.safe_load(propose_mapping(tmp_path / "dive.tlog"))["channels"]
    topics = {name: entry["topic"] for name, entry in proposed.items()}
    assert topics == {
        "attitude": "ATTITUDE",
        "angular_velocity": "ATTITUDE",
        "linear_velocity": "LOCAL_POSITION_NED",
        "position": "LOCAL_POSITION_NED",
        "propeller_commands": "SERVO_OUTPUT_RAW",
    }
    read = read_as_proposed(tmp_path / "dive.tlog").channels
    assert read["position"].values[-1] == pytest.approx((np.sin(19.9), -3.98, -4.99), abs=1e-4)
    assert read["angular_velocity"].values[0] == pytest.approx((0.1, 0.0, -0.3), abs=1e-6)
    assert read["propeller_commands"].values[0] == pytest.approx(0.0025 * np.arange(8), abs=1e-9)


def test_of_px4_channels_come_back_by_its_own_topics_and_axes(tmp_path: Path) -> None:
    pytest.importorskip("pyulog", reason='needs pip install "uvms-ocp[ulog]"')
    t = GOOD.channels["position"].t
    position, attitude, rates = (
        GOOD.channels[name].values for name in ("position", "attitude", "angular_velocity")
    )
    local = dict(zip(("x", "y", "z"), (position @ DOWN).T, strict=True))
    moving = np.gradient(position, t, axis=0) @ DOWN
    local |= dict(zip(("vx", "vy", "vz"), moving.T, strict=True))
    pulses = 1500.0 + 300.0 * np.sin(t[:, None] + np.arange(8))
    topics = [
        ("vehicle_attitude", t, {"q": (attitude * [1, -1, -1, 1])[:, [3, 0, 1, 2]]}),
        ("vehicle_angular_velocity", t, {"xyz": rates @ DOWN, "xyz_derivative": 0.0 * rates}),
        ("vehicle_local_position", t, local),
        ("vehicle_local_position_setpoint", t, local),
        ("actuator_outputs", t, {"output": pulses}),
    ]
    write_ulog(tmp_path / "dive.ulg", topics)
    read = read_as_proposed(tmp_path / "dive.ulg").channels
    assert set(read) == {
        "position",
        "attitude",
        "linear_velocity",
        "angular_velocity",
        "propeller_commands",
    }
    np.testing.assert_allclose(read["position"].values, position, atol=1e-5)
    np.testing.assert_allclose(
        np.abs((read["attitude"].values * attitude).sum(axis=1)), 1.0, atol=1e-5
    )
    np.testing.assert_allclose(read["angular_velocity"].values, rates, atol=1e-5)
    np.testing.assert_allclose(
        read["linear_velocity"].values[9:-9],
        GOOD.channels["linear_velocity"].values[9:-9],
        atol=0.01,
    )
    np.testing.assert_allclose(
        read["propeller_commands"].values, 0.0025 * (pulses - 1500.0), atol=1e-6
    )


def test_numbers_that_stand_for_nothing_measured_are_said(tmp_path: Path) -> None:
    t = np.arange(0.0, 20.0, 0.1)
    write_columns(tmp_path / "tow.csv", {"t": t, "u": np.sin(t), "force": np.cos(t)})
    text = propose_mapping(tmp_path / "tow.csv")
    assert text.count("# not measured: what 0.0 stands for") == 2
    read = read_as_proposed(tmp_path / "tow.csv").channels
    np.testing.assert_allclose(read["wrench"].values[:, 0], np.cos(t), atol=1e-9)


def test_down_axes_and_degrees_are_seen_by_what_channels_say_of_each_other(tmp_path: Path) -> None:
    """Velocity along axes with z down fits the rate of the position in no other way."""
    names = {"position": "x y z", "attitude": "qx qy qz qw"}
    columns = columns_of(GOOD, names)
    columns |= dict(
        zip("xyz", (np.column_stack([columns[axis] for axis in "xyz"]) @ DOWN).T, strict=True)
    )
    write_columns(tmp_path / "dive.csv", columns)
    assert "world: NED" in propose_mapping(tmp_path / "dive.csv")


FELT = 9.81 * rotations(GOOD.channels["attitude"], GOOD.channels["position"].t)[:, 2]
WHOLE = Recording(
    name="dive",
    channels={
        **GOOD.channels,
        "specific_force": Channel(t=GOOD.channels["position"].t, values=FELT),
    },
)
NAMES = {
    "position": "x y z",
    "attitude": "qx qy qz qw",
    "linear_velocity": "vx vy vz",
    "angular_velocity": "gyro_x gyro_y gyro_z",
}
NAMES |= {"specific_force": "acc_x acc_y acc_z"}
CONVENTIONS: dict[str, tuple[str, Callable[[np.ndarray], np.ndarray], tuple[str, ...]]] = {
    "NED and FRD": (
        "world: NED, body: FRD",
        lambda q: q * [1, -1, -1, 1],
        ("position", *list(NAMES)[2:]),
    ),
    "NED and FLU": ("world: NED", lambda q: q[:, [3, 2, 1, 0]] * [1, -1, 1, -1], ("position",)),
    "ENU and FRD": ("body: FRD", lambda q: q[:, [3, 2, 1, 0]] * [1, 1, -1, -1], tuple(NAMES)[2:]),
    "NED and FRD, attitude alone": ("world: NED, body: FRD", lambda q: q * [1, -1, -1, 1], ()),
    "from W to B": ("[-qx, -qy, -qz, qw]", lambda q: q * [-1, -1, -1, 1], ()),
    "w first": ("format: quaternion wxyz", lambda q: q[:, [3, 0, 1, 2]], ()),
    "an accelerometer with z down": ("body: FRD", lambda q: q, ("specific_force",)),
    "a gyroscope with z down": ("body: FRD", lambda q: q, ("angular_velocity",)),
    "velocity along other axes": ("[-vy, vx, vz]", lambda q: q, ()),
}
"""What is proposed, how the attitude is written, and which other channels along axes with z
down.
"""


@pytest.mark.slow
@pytest.mark.parametrize("convention", CONVENTIONS)
def test_conventions_of_axes_come_back_as_channels_tell_them_of_each_other(
    convention: str, tmp_path: Path
) -> None:
    said, change, down = CONVENTIONS[convention]
    columns = columns_of(WHOLE, NAMES)
    for name in down:
        columns |= dict(
            zip(
                NAMES[name].split(),
                (np.column_stack([columns[one] for one in NAMES[name].split()]) @ DOWN).T,
                strict=True,
            )
        )
    columns |= dict(
        zip(
            NAMES["attitude"].split(),
            change(np.column_stack([columns[f"q{axis}"] for axis in "xyzw"])).T,
            strict=True,
        )
    )
    if convention == "velocity along other axes":
        columns["vx"], columns["vy"] = columns["vy"].copy(), -columns["vx"]
    write_columns(tmp_path / "dive.csv", columns)
    text = propose_mapping(tmp_path / "dive.csv")
    assert said in text
    read = read_as_proposed(tmp_path / "dive.csv").channels
    for name in NAMES:
        wanted = WHOLE.channels[name].values
        found = (
            read[name].values
            if name != "attitude"
            else read[name].values * np.sign(np.sum(read[name].values * wanted, axis=1))[:, None]
        )
        np.testing.assert_allclose(found, wanted, atol=1e-6, err_msg=name)


def test_numbers_of_a_quaternion_have_the_order_with_which_the_rest_agrees(tmp_path: Path) -> None:
    columns = columns_of(WHOLE, {**NAMES, "attitude": "q0 q1 q2 q3"})
    write_columns(tmp_path / "dive.csv", columns)
    assert "columns: [q0, q1, q2, q3], format: quaternion xyzw" in propose_mapping(
        tmp_path / "dive.csv"
    )


ARRAYS = {
    "position": "pos",
    "attitude": "quat",
    "linear_velocity": "vel",
    "angular_velocity": "gyro",
    "specific_force": "accel",
}


@pytest.mark.sampled
@pytest.mark.parametrize(
    "names", [ARRAYS, {name: name for name in ARRAYS}], ids=["short", "in full"]
)
def test_arrays_have_columns_by_number_and_the_order_of_a_quaternion_is_looked_for(
    names: dict[str, str], tmp_path: Path
) -> None:
    arrays = {said: WHOLE.channels[name].values for name, said in names.items()}
    np.savez(tmp_path / "dive.npz", time=WHOLE.channels["position"].t, **arrays)
    read = read_as_proposed(tmp_path / "dive.npz").channels
    assert set(read) == set(names)
    for name in names:
        np.testing.assert_allclose(
            read[name].values, WHOLE.channels[name].values, atol=1e-9, err_msg=name
        )


def test_positions_and_velocities_of_fossen_are_known_as_arrays(tmp_path: Path) -> None:
    t = np.arange(0.0, 20.0, 0.1)
    eta = 1e-3 * np.column_stack([np.sin(t + k) for k in range(6)])
    np.savez(tmp_path / "dive.npz", t=t, eta=eta, nu=2.0 * eta)
    proposed = yaml.safe_load(propose_mapping(tmp_path / "dive.npz"))["channels"]
    assert {
        name: [one.strip("-") for one in each["columns"]] for name, each in proposed.items()
    } == {
        "linear_velocity": ["nu[0]", "nu[1]", "nu[2]"],
        "angular_velocity": ["nu[3]", "nu[4]", "nu[5]"],
        "attitude": ["eta[3]", "eta[4]", "eta[5]"],
        "position": ["eta[0]", "eta[1]", "eta[2]"],
    }


def test_what_nothing_in_a_file_tells_is_said_to_be_assumed(tmp_path: Path) -> None:
    write_columns(
        tmp_path / "dive.csv",
        columns_of(GOOD, {"attitude": "qx qy qz qw", "angular_velocity": "p q r"}),
    )
    assert (
        propose_mapping(tmp_path / "dive.csv").count("    # assumed: x ahead, y to the left, z up")
        == 1
    )
    write_columns(tmp_path / "dive.csv", columns_of(WHOLE, NAMES))
    assert "# assumed" not in propose_mapping(tmp_path / "dive.csv")


def test_units_at_the_end_of_names_are_units(tmp_path: Path) -> None:
    names = {"position": "x_m y_m z_m", "linear_velocity": "vel_x_mm_s vel_y_mm_s vel_z_mm_s"}
    columns = columns_of(GOOD, names)
    columns |= {name: 1e3 * columns[name] for name in names["linear_velocity"].split()}
    write_columns(tmp_path / "dive.csv", columns)
    proposed = yaml.safe_load(propose_mapping(tmp_path / "dive.csv"))["channels"]
    assert proposed["linear_velocity"]["unit"] == "mm/s"
    assert proposed["position"]["columns"] == ["x_m", "y_m", "z_m"]
    read = read_as_proposed(tmp_path / "dive.csv").channels
    np.testing.assert_allclose(
        read["linear_velocity"].values, GOOD.channels["linear_velocity"].values, atol=1e-9
    )


def test_velocities_to_the_north_are_no_positions_and_angles_beside_them_are_from_there(
    tmp_path: Path,
) -> None:
    t = np.arange(0.0, 20.0, 0.1)
    columns = {
        name: 0.1 * np.sin(t + k)
        for k, name in enumerate(("roll", "pitch", "yaw", "pos_n", "pos_e", "depth"))
    }
    columns |= {
        name: 0.1 * np.cos(t + k) for k, name in enumerate(("vel_n", "vel_e", "vel_d"), start=3)
    }
    write_columns(tmp_path / "dive.csv", {"t": t, **columns})
    proposed = yaml.safe_load(propose_mapping(tmp_path / "dive.csv"))["channels"]
    assert proposed["linear_velocity"]["columns"] == ["vel_n", "vel_e", "vel_d"]
    assert proposed["position"]["columns"] == ["pos_n", "pos_e", "depth"]
    assert all(entry["world"] == "NED" for entry in proposed.values())
    assert proposed["attitude"]["body"] == "FRD"


def test_whole_seconds_and_nanoseconds_in_two_columns_are_one_time(tmp_path: Path) -> None:
    columns = columns_of(GOOD, {"position": "x y z"})
    stamps = {
        "header.stamp.sec": np.floor(columns["t"]),
        "header.stamp.nanosec": np.round(1e9 * (columns["t"] % 1.0)),
    }
    write_columns(tmp_path / "dive.csv", stamps | {name: columns[name] for name in "xyz"})
    assert "time: [header.stamp.sec, header.stamp.nanosec]" in propose_mapping(
        tmp_path / "dive.csv"
    )
    read = read_as_proposed(tmp_path / "dive.csv").channels["position"]
    np.testing.assert_allclose(read.t, GOOD.channels["position"].t, atol=1e-6)


def test_values_that_stand_for_nothing_in_angles_are_left_out(tmp_path: Path) -> None:
    t = np.arange(0.0, 20.0, 0.1)
    lost = np.arange(len(t)) % 23 == 7
    angles = {
        name: np.where(lost, -999.0, 20.0 * np.sin(t + k))
        for k, name in enumerate(("roll", "pitch", "yaw"))
    }
    write_columns(tmp_path / "dive.csv", {"t": t, **angles})
    text = propose_mapping(tmp_path / "dive.csv")
    assert "unit: deg" in text
    assert "missing: [-999]" in text
    assert len(read_as_proposed(tmp_path / "dive.csv").channels["attitude"].t) == (~lost).sum()


@pytest.mark.parametrize("name", ["thruster_{}_pwm", "T{} [us]", "pwm{}"])
def test_pulses_of_0_are_none(name: str, tmp_path: Path) -> None:
    t = np.arange(0.0, 20.0, 0.1)
    pulses = {
        name.format(k): np.where(t < 3.0, 0.0, 1500 + 300 * np.sin(t + k)) for k in range(1, 7)
    }
    write_columns(tmp_path / "a.csv", {"t": t, **pulses})
    channel = read_as_proposed(tmp_path / "a.csv").channels["propeller_commands"]
    np.testing.assert_allclose(channel.values[:, 0], 0.75 * np.sin(t[t >= 3.0] + 1), atol=1e-9)


def test_shares_in_percent_become_commands_of_propellers(tmp_path: Path) -> None:
    t = np.arange(0.0, 20.0, 0.1)
    write_columns(
        tmp_path / "a.csv",
        {"t": t, **{f"throttle_{k} [%]": 80.0 * np.sin(t + k) for k in range(6)}},
    )
    channel = read_as_proposed(tmp_path / "a.csv").channels["propeller_commands"]
    np.testing.assert_allclose(channel.values[:, 0], 0.8 * np.sin(t), atol=1e-9)


def test_some_of_many_thrusters_are_not_proposed_for_all(tmp_path: Path) -> None:
    names = [
        f"{place}_{side}" for place in ("front", "rear", "vertical") for side in ("left", "right")
    ]
    write_columns(
        tmp_path / "a.csv",
        {
            "t": np.arange(9.0),
            "depth": np.arange(9.0),
            **dict.fromkeys(names, 1500.0 + np.arange(9.0)),
        },
    )
    assert set(yaml.safe_load(propose_mapping(tmp_path / "a.csv"))["channels"]) == {"position"}


def test_pulse_widths_become_commands_of_propellers(tmp_path: Path) -> None:
    t = np.arange(0.0, 20.0, 0.1)
    write_columns(
        tmp_path / "a.csv", {"t": t, **{f"motor{k}": 1500 + 300 * np.sin(t + k) for k in range(6)}}
    )
    channel = read_as_proposed(tmp_path / "a.csv").channels["propeller_commands"]
    np.testing.assert_allclose(channel.values[:, 0], 0.75 * np.sin(t), atol=1e-9)


def test_pulse_widths_of_a_wider_range_become_commands_within_1(tmp_path: Path) -> None:
    t = np.arange(0.0, 20.0, 0.1)
    write_columns(
        tmp_path / "a.csv",
        {"t": t, **{f"PWM_{side}": 1500 + 500 * np.sin(t + k) for k, side in enumerate("LR")}},
    )
    channel = read_as_proposed(tmp_path / "a.csv").channels["propeller_commands"]
    np.testing.assert_allclose(channel.values[:, 0], np.sin(t), atol=1e-9)


def test_a_boat_with_its_heading_from_north_and_positions_that_are_so_too_is_read_as_it_went(
    tmp_path: Path,
) -> None:
    """Speed is along the heading: where x is north and y east, both are told by it, though nothing
    says so.
    """
    t = np.arange(0.0, 120.0, 0.1)
    heading = 60.0 + 50.0 * np.sin(0.1 * t)
    speed = 0.9 + 0.2 * np.sin(0.3 * t)
    x, y = (np.cumsum(0.1 * speed * way(np.deg2rad(heading))) for way in (np.cos, np.sin))
    write_columns(
        tmp_path / "a.csv",
        {"t": t, "x": x, "y": y, "Heading": heading, "Speed": speed, "SpeedSet": 0.0 * t + 1.0},
    )
    read = read_as_proposed(tmp_path / "a.csv").channels
    ahead = rotations(read["attitude"], t)[:, :, 0]
    way = np.gradient(read["position"].values, 0.1, axis=0)
    np.testing.assert_allclose((way * ahead).sum(axis=1)[3:-3], speed[3:-3], atol=0.02)


def test_a_pressure_is_a_depth_by_its_size(tmp_path: Path) -> None:
    t = np.arange(0.0, 60.0, 0.1)
    depth = 3.0 + np.sin(0.2 * t)
    write_columns(
        tmp_path / "a.csv",
        {"t": t, "x": np.sin(0.1 * t), "y": 0.1 * t, "press": 1013.0 + depth / 0.0102},
    )
    np.testing.assert_allclose(
        read_as_proposed(tmp_path / "a.csv").channels["position"].values[:, 2], -depth, atol=0.005
    )


def test_messages_written_to_a_table_have_the_time_of_their_header(tmp_path: Path) -> None:
    columns = columns_of(GOOD, {"position": "field.position.x field.position.y field.position.z"})
    stamps = {"%time": columns["t"] + 7.0, "field.header.stamp": columns["t"]}
    write_columns(
        tmp_path / "dive.csv", stamps | {name: x for name, x in columns.items() if name != "t"}
    )
    assert "time: field.header.stamp" in propose_mapping(tmp_path / "dive.csv")


def test_messages_have_topics_and_fields(tmp_path: Path) -> None:
    path = tmp_path / "dvl.json"
    rows = [
        {
            "type": "velocity",
            "time": 0.1 * k,
            "vx": 0.3 * np.sin(0.05 * k),
            "vy": 0.1,
            "vz": 0.01 * k,
            "valid": True,
        }
        for k in range(99)
    ]
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert (
        "linear_velocity: {topic: velocity, time: time, columns: [vx, vy, vz]}"
        in propose_mapping(path)
    )


def test_messages_of_data_alone_are_what_their_topic_is_called(tmp_path: Path) -> None:
    """As depth and commands of thrusters are in standard messages of ROS."""
    t = np.arange(0.0, 20.0, 0.1)
    rows = [{"type": "/rov/depth", "time": x, "data": 3.0 + 0.1 * np.sin(x)} for x in t]
    rows += [
        {
            "type": "/rov/thruster_cmds",
            "time": x,
            "data": [1500 + 300 * np.sin(x + k) for k in range(6)],
        }
        for x in t
    ]
    (tmp_path / "dive.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert (
        "position: {topic: /rov/depth, time: time, columns: [0.0, 0.0, -data]}"
        in propose_mapping(tmp_path / "dive.jsonl")
    )
    read = read_as_proposed(tmp_path / "dive.jsonl").channels
    np.testing.assert_allclose(
        read["propeller_commands"].values[:, 1], 0.75 * np.sin(t + 1), atol=1e-9
    )


def test_messages_are_read_once_for_all_cures_that_leave_them_as_they_are_and_anew_once_they_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "dvl.json"
    read = []
    monkeypatch.setattr(
        message_columns, "messages", lambda *given: read.append(given[1]) or reader(*given)
    )
    rows = [
        {"type": "v", "time": 0.1 * k, "vx": 300.0 * np.sin(0.1 * k), "vy": 9e3, "vz": 5.0 * k}
        for k in range(99)
    ]
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    first = propose_mapping(path)
    assert "unit: mm/s" in first
    assert len(read) == 1
    path.write_text(
        "".join(
            json.dumps({**row, "vx": row["vx"] * 2e-3, "vy": 0.3, "vz": 0.1}) + "\n" for row in rows
        )
    )
    assert "unit: mm/s" not in propose_mapping(path)
    assert len(read) == 2


def test_a_file_without_a_name_that_is_known_is_one_line_with_those_that_there_are(
    tmp_path: Path,
) -> None:
    write_columns(tmp_path / "a.csv", {"t": np.arange(9.0), "lat": np.ones(9), "lon": np.ones(9)})
    with pytest.raises(
        InvalidInput,
        match=r"a\.csv: nothing in it has a name that is known: t, lat, lon; write a mapping",
    ):
        propose_mapping(tmp_path / "a.csv")


def test_the_command_prints_what_check_recording_takes(tmp_path: Path) -> None:
    write_recording(
        replace(GOOD, channels={"position": GOOD.channels["position"]}), tmp_path / "a.csv"
    )
    outcome = CliRunner().invoke(app, ["map", str(tmp_path / "a.csv")])
    assert outcome.exit_code == 0
    (tmp_path / "map.yaml").write_text(outcome.stdout)
    checked = CliRunner().invoke(
        app, ["check-recording", str(tmp_path / "a.csv"), "--mapping", str(tmp_path / "map.yaml")]
    )
    assert checked.exit_code == 0
    assert "position" in checked.stdout


@pytest.mark.sampled
@pytest.mark.parametrize("zeros", [1, None], ids=["before the first fix", "always"])
def test_a_channel_that_cannot_be_read_leaves_the_evidence_of_the_others(
    zeros: int | None, tmp_path: Path
) -> None:
    columns = columns_of(
        GOOD, {"attitude": "qx qy qz qw", "angular_velocity": "gyro_x gyro_y gyro_z"}
    )
    for name in ("qx", "qy", "qz", "qw"):
        columns[name][:zeros] = 0.0
    write_columns(tmp_path / "dive.csv", columns)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        text = propose_mapping(tmp_path / "dive.csv")
    evidence = dict(
        zip(
            re.findall(r"^  (\w+): {", text, re.M),
            re.split(r"^  \w+: {", text, flags=re.M)[1:],
            strict=True,
        )
    )
    assert "    # by names: " in evidence["angular_velocity"]
    assert ("# doubtful: attitude: NaN in every row" in evidence["attitude"]) == (zeros is None)
    assert not re.search(r"by names: *$", text, re.M)


LAYOUTS = (
    ("position", "attitude"),
    ("attitude", "position", "linear_velocity"),
    ("position", "attitude", "linear_velocity", "angular_velocity", "specific_force", "thrust"),
    ("thrust", "specific_force", "angular_velocity", "attitude", "position"),
    ("linear_velocity", "angular_velocity", "position", "attitude", "thrust"),
)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("layout", LAYOUTS, ids="-".join)
def test_columns_without_names_are_known_by_their_values(
    layout: tuple[str, ...], seed: int, tmp_path: Path
) -> None:
    """Of drawn motion and commands, beside a number of each row, a column that stays, and one that
    is empty.
    """
    rng = np.random.default_rng(seed)
    good = recorded(seed=seed)
    t = good.channels["position"].t
    felt = 9.81 * rotations(good.channels["attitude"], t)[:, 2]
    told = np.repeat(8.0 * rng.normal(size=(len(t) // 20 + 1, 6)), 20, axis=0)[: len(t)]
    values = {name: channel.values for name, channel in good.channels.items()} | {
        "specific_force": felt,
        "thrust": told,
    }
    noisy = {
        name: x + 1e-3 * rng.normal(size=x.shape) * (name not in ("thrust", "attitude"))
        for name, x in values.items()
    }
    columns = [
        np.arange(len(t)),
        t + rng.uniform(0.0, 1e3),
        *(x for name in layout for x in noisy[name].T),
        0.0 * t + 12.6,
        np.nan * t,
    ]
    np.savetxt(
        tmp_path / "dive.csv",
        np.column_stack(columns),
        delimiter=str(rng.choice([",", ";", " "])),
        fmt="%.10g",
    )
    text = propose_mapping(tmp_path / "dive.csv")
    read = read_as_proposed(tmp_path / "dive.csv").channels
    assert set(read) == set(layout)
    for name in layout:
        assert f"  {name}: {{time: '#2'" in text
        wanted = values[name]
        found = read[name].values * (
            np.sign(read[name].values[0] @ values[name][0]) if name == "attitude" else 1
        )
        np.testing.assert_allclose(found[0], wanted[0], atol=0.01)
        np.testing.assert_allclose(
            found[-1], wanted[len(t) - 20 if name == "thrust" else -1], atol=0.01
        )
    assert text.count("# by values: #2: rises throughout") == len(layout)
    assert text.count("# by values: ") >= 2 * len(layout)


def test_columns_without_names_of_a_boat_are_a_plane(tmp_path: Path) -> None:
    """Velocity is the rate of the position turned by the heading, which takes the place of a third
    coordinate.
    """
    t = np.arange(0.0, 60.0, 0.1)
    heading = 0.8 * np.sin(0.2 * t) + 0.03 * t
    u = 0.5 + 0.3 * np.sin(0.3 * t)
    v = 0.1 * np.cos(0.5 * t)
    r = np.gradient(heading, t)
    x, y = (
        np.cumsum(0.1 * part)
        for part in (
            u * np.cos(heading) - v * np.sin(heading),
            u * np.sin(heading) + v * np.cos(heading),
        )
    )
    np.savetxt(tmp_path / "boat.csv", np.column_stack([t, x, y, heading, u, v, r]), delimiter=",")
    read = read_as_proposed(tmp_path / "boat.csv").channels
    np.testing.assert_allclose(
        read["linear_velocity"].values, np.column_stack([u, v, 0.0 * t]), atol=1e-9
    )
    np.testing.assert_allclose(read["angular_velocity"].values[:, 2], r, atol=1e-9)
    np.testing.assert_allclose(read["position"].values[:, :2], np.column_stack([x, y]), atol=1e-9)


def test_of_columns_of_which_nothing_tells_none_is_proposed(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    np.savetxt(
        tmp_path / "noise.csv",
        np.column_stack([0.1 * np.arange(200), rng.normal(size=(200, 5))]),
        delimiter=",",
    )
    with pytest.raises(
        InvalidInput,
        match=r"nothing in it has a name that is known: #1, #2, #3, #4, #5, #6; write a mapping",
    ):
        propose_mapping(tmp_path / "noise.csv")
