"""The pool recordings as the package has recordings: one for each sensor of attitude."""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.resampling import rotations, smoothed

IMU = "IMU"
MOCAP = "motion capture"
_Columns: TypeAlias = dict[str, object]
_JOINTS: _Columns = {
    "file": "{name}_joint_states.csv.gz",
    "columns": ["axis_e_pos", "axis_d_pos", "axis_c_pos", "axis_b_pos"],
}
_CAPTURED: _Columns = {"file": "{name}_mocap.csv.gz"}
_ONBOARD: _Columns = {"file": "{name}_imu.csv.gz"}
_ATTITUDE: _Columns = {
    "columns": ["x_ori", "y_ori", "z_ori", "w_ori"],
    "format": "quaternion xyzw",
}
_CHANNELS: dict[str, dict[str, _Columns]] = {
    MOCAP: {"attitude": _CAPTURED | _ATTITUDE},
    IMU: {
        "attitude": _ONBOARD | _ATTITUDE,
        "angular_velocity": _ONBOARD | {"columns": ["x_angvel", "y_angvel", "z_angvel"]},
    },
}
_BOTH: dict[str, _Columns] = {
    "joint_positions": _JOINTS,
    "position": _CAPTURED | {"columns": ["x_pose", "y_pose", "z_pose"]},
}
_WINDOW = 1.0  # [s] of the local quadratics that give velocity


def recordings_of(folder: Path) -> dict[str, list[Recording]]:
    """Read the recordings of every sensor, in the same order. Raises `InvalidInput` where there are
    none.
    """
    paths = folder.glob("*_mocap.csv.gz")
    names = sorted(path.name.removesuffix("_mocap.csv.gz") for path in paths)
    if not names:
        raise InvalidInput(
            f"{folder} holds no *_mocap.csv.gz; give the folder of the pool recordings"
        )
    recordings = {}
    for sensor in (IMU, MOCAP):
        recordings[sensor] = [_recording(folder, sensor, name) for name in names]
    return recordings


def _recording(folder: Path, sensor: str, name: str) -> Recording:
    measured = _read(folder, sensor, name)
    captured = _read(folder, MOCAP, name)
    channels = {}
    for key, channel in measured.channels.items():
        if key != "position":
            channels[key] = _forward(key, channel)
    channels["linear_velocity"] = _velocity(captured)
    channels["wrench"] = Channel(t=np.array(measured.span), values=np.zeros((2, 6)))
    return Recording(name=name, channels=channels)


def _read(folder: Path, sensor: str, name: str) -> Recording:
    channels = {}
    for key, columns in (_BOTH | _CHANNELS[sensor]).items():
        channels[key] = {"time": "time_secs", **columns}
    return mapped_recording(folder, RecordingMapping.model_validate({"channels": channels}), name)


def _forward(key: str, channel: Channel) -> Channel:
    """Both sensors look backwards: turned by 180 deg about z."""
    if key == "attitude":
        x, y, z, w = channel.values.T
        return Channel(t=channel.t, values=np.column_stack([y, -x, w, -z]))
    if key == "angular_velocity":
        return Channel(t=channel.t, values=channel.values * [-1, -1, 1])
    return channel


def _velocity(captured: Recording) -> Channel:
    """Differentiate the position that the cameras saw into a velocity in B."""
    position = captured.channel("position")
    t, rate = smoothed(position.t, position.values, _WINDOW, derivative=1)
    R = rotations(_forward("attitude", captured.channel("attitude")), t)
    return Channel(t=t, values=np.einsum("nji,nj->ni", R, rate))


def moves(recording: Recording) -> bool:
    """Whether the arm does."""
    return bool(np.ptp(recording.channel("joint_positions").values, axis=0).max() > 0.1)
