"""The recordings, and what is judged of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.predictor import Predicted
from uvms_ocp.identification.recording import Recording

CHANNELS = ("surge", "sway", "heave", "yaw rate")
MOVING = {"surge": 0.03, "sway": 0.03, "heave": 0.03, "yaw rate": 0.05}
"""[m/s, rad/s] standard deviations above which a channel of a recording is judged."""
_NAVIGATION = {
    "file": "navigation_state_{name}.csv.gz",
    "time": "field.header.stamp",
    "time_unit": "ns",
}
_DOWN = {"body": "FRD"}


def _columns(name: str) -> list[str]:
    return [f"field.{name}.{axis}" for axis in "xyz"]


MAPPING = RecordingMapping.model_validate(
    {
        "channels": {
            "position": {**_NAVIGATION, "columns": _columns("position"), "world": "NED"},
            "attitude": {
                **_NAVIGATION,
                **_DOWN,
                "columns": _columns("orientation"),
                "format": "rpy",
                "world": "NED",
            },
            "linear_velocity": {
                **_NAVIGATION,
                **_DOWN,
                "columns": _columns("velocity"),
                "lost": "all zero",
            },
            "wrench": {
                "file": "wrench_{name}.csv.gz",
                "time": "%time",
                "time_unit": "ns",
                **_DOWN,
                "columns": [*_columns("force"), *_columns("torque")],
                "sent_every": 0.02,
            },
        }
    }
)
"""Messages came in bursts, through a link with gaps; what lost its lock shows zeros."""


def read_recordings(folder: Path) -> list[Recording]:
    """Read all recordings of a folder. Raises `InvalidInput` where there are none."""
    numbers = []
    for path in folder.glob("wrench_*.csv.gz"):
        number, _, _ = path.name.removeprefix("wrench_").partition(".")
        numbers.append(number)
    if not numbers:
        raise InvalidInput(f"{folder} holds no wrench_*.csv.gz; give the folder of the recordings")
    return [mapped_recording(folder, MAPPING, number) for number in sorted(numbers, key=int)]


def judged(predicted: Predicted) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return what was measured and what was predicted (m,) [m/s, rad/s], by channel."""
    pairs = {}
    for k, name in enumerate(CHANNELS[:3]):
        pairs[name] = (predicted.measured[0][:, k], predicted.rows[0][:, k])
    pairs[CHANNELS[3]] = (
        yaw_rate(predicted, predicted.measured),
        yaw_rate(predicted, predicted.rows),
    )
    return pairs


def yaw_rate(predicted: Predicted, rows: tuple[np.ndarray, ...]) -> np.ndarray:
    """Rate (m,) [rad/s] from the angular velocity (m, 3) and the vertical in B, which are rows."""
    t_rate = predicted.t[1]
    t_vertical = predicted.t[2]
    _, pitch_rate, yaw_rate_B = rows[1].T
    up_y = np.interp(t_rate, t_vertical, rows[2][:, 1])
    up_z = np.interp(t_rate, t_vertical, rows[2][:, 2])
    return np.asarray((up_y * pitch_rate + up_z * yaw_rate_B) / (up_y**2 + up_z**2))
