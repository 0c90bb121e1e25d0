"""Every kind of recording that strangers brought is read right, or its doubt or refusal is true and
names the cure.
"""

from __future__ import annotations

import gzip
import re
import shutil
import sqlite3
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from uvms_ocp.errors import UvmsError
from uvms_ocp.identification import RecordingMapping, check_data_quality, read_recording
from uvms_ocp.identification.proposed_mapping import propose_mapping

Write = Callable[[Path], Path]
Channels = Mapping[str, Mapping[str, Any]]

T = np.arange(0.0, 30.0, 0.1)
POSE = np.column_stack(
    [0.7 * np.sin(0.3 * T), 0.4 * np.cos(0.25 * T), -3.0 + 0.3 * np.sin(0.4 * T)]
).round(6)
SPEED = np.column_stack(
    [0.4 * np.sin(0.5 * T), 0.2 * np.cos(0.4 * T), 0.1 * np.sin(0.7 * T)]
).round(6)
ANGLES = np.column_stack(
    [0.02 * np.sin(0.9 * T), 0.03 * np.cos(0.7 * T), 0.6 + 0.9 * np.sin(0.2 * T)]
).round(6)
SIGNALS = np.column_stack([0.6 * np.sin(0.2 * T + k) for k in range(6)]).round(6)
FORCES = np.column_stack([30.0 * np.sin(0.2 * T), 25.0 * np.cos(0.3 * T)]).round(6)
LOST = np.arange(len(T)) % 8 == 3
ROWS = [[f"{t:.3f}", *(f"{x:.6f}" for x in row)] for t, row in zip(T, POSE, strict=True)]
DOWN = np.array([1.0, -1.0, -1.0])
AS_PROPOSED: Channels = {}
XYZ: Channels = {"position": {"time": "t", "columns": ["x", "y", "z"]}}


def one(name: str, columns: str, **more: object) -> Channels:
    return {name: {"time": "t", "columns": columns.split(), **more}}


BOAT = {
    **one("attitude", "roll pitch yaw", format="rpy"),
    **one("linear_velocity", "u v w"),
    **one("angular_velocity", "p q r"),
    **one("thrust", "left right"),
}


@dataclass(frozen=True)
class Stranger:
    """A file, how it is asked for, and what must be said of it: values, all of its doubts, or why
    it is refused.
    """

    write: Write
    channels: Channels = field(default_factory=lambda: AS_PROPOSED)
    reads: Mapping[str, np.ndarray] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()
    refused: str = ""
    missing: int = 0


def text(
    rows: list[list[str]] = ROWS,
    names: str = "t,x,y,z",
    cell: str = ",",
    line: str = "\n",
    code: str = "utf-8",
    before: str = "",
) -> Write:
    head = [names.replace(",", cell)] if names else []
    content = before + line.join([*head, *(cell.join(row) for row in rows)]) + line
    return raw(content.encode(code))


def raw(content: bytes) -> Write:
    def write(folder: Path) -> Path:
        (folder / "dive.csv").write_bytes(content)
        return folder / "dive.csv"

    return write


def numbers(names: str, *series: np.ndarray) -> Write:
    return text(
        [[f"{x:.9g}" for x in row] for row in np.column_stack(series)], names.replace(" ", ",")
    )


def packed(write: Write) -> Write:
    def packs(folder: Path) -> Path:
        path = write(folder)
        path.write_bytes(gzip.compress(path.read_bytes()))
        return path

    return packs


def with_cell(row: int, column: int, cell: str) -> list[list[str]]:
    return [
        [cell if (k, m) == (row, column) else said for m, said in enumerate(cells)]
        for k, cells in enumerate(ROWS)
    ]


def without(word: str) -> list[list[str]]:
    return [[row[0], *[word] * 3] if lost else row for row, lost in zip(ROWS, LOST, strict=True)]


def spoiled(values: np.ndarray, sentinel: float, every: int) -> np.ndarray:
    return np.where(lost_ones(every)[:, None], sentinel, values)


