"""Replay of the pool recordings: ``python benchmarks/hinsdale_replay.py PATH [--output FOLDER]``.

Simulates the vehicle without thrust under the measured joint motion and compares roll and pitch with the motion
capture, the mean of the first 2 s removed from both. Then the vehicle's centre of buoyancy is fitted, always on
the other moving recordings, and reported apart.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from hinsdale_recordings import SAMPLE_TIME, Recording, read_recordings
from hinsdale_vehicle import PoolVehicle, pool_vehicle
from scipy.optimize import least_squares

matplotlib.use("Agg")
_OFFSET_TIME = 2.0  # [s] whose mean is removed
_LARGEST_LAG = 1.5  # [s]

Predictor = Callable[[PoolVehicle, Recording, np.ndarray], np.ndarray]  # shift (3,) -> (n, 2) at joint_t


@dataclass(frozen=True, kw_only=True, slots=True)
class Score:
    """Agreement of one angle over one recording."""

    rmse: float  # [deg]
    correlation: float
    lag: float  # [s] of the prediction behind the measurement, where they agree best; nan: at no lag they do
    overshoot: float  # [-] peak-to-peak of the prediction over that of the measurement, less 1


def static_balance(vehicle: PoolVehicle, recording: Recording, shift: np.ndarray) -> np.ndarray:
    """Roll and pitch (n, 2) [rad] at which weight and buoyancy balance, at the times of the joints."""
    righting = vehicle.righting.map(len(recording.joint_t))(recording.joint_q.T, shift)
    return roll_pitch(np.asarray(righting).T)


def replay(vehicle: PoolVehicle, recording: Recording, shift: np.ndarray) -> np.ndarray:
    """Simulated roll and pitch (n, 2) [rad] at the times of the joints, from rest in the static balance."""
    joints = np.hstack([recording.joint_q, recording.joint_v, recording.joint_a])
    n_steps = (len(joints) - 1) // 2  # a step spans two samples, the middle one serves Runge-Kutta
    windows = np.hstack([joints[2 * k : 2 * k + 3].T for k in range(n_steps)])
    start = np.concatenate([_quaternion(static_balance(vehicle, recording, shift)[0]), np.zeros(6)])
    path = vehicle.step.mapaccum(n_steps)(start, windows, shift, 2 * SAMPLE_TIME)
    quaternions = np.vstack([start[:4], np.asarray(path).T[:, :4]])
    attitude = roll_pitch(_up(quaternions))
    return _at(recording.joint_t, recording.joint_t[: 2 * n_steps + 1 : 2], attitude)


def roll_pitch(up: np.ndarray) -> np.ndarray:
    """Roll and pitch (n, 2) [rad] of a vehicle that sees the vertical along up (n, 3), of any length."""
    x, y, z = up.T
    return np.column_stack([np.arctan2(y, z), -np.arctan2(x, np.hypot(y, z))])


def _up(quaternions: np.ndarray) -> np.ndarray:
    x, y, z, w = quaternions.T
    return np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])


def _quaternion(attitude: np.ndarray) -> np.ndarray:
    (sr, sp), (cr, cp) = np.sin(attitude / 2), np.cos(attitude / 2)
    return np.array([sr * cp, cr * sp, -sr * sp, cr * cp])


def _at(t: np.ndarray, known_t: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(t, known_t, column) for column in values.T])


def compared(recording: Recording, predicted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Predicted and measured roll and pitch (m, 2) [deg] at the times of the motion capture, without their offsets."""
    at_mocap = _at(recording.t, recording.joint_t, predicted)
    return _without_offset(recording, at_mocap), _without_offset(recording, recording.attitude)


def _without_offset(recording: Recording, attitude: np.ndarray) -> np.ndarray:
    first = recording.t <= recording.t[0] + _OFFSET_TIME
    return np.degrees(attitude - attitude[first].mean(axis=0))


def scores(recording: Recording, predicted: np.ndarray) -> tuple[Score, Score]:
    """Agreement of roll and of pitch."""
    simulated, measured = compared(recording, predicted)
    roll, pitch = (_score(recording.t, simulated[:, i], measured[:, i]) for i in (0, 1))
    return roll, pitch


def _score(t: np.ndarray, simulated: np.ndarray, measured: np.ndarray) -> Score:
    return Score(
        rmse=float(np.sqrt(np.mean((simulated - measured) ** 2))),
        correlation=float(np.corrcoef(simulated, measured)[0, 1]),
        lag=_lag(t, simulated, measured),
        overshoot=float(np.ptp(simulated) / np.ptp(measured) - 1.0),
    )


def _lag(t: np.ndarray, simulated: np.ndarray, measured: np.ndarray) -> float:
    lags = np.arange(-_LARGEST_LAG, _LARGEST_LAG + 1e-9, 0.02)
    inside = (t >= t[0] + _LARGEST_LAG) & (t <= t[-1] - _LARGEST_LAG)
    shifted = [np.interp(t[inside] + lag, t, simulated) for lag in lags]
    best = int(np.argmax([np.corrcoef(values, measured[inside])[0, 1] for values in shifted]))
    return float(lags[best]) if 0 < best < len(lags) - 1 else np.nan


def fit_shift(vehicle: PoolVehicle, recordings: Sequence[Recording], predict: Predictor) -> np.ndarray:
    """Shift (3,) [m] of the centre of buoyancy that fits roll and pitch of all the recordings best."""

    def residuals(shift_cm: np.ndarray) -> np.ndarray:
        predictions = [(recording, predict(vehicle, recording, shift_cm / 100)) for recording in recordings]
        return np.concatenate([_errors(*prediction) for prediction in predictions])

    return least_squares(residuals, np.zeros(3), diff_step=1e-2, bounds=(-4.0, 4.0)).x / 100


