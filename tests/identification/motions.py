"""A recording without a vehicle: smooth motion in all axes, with rates that are exactly those of
its poses.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from uvms_ocp.identification.recording import Channel, Recording

DOWN = np.diag([1.0, -1.0, -1.0])


def recorded(*, t_end: float = 40.0, rate: float = 20.0, seed: int = 0) -> Recording:
    """Below the surface, rolling, pitching and turning."""
    t = np.arange(0.0, t_end, 1.0 / rate)
    rng = np.random.default_rng(seed)
    f, phase = rng.uniform(0.3, 1.2, size=6), rng.uniform(0, 6, size=6)
    size = np.array([0.5, 0.4, 0.3, 0.25, 0.2, 0.8])
    wave = np.column_stack([size[k] * np.sin(f[k] * t + phase[k]) for k in range(6)])
    rates = np.column_stack([size[k] * f[k] * np.cos(f[k] * t + phase[k]) for k in range(6)])
    quaternions = []
    linear = []
    angular = []
    for pose, speed in zip(wave, rates, strict=True):
        R = pin.rpy.rpyToMatrix(pose[3:])
        quaternions.append(pin.Quaternion(R).coeffs())
        linear.append(R.T @ speed[:3])
        angular.append(pin.rpy.computeRpyJacobian(pose[3:], pin.LOCAL) @ speed[3:])
    channels = {
        "position": wave[:, :3] + [0.0, 0.0, -2.0],
        "attitude": np.array(quaternions),
        "linear_velocity": np.array(linear),
        "angular_velocity": np.array(angular),
    }
    return Recording(
        name="made", channels={name: Channel(t=t, values=x) for name, x in channels.items()}
    )


def changed(recording: Recording, name: str, **what: object) -> Recording:
    """A copy with other fields of one channel."""
    channels = dict(recording.channels)
    channels[name] = replace(channels[name], **what)  # type: ignore[arg-type]
    return replace(recording, channels=channels)