def lost_ones(every: int) -> np.ndarray:
    return np.arange(len(T)) % every == 1


def boat(attitude: np.ndarray = ANGLES, axes: np.ndarray | float = 1.0) -> Write:
    vectors = (axes * each for each in (POSE, attitude, *boat_motion()))
    return numbers("t x y z roll pitch yaw u v w p q r left right", T, *vectors, FORCES)


def boat_motion() -> tuple[np.ndarray, np.ndarray]:
    """Rates of POSE and ANGLES in B."""
    R = Rotation.from_euler("xyz", ANGLES)
    turned = (R[:-1].inv() * R[1:]).as_rotvec() / 0.1
    return R.inv().apply(np.gradient(POSE, T, axis=0)), np.vstack([turned, turned[-1:]])


def bag(storage: str, *, alone: bool = False, defined: bool = True) -> Write:
    """Angles at 2 Hz, each of them three times, a topic of no messages, and a sensor that no
    library knows.
    """

    def write(folder: Path) -> Path:
        rosbag2 = pytest.importorskip(
            "rosbags.rosbag2", reason='needs pip install "uvms-ocp[rosbags]"'
        )
        typesys = pytest.importorskip("rosbags.typesys")
        store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        store.register(
            typesys.get_types_from_msg("geometry_msgs/Vector3 velocity\n", "own_msgs/msg/Sonar")
        )
        twist = "geometry_msgs/msg/Twist"
        vector = store.types["geometry_msgs/msg/Vector3"]
        version = 9 if storage == "MCAP" else 8
        with rosbag2.Writer(
            folder / "dive", version=version, storage_plugin=rosbag2.StoragePlugin[storage]
        ) as writer:
            to = {
                topic: writer.add_connection(topic, twist, typestore=store)
                for topic in ("/angles", "/none")
            }
            to["/speed"] = writer.add_connection("/speed", "own_msgs/msg/Sonar", typestore=store)
            for k, t in enumerate((1e9 * (1000.0 + T)).astype(int).tolist()):
                angles = store.types[twist](
                    linear=vector(0.0, 0.0, 0.0), angular=vector(*ANGLES[k].tolist())
                )
                for late in (0, 30_000, 300_000) if k % 5 == 0 else ():
                    writer.write(to["/angles"], t + late, store.serialize_cdr(angles, twist))
                speed = store.types["own_msgs/msg/Sonar"](velocity=vector(*SPEED[k].tolist()))
                writer.write(to["/speed"], t, store.serialize_cdr(speed, "own_msgs/msg/Sonar"))
        (file,) = [path for path in (folder / "dive").iterdir() if path.suffix != ".yaml"]
        if not defined:
            with sqlite3.connect(file) as base:  # as Humble and before leave it
                base.execute("DROP TABLE message_definitions")
            base.close()
        return shutil.move(file, folder / f"alone{file.suffix}") if alone else folder / "dive"

    return write


def bag_of_ros_1(folder: Path) -> Path:
    rosbag1 = pytest.importorskip("rosbags.rosbag1", reason='needs pip install "uvms-ocp[rosbags]"')
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    with rosbag1.Writer(folder / "dive.bag") as writer:
        to = writer.add_connection("/depth", "std_msgs/msg/Float64", typestore=store)
        for t, z in zip(
            (1e9 * (1000.0 + T)).astype(int).tolist(), POSE[:, 2].tolist(), strict=True
        ):
            message = store.types["std_msgs/msg/Float64"](data=-z)
            writer.write(to, t, store.serialize_ros1(message, "std_msgs/msg/Float64"))
    return folder / "dive.bag"


