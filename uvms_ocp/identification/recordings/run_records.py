"""Records of the toolkit's own runs as recordings: what the robot measured, the wrench that it asked for, and the truth of what
no sensor tells: thrust and torque as thrusters and joints gave them, and the current.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uvms_ocp.identification.recordings.recording import Channel, Recording
from uvms_ocp.identification.recordings.sampling import unwound
from uvms_ocp.record import Record
from uvms_ocp.run_meta import is_floating

_WHOLE = {"thrust": "thrust", "wrench": "wrench", "joint_torques": "torque", "current": "current"}
"""Channels that are whole series."""
_POSE, _TWIST = 7, 6


def run_recording(record: Record, name: str) -> Recording:
    """Channels of a run. Raises InvalidInput for the record of a plan, which nobody has measured."""
    meta = record.run_meta
    rows = dict(_rows(record, is_floating(record.series, meta)))
    rows |= {channel: record[series] for channel, series in _WHOLE.items() if series in record.series}
    channels = {key: _channel(record["t"], values) for key, values in rows.items() if values.size}
    return Recording(name=name, channels=channels)


def _rows(record: Record, floating: bool) -> Iterator[tuple[str, np.ndarray]]:
    q, v = record["q_measured"], record["v_measured"]
    if floating:
        yield "position", q[:, :3]
        yield "attitude", unwound(q[:, 3:_POSE])
        yield "linear_velocity", v[:, :3]
        yield "angular_velocity", v[:, 3:_TWIST]
    yield "joint_positions", q[:, _POSE if floating else 0 :]
    yield "joint_velocities", v[:, _TWIST if floating else 0 :]


def _channel(t: np.ndarray, values: np.ndarray) -> Channel:
    known = np.isfinite(values).all(axis=1)
    return Channel(t=t[known], values=values[known])