def _errors(recording: Recording, predicted: np.ndarray) -> np.ndarray:
    simulated, measured = compared(recording, predicted)
    return ((simulated - measured) / np.sqrt(len(measured))).ravel()


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """One line of the table."""

    recording: str
    prediction: str
    shift_mm: str
    roll_rmse: float
    roll_correlation: float
    roll_lag: float
    roll_overshoot: float
    pitch_rmse: float
    pitch_correlation: float
    pitch_lag: float
    pitch_overshoot: float


def _row(recording: Recording, prediction: str, shift: np.ndarray, predicted: np.ndarray) -> Row:
    values = [value for score in scores(recording, predicted) for value in astuple(score)]
    shift_mm = " ".join(f"{1000 * value:.1f}" for value in shift)
    return Row(**dict(zip(_COLUMNS, [recording.name, prediction, shift_mm, *values], strict=True)))


_COLUMNS = [field.name for field in fields(Row)]
_STATIC, _REPLAY, _FITTED_STATIC, _FITTED = "static", "replay", "static, fitted", "replay, fitted"


def evaluate(vehicle: PoolVehicle, recordings: Sequence[Recording], output: Path) -> list[Row]:
    """Rows of all recordings and predictions; draws one figure per recording into output."""
    rows: list[Row] = []
    for recording in recordings:
        others = [other for other in recordings if other.moves and other is not recording]
        shift = fit_shift(vehicle, others, replay)
        predictions = {
            _STATIC: (np.zeros(3), static_balance(vehicle, recording, np.zeros(3))),
            _REPLAY: (np.zeros(3), replay(vehicle, recording, np.zeros(3))),
            _FITTED_STATIC: (shift, static_balance(vehicle, recording, shift)),
            _FITTED: (shift, replay(vehicle, recording, shift)),
        }
        rows += [_row(recording, name, *prediction) for name, prediction in predictions.items()]
        draw(recording, {name: predicted for name, (_, predicted) in predictions.items()}, output)
    return rows


def draw(recording: Recording, predictions: dict[str, np.ndarray], output: Path) -> None:
    """Figure of roll, pitch and the joints of one recording."""
    figure, axes = plt.subplots(3, 1, sharex=True, figsize=(8, 9), constrained_layout=True)
    for name, predicted in predictions.items():
        _draw_angles(axes, recording, name, predicted)
    measured = compared(recording, predictions[_REPLAY])[1]
    for axis, angle, label in zip(axes, measured.T, ("roll [deg]", "pitch [deg]"), strict=False):
        axis.plot(recording.t, angle, "k", linewidth=0.8, label="motion capture")
        axis.set_ylabel(label)
    axes[0].legend(fontsize="small")
    axes[2].plot(recording.joint_t, recording.joint_q, label=["joint1", "joint2", "joint3", "joint4"])
    axes[2].set(xlabel="t [s]", ylabel="measured joints [rad]")
    axes[2].legend(fontsize="small")
    axes[0].set_title(_caption(recording, predictions[_REPLAY]), fontsize="small")
    figure.savefig(output / f"{recording.name}.png", dpi=100)
    plt.close(figure)


def _draw_angles(axes: np.ndarray, recording: Recording, name: str, predicted: np.ndarray) -> None:
    style = ":" if name in (_STATIC, _FITTED_STATIC) else "-"
    colour = "C1" if name in (_FITTED, _FITTED_STATIC) else "C0"
    for axis, angle in zip(axes, compared(recording, predicted)[0].T, strict=False):
        axis.plot(recording.t, angle, style, color=colour, label=name)


def _caption(recording: Recording, predicted: np.ndarray) -> str:
    pitch = scores(recording, predicted)[1]
    return (
        f"{recording.name}: pitch of the replay, not fitted: {pitch.rmse:.2f} deg RMSE, correlation "
        f"{pitch.correlation:.2f}, lag {pitch.lag:+.2f} s, overshoot {100 * pitch.overshoot:+.0f} %"
    )


def _text(rows: Iterable[Row], moving: set[str]) -> str:
    rows = list(rows)
    lines = ["  ".join(_COLUMNS), *("  ".join(_cell(value) for value in astuple(row)) for row in rows), ""]
    for prediction in (_STATIC, _REPLAY, _FITTED_STATIC, _FITTED):
        chosen = [row for row in rows if row.prediction == prediction and row.recording in moving]
        roll, pitch = (np.median([getattr(row, name) for row in chosen]) for name in ("roll_rmse", "pitch_rmse"))
        lines.append(f"median RMSE of {len(chosen)} moving, {prediction}: roll {roll:.2f}, pitch {pitch:.2f} deg")
    return "\n".join(lines) + "\n"


def _cell(value: str | float) -> str:
    return value.ljust(16) if isinstance(value, str) else f"{value:6.2f}"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("path", type=Path, help="folder of the recordings")
    parser.add_argument("--output", type=Path, default=Path("hinsdale-replay"), help="folder of table and figures")
    arguments = parser.parse_args()
    recordings = read_recordings(arguments.path)
    arguments.output.mkdir(parents=True, exist_ok=True)
    rows = evaluate(pool_vehicle(), recordings, arguments.output)
    with (arguments.output / "table.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([_COLUMNS, *map(astuple, rows)])
    sys.stdout.write(_text(rows, {recording.name for recording in recordings if recording.moves}))


if __name__ == "__main__":
    main()