TWO_SENSORS = numbers(
    "t I x y z",
    np.repeat(T, 2) + np.tile([0.0, 7e-6], len(T)),
    np.tile([0.0, 1.0], len(T)),
    np.repeat(POSE, 2, axis=0) + np.tile([[0.0, 0.0, 0.0], [0.0, 0.0, -4.0]], (len(T), 1)),
)
THRICE = numbers(
    "t x y z", np.repeat(T, 3) + np.tile([0.0, 3e-5, 3e-4], len(T)), np.repeat(POSE, 3, axis=0)
)
ON_GLOBE = numbers(
    "t lat lon alt",
    T,
    np.column_stack([63.4 + 0.001 * POSE[:, 0], 10.3 + 0.002 * POSE[:, 1], POSE[:, 2]]),
)
PRESSURE = numbers("t x y press", T, POSE[:, :2], 1013.0 - POSE[:, 2] / 0.0102)
BY_DATE = [[f"2024-06-01 12:00:{t:09.6f}", *row[1:]] for t, row in zip(T, ROWS, strict=True)]
PULSES = numbers("t m0 m1 m2 m3 m4 m5", T, 1500.0 + 400.0 * SIGNALS)
SHARES = numbers("t m0 m1 m2 m3 m4 m5", T, SIGNALS)
COMMANDS = "m0 m1 m2 m3 m4 m5"
PULSE_KEYS = {"offset": -1500.0, "scale": 0.0025}
ANGLES_OF_TOPIC = {
    "topic": "/angles",
    "columns": ["angular.x", "angular.y", "angular.z"],
    "format": "rpy",
}
IN_BAGS: Channels = {
    "attitude": ANGLES_OF_TOPIC,
    "linear_velocity": {"topic": "/speed", "columns": ["velocity.x", "velocity.y", "velocity.z"]},
}
MOTION = {
    "attitude": ANGLES,
    **dict(zip(("linear_velocity", "angular_velocity"), boat_motion(), strict=True)),
}
READ = {"position": POSE}
IN_A_BAG = {"attitude": ANGLES[::5], "linear_velocity": SPEED}
UNDEFINED = (
    "no definition of own_msgs/msg/Sonar in it; give a folder with its .msg file as `messages:"
    " FOLDER`"
)


def lost(value: str, every: int, axes: str = "xyz") -> tuple[str, ...]:
    n = lost_ones(every).sum()
    return tuple(
        rf"{axis} is {value} in {n} of 300 samples, all others .*: give missing: \[{value}\]"
        for axis in axes
    )


