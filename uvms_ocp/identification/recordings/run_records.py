"""Records of the toolkit's own runs as recordings: what the robot measured, what was asked of its thrusters, and the truth of
what no sensor tells: torque as joints gave it, and the current.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from uvms_ocp.identification.recordings.recording import Channel, Recording
from uvms_ocp.identification.recordings.sampling import unwound
from uvms_ocp.record import Record
from uvms_ocp.run_meta import is_floating

_TRUTH = {"joint_torques": "torque", "current": "current"}
"""Channels that are whole series."""
_POSE, _TWIST = 7, 6


def run_recording(record: Record, name: str) -> Recording:
    """Channels of a run. Raises InvalidInput for the record of a plan, which nobody has measured."""
    meta = record.run_meta
    rows = dict(_rows(record, is_floating(record.series, meta)))
    rows |= {channel: record[series] for channel, series in _TRUTH.items() if series in record.series}
    channels = {key: _channel(record["t"], values) for key, values in rows.items() if values.size}
    for key, values in _asked(record):
        channels[key] = _from_nothing(_channel(record["t"], values), meta.dt)
    named = {"joint_positions": meta.joints, "joint_velocities": meta.joints, "thrust": meta.thrusters}
    channels = {key: _with_names(one, named.get(key, ())) for key, one in channels.items()}
    return Recording(name=name, channels=channels, known_doubts=tuple(_spoiled(record)), at_once=True)


def _rows(record: Record, floating: bool) -> Iterator[tuple[str, np.ndarray]]:
    q, v = record["q_measured"], record["v_measured"]
    if floating:
        yield "position", q[:, :3]
        yield "attitude", unwound(q[:, 3:_POSE])
        yield "linear_velocity", v[:, :3]
        yield "angular_velocity", v[:, 3:_TWIST]
    yield "joint_positions", q[:, _POSE if floating else 0 :]
    yield "joint_velocities", v[:, _TWIST if floating else 0 :]


def _with_names(channel: Channel, names: tuple[str, ...]) -> Channel:
    """Where it has a column for each: not of joints that turn without end."""
    return replace(channel, columns=names) if len(names) == channel.values.shape[1] else channel


def _asked(record: Record) -> Iterator[tuple[str, np.ndarray]]:
    """Of thrusters: what they cannot give of a wrench is not asked of them."""
    found = record.series
    for name in ("asked_thrust", "thrust"):
        if name in found and found[name].size:
            yield "thrust", found[name]
            break
    if "wrench" in found:
        yield "wrench", found["wrench"] - found.get("unreachable", 0.0)


def _from_nothing(channel: Channel, dt: float) -> Channel:
    """A run begins with thrusters at rest; dt [s]."""
    t, values = channel.t, channel.values
    return replace(channel, t=np.r_[t[0] - dt, t], values=np.vstack([np.zeros_like(values[:1]), values]))


def _spoiled(record: Record) -> Iterator[tuple[str, str]]:
    """Channels and what the record itself says against them."""
    t, found = record["t"], record.series
    if "thrust" in found and "asked_thrust" not in found:
        yield "thrust", "as thrusters gave it, not as it was asked of them: lag and dead zone are in it, run it anew"
    for fault in record.run_meta.faults:
        if fault.t <= t[-1]:
            yield fault.target, f"{fault.text}, a fault of this run: a fit takes vehicle and sensors for sound"
    if "contact" in found and (touches := (found["contact"] != 0.0).any(axis=1)).any():
        yield "position", f"on the floor at {t[np.argmax(touches)]:.2f} s first: a fit knows no floor that pushes"


def _channel(t: np.ndarray, values: np.ndarray) -> Channel:
    known = np.isfinite(values).all(axis=1)
    return Channel(t=t[known], values=values[known])
