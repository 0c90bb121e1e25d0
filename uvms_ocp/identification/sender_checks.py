"""Doubt channels in which two senders alternate, by their samples: files that name no sender, as bags of
ROS 2, mix what is sent under one topic.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np

from uvms_ocp.identification.interleaved_series import distance_of_series, series_keys
from uvms_ocp.identification.recording import CHANNEL_KINDS, Recording

_SMOOTH = ("position", "attitude", "linear_velocity", "joint_positions")
"""Channels of what cannot jump; gyros and accelerometers may vibrate as fast as they are sampled."""


def of_senders(recording: Recording, doubted: Collection[str]) -> Iterator[tuple[str, str]]:
    """Yield channels that jump to and fro between two series; of those that are doubted already more
    is said elsewhere.
    """
    for name in _SMOOTH:
        if name not in recording.channels or name in doubted:
            continue
        values = recording.channels[name].values
        distance = distance_of_series(values)
        if distance is None:
            continue
        unit = CHANNEL_KINDS[name].unit
        if name == "attitude":  # unit quaternions are twice the sine of a quarter apart
            distance = np.rad2deg(4.0 * np.arcsin(min(distance / 2.0, 1.0)))
            unit = "deg"
        choice = "give rows that tell them apart, or the topic of one"
        keys = series_keys(values)
        if keys:
            choice = f"give rows that tell them apart, or {keys}"
        yield (
            name,
            (
                f"goes to and fro between two series, {distance:.3g} {unit} apart: two senders"
                f" in one channel? {choice}"
            ),
        )