STRANGERS: dict[str, Stranger] = {
    "plain": Stranger(text(), reads=READ),
    "byte order mark": Stranger(text(code="utf-8-sig"), reads=READ),
    "carriage returns": Stranger(text(line="\r"), reads=READ),
    "semicolons": Stranger(text(cell=";"), reads=READ),
    "tabs": Stranger(text(cell="\t"), reads=READ),
    "blanks": Stranger(text(cell=" "), reads=READ),
    "decimal commas": Stranger(
        text([[x.replace(".", ",") for x in row] for row in ROWS], cell=";"), reads=READ
    ),
    "packed, and not named so": Stranger(packed(text()), reads=READ),
    "title": Stranger(text(before="Log of a dive,,,\nvehicle: one,,,\n"), reads=READ),
    "quotes": Stranger(
        text([[f'"{x}"' for x in row] for row in ROWS], '"t","x","y","z"'), reads=READ
    ),
    "header in a comment": Stranger(text(names="# t,x,y,z"), reads=READ),
    "row of units": Stranger(text([["s", "m", "m", "m"], *ROWS]), reads=READ),
    "names of mixed case": Stranger(text(names=" Time (s) , X [m], Y [m], Z [m] "), reads=READ),
    "dates": Stranger(text(BY_DATE), reads=READ),
    "nanoseconds": Stranger(
        text([[f"17{k:09d}00000000", *row[1:]] for k, row in enumerate(ROWS)]), reads=READ
    ),
    "microseconds": Stranger(
        text([[f"{100_000 * k}", *row[1:]] for k, row in enumerate(ROWS)]), reads=READ
    ),
    "microseconds, said to be seconds": Stranger(
        text([[f"{100_000 * k}", *row[1:]] for k, row in enumerate(ROWS)]),
        XYZ,
        doubts=("unit of its times. give time_unit: us",),
    ),
    "messages three times each": Stranger(THRICE, reads=READ),
    "depth": Stranger(numbers("t east north depth", T, POSE * [1, 1, -1]), reads=READ),
    "depth as height": Stranger(
        numbers("t east north depth", T, POSE * [1, 1, -1]),
        one("position", "east north depth"),
        {"position": POSE * [1, 1, -1]},
        (r"above a surface at 0: z down \(NED\). give world: NED, or -NAME",),
    ),
    "without a header": Stranger(
        text(names=""), {"position": {"time": "#1", "columns": ["#2", "#3", "#4"]}}, READ
    ),
    "without a header, by names": Stranger(
        text(names=""), XYZ, refused="unknown column .* known: #1, #2, #3, #4"
    ),
    "two columns of a name": Stranger(
        text([[*row, "9", "9"] for row in ROWS], "t,x,y,z,x,y"),
        XYZ,
        refused="2 columns are called 'x'; .* by its place: #2, #5",
    ),
    "infinity": Stranger(
        text(with_cell(7, 1, "inf")),
        XYZ,
        {"position": np.delete(POSE, 7, axis=0)},
        (r"1 of 300 rows .*\(x\)",),
        missing=1,
    ),
    "N/A": Stranger(
        text(without("N/A")),
        XYZ,
        {"position": POSE[~LOST]},
        ("38 of 300 rows have NaN .* left out",),
        missing=38,
    ),
    "None": Stranger(
        text(without("None")),
        XYZ,
        {"position": POSE[~LOST]},
        ("38 of 300 rows have NaN .* left out",),
        missing=38,
    ),
    "last row broken off": Stranger(
        text([*ROWS[:-1], ROWS[-1][:2]]),
        XYZ,
        {"position": POSE[:-1]},
        ("last row breaks off after 2 of 4 cells and is left out",),
    ),
    "thousands": Stranger(
        text(with_cell(7, 1, '"2,000.5"')),
        XYZ,
        {"position": np.where(POSE[7, 0] == POSE, 2000.5, POSE)},
        (r"x is 2000.5 in 1 of 300 .*: mistyped. give missing: \[2000.5\]",),
    ),
    "underscore": Stranger(
        text(with_cell(7, 1, "2_000")),
        XYZ,
        refused="row 8, column 'x': '2_000' is no number; numbers, .* are read",
    ),
    "nothing": Stranger(raw(b""), refused="is empty; give a recording"),
    "pulse of an old code page": Stranger(
        numbers("t PWM", T, 1500.0 + 400.0 * SIGNALS[:, 0]),
        one("thrust", "PWM"),
        doubts=("pulse widths in us. give offset: -1500, scale: 0.0025, as prop",),
    ),
    "sentinels": Stranger(
        numbers("t x y z", T, spoiled(POSE, -9999.0, 12)), XYZ, doubts=lost("-9999", 12)
    ),
    "sentinels, few": Stranger(
        numbers("t x y z", T, spoiled(POSE, -9999.0, 90)), XYZ, doubts=lost("-9999", 90)
    ),
    "sentinels, as proposed": Stranger(
        numbers("t x y z", T, spoiled(POSE, -9999.0, 12)),
        reads={"position": POSE[~lost_ones(12)]},
        doubts=("25 of 300 rows have NaN",),
        missing=25,
    ),
    "no bottom": Stranger(
        numbers("t vx vy vz", T, spoiled(SPEED, -32.768, 11)),
        one("linear_velocity", "vx vy vz"),
        doubts=lost("-32.768", 11),
    ),
    "no bottom, often": Stranger(
        numbers("t vx vy vz", T, spoiled(SPEED, -32.768, 5)),
        one("linear_velocity", "vx vy vz"),
        doubts=lost("-32.768", 5),
    ),
    "no bottom, as proposed": Stranger(
        numbers("t vx vy vz", T, spoiled(SPEED, -32.768, 5)),
        reads={"linear_velocity": SPEED[~lost_ones(5)]},
        doubts=("60 of 300 rows",),
        missing=60,
    ),
    "millimetres": Stranger(
        numbers("t vx vy vz", T, 1e3 * SPEED),
        one("linear_velocity", "vx vy vz"),
        doubts=("is it in mm/s, or cm/s",),
    ),
    "millimetres, as proposed": Stranger(
        numbers("t vx vy vz", T, 1e3 * SPEED), reads={"linear_velocity": SPEED}
    ),
    "degrees": Stranger(
        numbers("t roll pitch yaw", T, np.rad2deg(ANGLES)),
        one("attitude", "roll pitch yaw", format="rpy"),
        doubts=("yaw up to .* in deg. give its unit",),
    ),
    "degrees, as proposed": Stranger(
        numbers("t roll pitch yaw", T, np.rad2deg(ANGLES)), reads={"attitude": ANGLES}
    ),
    "degrees of one that turns": Stranger(
        numbers("t roll pitch yaw", T, np.column_stack([ANGLES[:, :2], 40.0 * T % 360.0])),
        one("attitude", "roll pitch yaw", format="rpy"),
        doubts=("yaw up to .* in deg. give its unit",),
    ),
    "degrees on the globe": Stranger(
        ON_GLOBE,
        one("position", "lat lon alt"),
        doubts=("lat, lon are degrees on the globe: give metres east and north",),
    ),
    "pressure": Stranger(
        PRESSURE,
        one("position", "x y press"),
        doubts=(r"in mbar, .* give offset: \[0, 0, -1013.25\], scale: \[1, 1, -0.010197\]",),
    ),
    "pressure, as told": Stranger(
        PRESSURE, one("position", "x y press", offset=[0, 0, -1013], scale=[1, 1, -0.0102]), READ
    ),
    "pulses": Stranger(
        PULSES,
        one("thrust", COMMANDS),
        doubts=("pulse widths in us. give offset: -1500, scale: 0.0025, as propeller_commands",),
    ),
    "pulses, as proposed": Stranger(PULSES, reads={"propeller_commands": SIGNALS}),
    "shares": Stranger(
        SHARES,
        one("thrust", COMMANDS),
        doubts=("shares of the largest command. give them as propeller_commands",),
    ),
    "shares, as proposed": Stranger(SHARES, reads={"propeller_commands": SIGNALS}),
    "two sensors": Stranger(
        TWO_SENSORS, XYZ, doubts=("50 % of its samples .*: two sensors. give rows: {NAME: VALUE}",)
    ),
    "one of two sensors": Stranger(TWO_SENSORS, one("position", "x y z", rows={"I": 0}), READ),
    "all of a boat": Stranger(boat(), BOAT, MOTION),
    "pose of a boat": Stranger(
        boat(),
        {
            **one("position", "x y z"),
            **one("attitude", "roll pitch yaw", format="rpy"),
            **one("thrust", "left right"),
        },
        READ,
    ),
    "a boat in degrees": Stranger(
        boat(np.rad2deg(ANGLES)), BOAT, doubts=("attitude: yaw up to .* in deg. give its unit",)
    ),
    "a boat in degrees, as proposed": Stranger(boat(np.rad2deg(ANGLES)), reads=READ | MOTION),
    "a boat in degrees with z down, as proposed": Stranger(
        boat(np.rad2deg(ANGLES), DOWN), reads=READ | MOTION
    ),
    "velocity in W alone": Stranger(
        boat(),
        one("linear_velocity", "u v w", frame="W"),
        refused="frame: W given, which needs the attitude; give that channel too",
    ),
    "world of a velocity in B": Stranger(
        boat(),
        one("linear_velocity", "u v w", world="NED"),
        refused="world: NED given, which means nothing of it; leave it out",
    ),
    "no such channel": Stranger(
        boat(), one("velocity", "u v w"), refused="Did you mean 'linear_velocity'"
    ),
    "one axis twice": Stranger(
        boat(),
        one("position", "x x z"),
        doubts=("x stands for more than one of its axes: give a number",),
    ),
    "opposite": Stranger(
        boat(),
        one("position", "x y -z"),
        {"position": POSE * [1, 1, -1]},
        ("above a surface at 0: z down",),
    ),
    "scale of each": Stranger(
        boat(),
        one("position", "x y z", scale=[1, 1, -1]),
        {"position": POSE * [1, 1, -1]},
        ("above a surface at 0: z down",),
    ),
    "newtons far from 0": Stranger(
        boat(),
        one("thrust", "left right", offset=-1500, scale=0.1),
        doubts=("never near 0: its offset, its unit",),
    ),
    "two axes": Stranger(
        numbers("t x y", T, POSE[:, :2]),
        one("position", "x y"),
        refused="2 columns given; allowed: 3; a number may stand for one",
    ),
    "two axes, as proposed": Stranger(
        numbers("t x y", T, POSE[:, :2]), reads={"position": POSE * [1, 1, 0]}
    ),
    "four axes": Stranger(
        numbers("t x y", T, POSE[:, :2]),
        one("position", "x y x y"),
        refused="4 columns given; allowed: 3",
    ),
    "a moment": Stranger(
        text(ROWS[:4]),
        XYZ,
        {"position": POSE[:4]},
        ("0.3 s are in all channels, which are too few to look at",),
    ),
    **{
        f"bag of ROS 2, {storage}, {'alone' if alone else 'in its folder'}": Stranger(
            bag(storage, alone=alone), IN_BAGS, IN_A_BAG
        )
        for storage in ("SQLITE3", "MCAP")
        for alone in (False, True)
    },
    "sent more often than it was": Stranger(
        bag("MCAP"),
        {"attitude": {**ANGLES_OF_TOPIC, "sent_every": 0.05}},
        {"attitude": ANGLES[::5]},
    ),
    "topic without messages": Stranger(
        bag("MCAP"),
        {"attitude": {**ANGLES_OF_TOPIC, "topic": "/none"}},
        refused="/none has no messages; leave the channel out",
    ),
    "bag without definitions": Stranger(bag("SQLITE3", defined=False), IN_BAGS, refused=UNDEFINED),
    "bag without definitions, as proposed": Stranger(
        bag("SQLITE3", defined=False), refused=UNDEFINED
    ),
    "bag without definitions, what is standard in it": Stranger(
        bag("SQLITE3", defined=False), {"attitude": ANGLES_OF_TOPIC}, {"attitude": ANGLES[::5]}
    ),
    "bag of ROS 1": Stranger(bag_of_ros_1, reads={"position": POSE * [0, 0, 1]}),
    "bag of ROS 1, a depth for all axes": Stranger(
        bag_of_ros_1,
        {"position": {"topic": "/depth", "columns": ["data"] * 3}},
        doubts=("data stands for more than one of its axes: give a number", "z down"),
    ),
}


