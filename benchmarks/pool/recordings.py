"""The pool recordings of H. Kolano, UVMS-SysID-with-EAs (2023): measured joints in, measured
vehicle attitude out.
"""

from __future__ import annotations

import csv
import gzip
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter

from uvms_ocp.errors import InvalidInput

SAMPLE_TIME = 0.02
"""[s] of the resampled joint motion; recorded at about 46 Hz."""
SMOOTHING = 21
"""Samples of the local cubics that give velocity and acceleration."""
_ARM_AXES = ("axis_e_pos", "axis_d_pos", "axis_c_pos", "axis_b_pos")  # from the base to the tip


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Recording:
    """One recording; times from the start of its files."""

    name: str
    joint_t: np.ndarray
    """(n,) [s], uniform."""
    joint_q: np.ndarray
    """(n, 4) [rad]"""
    joint_v: np.ndarray
    """(n, 4) [rad/s]"""
    joint_a: np.ndarray
    """(n, 4) [rad/s^2]"""
    t: np.ndarray
    """(m,) [s] of the motion capture, inside the time of the joints."""
    attitude: np.ndarray
    """(m, 2) [rad] measured roll and pitch of the vehicle."""

    @property
    def moves(self) -> bool:
        """Whether the arm moves."""
        return bool(np.ptp(self.joint_q, axis=0).max() > 0.1)


def read_recordings(folder: Path) -> list[Recording]:
    """Read all recordings of a folder. Raises `InvalidInput` where there are none."""
    paths = folder.glob("*_mocap.csv.gz")
    names = sorted(path.name.removesuffix("_mocap.csv.gz") for path in paths)
    if not names:
        raise InvalidInput(
            f"{folder} holds no *_mocap.csv.gz; give the folder of the pool recordings"
        )
    return [_read_recording(folder, name) for name in names]


def _read_recording(folder: Path, name: str) -> Recording:
    joints = _read_columns(folder / f"{name}_joint_states.csv.gz", ("time_secs", *_ARM_AXES))
    mocap = _read_columns(folder / f"{name}_mocap.csv.gz", ("time_secs", "roll", "pitch"))
    joint_t = np.arange(joints[0, 0], min(joints[-1, 0], mocap[-1, 0]), SAMPLE_TIME)
    measured_t, *measured_angles = joints.T
    angles = np.column_stack([np.interp(joint_t, measured_t, angle) for angle in measured_angles])
    mocap = mocap[(mocap[:, 0] >= joint_t[0]) & (mocap[:, 0] <= joint_t[-1])]
    return Recording(
        name=name,
        joint_t=joint_t,
        joint_q=_smooth(angles, 0),
        joint_v=_smooth(angles, 1),
        joint_a=_smooth(angles, 2),
        t=mocap[:, 0],
        attitude=-mocap[:, 1:],  # the motion capture's body frame is turned by 180 deg about z
    )


def _smooth(angles: np.ndarray, derivative: int) -> np.ndarray:
    smooth: np.ndarray = savgol_filter(
        angles, SMOOTHING, 3, deriv=derivative, delta=SAMPLE_TIME, axis=0
    )
    return smooth


def _read_columns(path: Path, columns: tuple[str, ...]) -> np.ndarray:
    with gzip.open(path, "rt", encoding="utf-8") as lines:
        rows = []
        for row in csv.DictReader(lines):
            rows.append([float(row[name]) for name in columns])
        return np.array(rows)
