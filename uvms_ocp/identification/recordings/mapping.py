"""How the columns of foreign files become channels: a YAML file, or the same as a value.

    channels:
      linear_velocity:
        file: navigation_{name}.csv.gz
        time: header.stamp
        time_unit: ns
        columns: [velocity.x, velocity.y, velocity.z]
        body: FRD

Frames: ``world: NED`` and ``body: FRD`` are turned to W with z up and B forward-left-up. A world with z up is taken as it is:
where it has its x axis changes no fit.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.identification.recordings.recording import KINDS, Channel, Recording
from uvms_ocp.identification.recordings.sending_times import evenly_sent
from uvms_ocp.identification.recordings.tables import read_columns
from uvms_ocp.model.spatial import matrix_to_quaternion, quaternion_to_matrix, rpy_to_matrix
from uvms_ocp.untrusted.yaml_file import read_yaml_as
from uvms_ocp.validation import one_line_errors

_DOWN = np.diag([1.0, -1.0, -1.0])  # from axes with z down to axes with z up, and back
_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_LARGEST_ANGLE = 2.5 * np.pi  # [rad] of roll, pitch and yaw as files have them, unless yaw is unwound


class ChannelMapping(BaseModel):
    """Where one channel is, and what it is given in."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    file: str = Field(
        default="", description="in the folder of the recording, {name} for its name; empty: the file itself"
    )
    time: str = Field(description="column of the times")
    time_unit: Literal["s", "ms", "us", "ns"] = "s"
    columns: tuple[str, ...] = Field(min_length=1, description="in the order that the channel has")
    format: Literal["as it is", "rpy", "quaternion xyzw", "quaternion wxyz"] = Field(
        default="as it is", description="of an attitude"
    )
    unit: Literal["as it is", "deg"] = Field(default="as it is", description="deg for angles and rates in degrees")
    scale: float = Field(default=1.0, description="factor of the values [-]")
    world: Literal["z up", "NED"] = "z up"
    body: Literal["FLU", "FRD"] = "FLU"
    delay: float = Field(default=0.0, description="by which times are known to be late [s]")
    sent_every: Annotated[float, Field(gt=0.0)] | None = Field(
        default=None, description="period [s] of what was sent evenly but arrived in bursts"
    )
    lost: Literal["never", "all zero"] = Field(default="never", description="how samples look that are none")


@one_line_errors
class Mapping(BaseModel):
    """All channels of a recording, by the names of `KINDS`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    channels: dict[str, ChannelMapping] = Field(min_length=1)


def read_mapping(path: Path) -> Mapping:
    """A mapping from its YAML file. Raises InvalidInput in one line for what is none."""
    return read_yaml_as(path, Mapping)


def mapped_recording(source: Path, mapping: Mapping, name: str = "") -> Recording:
    """A recording of a file, or of files in a folder whose names have the name of the recording in them.

    Times begin with the first sample of any channel. Raises NameNotFound, NotInstalled and InvalidInput.
    """
    name = name or source.name.partition(".")[0]
    found = {key: _samples(key, one, source, name) for key, one in mapping.channels.items()}
    start = min(t[0] for t, _ in found.values())
    return Recording(
        name=name,
        channels={
            key: Channel(t=t - start, values=values, delay=mapping.channels[key].delay)
            for key, (t, values) in found.items()
        },
    )


def _samples(key: str, one: ChannelMapping, source: Path, name: str) -> tuple[np.ndarray, np.ndarray]:
    path = source / one.file.format(name=name) if one.file else source
    rows = read_columns(path, [one.time, *one.columns])
    rows = rows[np.isfinite(rows).all(axis=1)]
    if one.lost == "all zero":
        rows = rows[(rows[:, 1:] != 0.0).any(axis=1)]
    if len(rows) < 2:
        raise InvalidInput(f"{path}: fewer than two samples of {key}; leave the channel out")
    t = rows[:, 0] * _UNITS[one.time_unit]
    t = t if one.sent_every is None else evenly_sent(t, one.sent_every)
    _, first = np.unique(t, return_index=True)
    return t[first], _converted(key, one, rows[first, 1:])


def _converted(key: str, one: ChannelMapping, values: np.ndarray) -> np.ndarray:
    values = values * one.scale * (np.pi / 180.0 if one.unit == "deg" else 1.0)
    if key == "attitude":
        return _quaternions(one, values)
    turned = {"W": one.world == "NED", "B": one.body == "FRD"}.get(KINDS[key].frame if key in KINDS else "", False)
    return values * np.tile(np.diag(_DOWN), values.shape[1] // 3) if turned else values


def _quaternions(one: ChannelMapping, values: np.ndarray) -> np.ndarray:
    world, body = (_DOWN if z_down else np.eye(3) for z_down in (one.world == "NED", one.body == "FRD"))
    found = np.array([matrix_to_quaternion(world @ R @ body) for R in _rotations(one, values)])
    signs = np.cumprod(np.where((found[1:] * found[:-1]).sum(axis=1) < 0.0, -1.0, 1.0))
    return found * np.concatenate([[1.0], signs])[:, None]


def _rotations(one: ChannelMapping, values: np.ndarray) -> list[np.ndarray]:
    if one.format == "rpy":
        if values.shape[1] != 3 or np.abs(values[:, :2]).max() > _LARGEST_ANGLE:
            largest = np.abs(values).max()
            raise InvalidInput(
                f"attitude: {values.shape[1]} angles up to {largest:.4g} rad given; in deg? give its unit"
            )
        return [rpy_to_matrix(rpy) for rpy in values]
    if values.shape[1] != 4:
        raise InvalidInput(f"attitude: {values.shape[1]} columns given; allowed: 4, or format: rpy")
    xyzw = values[:, [1, 2, 3, 0]] if one.format == "quaternion wxyz" else values
    return [quaternion_to_matrix(quaternion / np.linalg.norm(quaternion)) for quaternion in xyzw]
