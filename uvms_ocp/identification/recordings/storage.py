"""A recording as one file, CSV or Parquet, by its ending: a row for every time, cells only for channels that have a sample."""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path

import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.identification.recordings.recording import KINDS, Channel, Recording
from uvms_ocp.identification.recordings.tables import column_names, read_columns, write_columns

_TIME = "t [s]"
_COLUMN = re.compile(r"(\w+)\.(\w+)$")


def write_recording(recording: Recording, path: Path) -> None:
    """Write it. Raises NotInstalled where Parquet cannot be written."""
    times = np.unique(np.concatenate([channel.t for channel in recording.channels.values()]))
    columns = {_TIME: times}
    for name, channel in recording.channels.items():
        at = np.searchsorted(times, channel.t)
        for label, values in zip(
            _labels(name, channel), (*channel.values.T, np.full(len(at), channel.delay)), strict=True
        ):
            columns[label] = np.full(len(times), np.nan)
            columns[label][at] = values
    write_columns(path, columns)


def _labels(name: str, channel: Channel) -> tuple[str, ...]:
    own = KINDS[name].columns or tuple(str(k) for k in range(channel.values.shape[1]))
    return (*(f"{name}.{column}" for column in own), f"{name}.delay")


def is_stored(names: Collection[str]) -> bool:
    """Whether a table with columns of these names is one of ours."""
    return _TIME in names


def stored_recording(path: Path) -> Recording:
    """Read what `write_recording` has written. Raises InvalidInput for another file, and NotInstalled."""
    names = column_names(path)
    found: dict[str, list[str]] = {}
    for column in names:
        match = _COLUMN.match(column)
        if match:
            found.setdefault(match[1], []).append(column)
    if not is_stored(names) or not found:
        raise InvalidInput(f"{path}: no recording of ours; give a mapping of its columns")
    return Recording(
        name=path.name.partition(".")[0],
        channels={
            name: _channel(f"{path}: {name}", read_columns(path, [_TIME, *columns])) for name, columns in found.items()
        },
    )


def _channel(where: str, rows: np.ndarray) -> Channel:
    there = rows[np.isfinite(rows).all(axis=1)]
    if len(there) < 2:
        raise InvalidInput(f"{where} has {len(there)} samples; allowed: 2 or more, or leave its columns out")
    return Channel(t=there[:, 0], values=there[:, 1:-1], delay=float(there[0, -1]))
