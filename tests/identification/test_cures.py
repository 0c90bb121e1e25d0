"""What a doubt proposes is true: a mapping with it raises the doubt no more, and no other."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from motions import DOWN
from test_doubts import driven, moved, told

from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.resampling import rotations
from uvms_ocp.identification.tables import write_columns

Keys = dict[str, Any]


def values(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Channel], Channel]:
    return lambda one: replace(one, values=change(one.values))


def times(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Channel], Channel]:
    return lambda one: replace(one, t=change(one.t))


def in_bursts(t: np.ndarray) -> np.ndarray:
    """Ten samples at a time, a millisecond after each other."""
    k = np.arange(len(t))
    return t[np.minimum(k - k % 10 + 9, len(t) - 1)] + 1e-3 * (k % 10)


def lost(value: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda x: np.where(np.arange(len(x))[:, None] % 17 == 5, value, x)


def in_world(x: np.ndarray) -> np.ndarray:
    return np.einsum(
        "nij,nj->ni",
        rotations(moved().channels["attitude"], moved().channels["linear_velocity"].t),
        x,
    )


def columns(found: re.Match[str]) -> Keys:
    axes = [axis.strip() for axis in found["value"].split(",")]
    return {
        "columns": [f"{'-' if axis[0] == '-' else ''}c{'xyz'.index(axis[-1])}" for axis in axes]
    }


def keys(text: str) -> Callable[[re.Match[str]], Keys]:
    return lambda found: yaml.safe_load(text.replace("VALUE", found.groupdict().get("value") or ""))  # type: ignore[no-any-return]


UNIT = r"NAME: up to .* is it in (?P<value>[a-z/]+)[,?]"
FACTOR = r"NAME: \S+ times the rate of the \w+: in (?P<value>\S+)\?"
SECOND = r"NAME: up to .* is it in \S+, or (?P<value>[a-z/]+)\?"
AXES = r"NAME: its (axes fit|rate fits) the \w+( of the \w+)? (as|with axes) \((?P<value>.*?)\)"
LATE = r"NAME: (?P<value>[\d.]+) s late"
CURES: list[tuple[str, Callable[[Channel], Channel], str, Callable[[re.Match[str]], Keys]]] = [
    ("linear_velocity", values(lambda x: x[:, [1, 0, 2]] * [1, 1, -1]), AXES, columns),
    ("linear_velocity", values(lambda x: x[:, [2, 0, 1]] * [-1, 1, 1]), AXES, columns),
    ("angular_velocity", values(lambda x: x[:, [1, 2, 0]]), AXES, columns),
    ("angular_velocity", values(lambda x: x * [1, -1, 1]), AXES, columns),
    ("position", values(lambda x: x[:, [1, 0, 2]] * [1, 1, -1]), AXES, columns),
    ("position", values(lambda x: x @ DOWN), "NAME: .* NED", keys("{world: NED}")),
    ("linear_velocity", values(in_world), "NAME: .* in W", keys("{frame: W}")),
    ("position", values(lambda x: 1e3 * x), UNIT, keys("{unit: VALUE}")),
    ("position", values(lambda x: 1e2 * x), SECOND, keys("{unit: VALUE}")),
    ("linear_velocity", values(lambda x: 1e3 * x), UNIT, keys("{unit: VALUE}")),
    ("linear_velocity", values(lambda x: 1e3 * x), FACTOR, keys("{unit: VALUE}")),
    ("linear_velocity", values(lambda x: 1e2 * x), SECOND, keys("{unit: VALUE}")),
    ("linear_velocity", values(lambda x: 1e2 * x), FACTOR, keys("{unit: VALUE}")),
    ("linear_velocity", values(lambda x: x / 0.514444), FACTOR, keys("{unit: VALUE}")),
    ("angular_velocity", values(np.degrees), UNIT, keys("{unit: VALUE}")),
    ("angular_velocity", values(np.degrees), FACTOR, keys("{unit: VALUE}")),
    ("joint_positions", values(np.degrees), UNIT, keys("{unit: VALUE}")),
    ("joint_velocities", values(np.degrees), FACTOR, keys("{unit: VALUE}")),
    ("specific_force", values(lambda x: x / 9.80665), "NAME: .* in g,", keys("{unit: g}")),
    ("specific_force", values(lambda x: x @ DOWN), "NAME: points down .*FRD", keys("{body: FRD}")),
    *(
        (
            "linear_velocity",
            times(lambda t, n=n: n * t),
            r"NAME: .*unit of its times. give (?P<value>.+: \w+)",
            keys("{VALUE}"),
        )
        for n in (1e3, 1e6, 1e9)
    ),
    ("linear_velocity", times(lambda t: t + 0.6), LATE, keys("{delay: VALUE}")),
    (
        "angular_velocity",
        times(lambda t: t - 0.6),
        LATE.replace("late", "early"),
        keys("{delay: -VALUE}"),
    ),
    (
        "linear_velocity",
        times(in_bursts),
        r"NAME: .*give (?P<value>sent_every: [\d.]+)",
        keys("{VALUE}"),
    ),
    (
        "linear_velocity",
        values(lost(-32.768)),
        r"NAME: .*give (?P<value>missing: \[[-\d.e+]+\])",
        keys("{VALUE}"),
    ),
    ("linear_velocity", values(lost(0.0)), "NAME: .* exactly zero", keys("{lost: all zero}")),
    (
        "angular_velocity",
        values(lambda x: np.minimum(x, [0.8 * x[:, 0].max(), np.inf, np.inf])),
        r"NAME: .*saturated\? give (?P<value>missing: \[[-\d.e+]+\])",
        keys("{VALUE}"),
    ),
]


def files(recording: Recording, folder: Path) -> dict[str, Keys]:
    """The channels as tables of others."""
    folder.mkdir()
    for name, channel in recording.channels.items():
        write_columns(
            folder / f"{name}.csv",
            {"t": channel.t, **{f"c{k}": column for k, column in enumerate(channel.values.T)}},
        )
    return {
        name: {
            "file": f"{name}.csv",
            "time": "t",
            "columns": [f"c{k}" for k in range(channel.values.shape[1])],
        }
        for name, channel in recording.channels.items()
    }


def read(folder: Path, channels: dict[str, Keys]) -> str:
    return told(mapped_recording(folder, RecordingMapping.model_validate({"channels": channels})))


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("name", "spoil", "doubt", "cure"), CURES, ids=[f"{k} {one[0]}" for k, one in enumerate(CURES)]
)
def test_what_is_proposed_removes_the_doubt(
    name: str,
    spoil: Callable[[Channel], Channel],
    doubt: str,
    cure: Callable[[re.Match[str]], Keys],
    tmp_path: Path,
) -> None:
    good = moved()
    folder = tmp_path / "log"
    channels = files(
        replace(good, channels={**good.channels, name: spoil(good.channels[name])}), folder
    )
    before = read(folder, channels)
    match = re.search(doubt.replace("NAME", name), before)
    assert match, before
    after = read(folder, {**channels, name: channels[name] | cure(match)})
    # which is so
    left_out = (
        r"\w+: (\d+ of \d+ rows have NaN \(.*?\) and are left out|\d+ gaps, the longest .* set\?)"
    )
    assert re.sub(left_out, "", after).strip("; ") == ""


@pytest.mark.slow
@pytest.mark.parametrize(("scale", "offset"), [(400.0, 1500.0), (1.0, 0.0)])
def test_commands_that_are_no_newtons_become_what_is_proposed(
    scale: float, offset: float, tmp_path: Path
) -> None:
    channel = driven().channels["wrench"]
    signals = Channel(
        t=channel.t, values=scale * channel.values / np.abs(channel.values).max() + offset
    )
    folder = tmp_path / "log"
    channels = files(Recording(name="log", channels={"thrust": signals}), folder)
    before = read(folder, channels)
    match = re.search(
        r"(give (?P<keys>offset: .*, scale: .*), as|give them as) propeller_commands", before
    )
    assert match, before
    given_keys = yaml.safe_load(f"{{{match['keys'] or ''}}}")
    assert read(folder, {"propeller_commands": channels["thrust"] | given_keys}) == ""
