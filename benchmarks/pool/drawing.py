"""Figures of the replay."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pool.evaluation import FITTED, FITTED_STATIC, REPLAY, STATIC
from pool.recordings import Recording
from pool.scores import compared, scores


def draw(recording: Recording, predictions: Mapping[str, np.ndarray], output: Path) -> None:
    """Figure of roll, pitch and the joints of one recording, for predictions (n, 2) [rad] by
    name.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(3, 1, sharex=True, figsize=(8, 9), constrained_layout=True)
    for name, predicted in predictions.items():
        _draw_angles(axes, recording, name, predicted)
    measured = compared(recording, predictions[REPLAY])[1]
    for axis, angle, label in zip(axes, measured.T, ("roll [deg]", "pitch [deg]"), strict=False):
        axis.plot(recording.t, angle, "k", linewidth=0.8, label="motion capture")
        axis.set_ylabel(label)
    axes[0].legend(fontsize="small")
    axes[2].plot(
        recording.joint_t, recording.joint_q, label=["joint1", "joint2", "joint3", "joint4"]
    )
    axes[2].set(xlabel="t [s]", ylabel="measured joints [rad]")
    axes[2].legend(fontsize="small")
    axes[0].set_title(_caption(recording, predictions[REPLAY]), fontsize="small")
    figure.savefig(output / f"{recording.name}.png", dpi=100)
    plt.close(figure)


def _draw_angles(axes: np.ndarray, recording: Recording, name: str, predicted: np.ndarray) -> None:
    style = ":" if name in (STATIC, FITTED_STATIC) else "-"
    colour = "C1" if name in (FITTED, FITTED_STATIC) else "C0"
    for axis, angle in zip(axes, compared(recording, predicted)[0].T, strict=False):
        axis.plot(recording.t, angle, style, color=colour, label=name)


def _caption(recording: Recording, predicted: np.ndarray) -> str:
    pitch = scores(recording, predicted)[1]
    return (
        f"{recording.name}: pitch of the replay, not fitted: {pitch.rmse:.2f} deg RMSE, correlation"
        f" {pitch.correlation:.2f}, lag {pitch.lag:+.2f} s, overshoot"
        f" {100 * pitch.overshoot:+.0f} %"
    )