@pytest.mark.parametrize("kind", STRANGERS)
def test_a_stranger_s_file_is_read_right_or_what_is_said_of_it_is_true_and_names_the_cure(
    kind: str, tmp_path: Path
) -> None:
    case = STRANGERS[kind]
    path = case.write(tmp_path)
    if case.refused:
        with pytest.raises(UvmsError, match=case.refused) as error:
            read_recording(path, mapping(path, case.channels))
        assert "\n" not in str(error.value)
        return
    recording = read_recording(path, mapping(path, case.channels))
    for name, wanted in case.reads.items():
        values = recording.channels[name].values
        if name == "attitude":
            values = Rotation.from_quat(values).as_euler("xyz")
        np.testing.assert_allclose(values, wanted, atol=2e-6, err_msg=name)
        if len(wanted) == len(T):
            np.testing.assert_allclose(recording.channels[name].t, T, atol=1e-6, err_msg=name)
    doubts = [str(doubt) for doubt in check_data_quality(recording)]
    assert len(doubts) == len(case.doubts), doubts
    for said, doubt in zip(case.doubts, doubts, strict=True):
        assert re.search(said, doubt), doubt
    assert sum(channel.missing for channel in recording.channels.values()) == case.missing


def mapping(path: Path, channels: Channels) -> RecordingMapping:
    return RecordingMapping.model_validate(
        {"channels": channels} if channels else yaml.safe_load(propose_mapping(path))
    )
