"""Find channels in which two senders alternate, by their samples: files that name no sender, as bags of
ROS 2, mix what is sent under one topic.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np

from uvms_ocp.identification.recording import CHANNEL_KINDS, Channel, Recording

_SMOOTH = ("position", "attitude", "linear_velocity", "joint_positions")
"""Channels of what cannot jump; gyros and accelerometers may vibrate as fast as they are sampled."""
_BEFORE = 6  # samples back, among which is one of the same sender
_MIN_JUMP = 8.0  # usual steps of one sender from which on a step leads to the other
_USUAL = 90.0  # [%] of the samples that have a smaller step from one of the samples before
_MIN_SHARE = 0.1  # of steps that lead to the other sender
_MIN_SAMPLES = 50


def of_senders(recording: Recording, doubted: Collection[str]) -> Iterator[tuple[str, str]]:
    """Yield channels that jump to and fro between two series; of those that are doubted already more
    is said elsewhere.
    """
    for name in _SMOOTH:
        if name not in recording.channels or name in doubted:
            continue
        distance = _distance_of_two(recording.channels[name])
        if distance is not None:
            unit = CHANNEL_KINDS[name].unit
            if name == "attitude":  # unit quaternions are twice the sine of a quarter apart
                distance = np.rad2deg(4.0 * np.arcsin(min(distance / 2.0, 1.0)))
                unit = "deg"
            yield (
                name,
                (
                    f"goes to and fro between two series, {distance:.3g} {unit} apart: two senders"
                    " in one channel? give rows that tell them apart, or the topic of one"
                ),
            )


def _distance_of_two(channel: Channel) -> float | None:
    """Return the median distance [unit of the channel] of the two series between which samples jump;
    `None` where they go on as one.

    A step leads to another series where it is many times longer than usual ones, and a sample
    shortly before is as near as those of one series are.
    """
    values = channel.values
    n = len(values)
    if n < _MIN_SAMPLES:
        return None
    distances = np.empty((_BEFORE, n - _BEFORE))
    for k in range(_BEFORE):
        earlier = values[_BEFORE - 1 - k : n - 1 - k]
        distances[k] = np.linalg.norm(values[_BEFORE:] - earlier, axis=1)
    steps = distances[0]
    nearest = distances.min(axis=0)
    moved = distances[distances > 0.0]
    if not len(moved):
        return None
    usual = max(float(np.percentile(nearest, _USUAL)), float(moved.min()))
    leads_to_other = (steps > _MIN_JUMP * usual) & (nearest <= usual)
    if leads_to_other.mean() < _MIN_SHARE:
        return None
    return float(np.median(steps[leads_to_other]))
