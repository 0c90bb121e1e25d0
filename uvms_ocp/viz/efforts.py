"""What a mission on the physical plant cost: thrust, torque, power, tracking and disturbance."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uvms_ocp.arguments import checked
from uvms_ocp.record import Record
from uvms_ocp.viz.series import axis_names, has_vehicle, labelled
from uvms_ocp.viz.style import AXES_XYZ, BLUE, DASHES, LINES, VERMILLION, legend_beside, shown, stacked, styled
from uvms_ocp.viz.time_marks import mark_time

_PARTS = ("force", "moment")
_TRACKED = {"velocity": "linear", "rate": "angular"}


@checked
@styled
def figure_efforts(record: Record) -> Figure | None:
    """Thrust of every thruster, or the planned wrench, torque of every joint, and the energy taken so far."""
    draw = next((drawn for name, drawn in _PUSHES.items() if name in record.series), None)
    if draw is None or "joint_energy" not in record.series:
        return None
    n_pushes = 1 if draw is _thrust else len(_PARTS)
    figure, axes = stacked(n_pushes + 2, 1.5, "Forces, torque and energy")
    draw(record, axes[:n_pushes])
    _torque(record, axes[-2])
    _energy(record, axes[-1])
    for axis in axes:
        legend_beside(axis)
    mark_time(axes, record, share=0.92)
    return figure


def _thrust(record: Record, axes: Sequence[Axes]) -> None:
    for i, thrust in enumerate(record["thrust"].T):
        style = DASHES[i // len(LINES) % len(DASHES)]
        axes[0].plot(record["t"], thrust, color=LINES[i % len(LINES)], ls=style, lw=0.8, label=f"thruster{i + 1}")
    axes[0].set_ylabel(labelled("thrust", "thrust"))


def _wrench(record: Record, axes: Sequence[Axes]) -> None:
    for axis, part, values in zip(axes, _PARTS, np.hsplit(record["wrench"], len(_PARTS)), strict=True):
        for color, name, column in zip(AXES_XYZ, "xyz", values.T, strict=True):
            axis.plot(record["t"], column, color=color, lw=0.8, label=name)
        axis.set_ylabel(labelled(part, "wrench", part))


_PUSHES: Mapping[str, Callable[[Record, Sequence[Axes]], None]] = {"thrust": _thrust, "wrench": _wrench}


def _torque(record: Record, axis: Axes) -> None:
    names = axis_names(record, record["torque"].shape[1])
    for i, (name, torque) in enumerate(zip(names, record["torque"].T, strict=True)):
        axis.plot(record["t"], torque, color=LINES[i % len(LINES)], lw=0.8, label=shown(name, 10))
    axis.set_ylabel(labelled("torque", "torque"))


def _energy(record: Record, axis: Axes) -> None:
    thrusters = record["thruster_energy"].sum(axis=1)
    unknown = " (not known)" if np.isnan(thrusters).any() else ""
    axis.plot(record["t"], thrusters, color=BLUE, label=f"thrusters{unknown}")
    axis.plot(record["t"], record["joint_energy"], color=VERMILLION, label="joints")
    axis.set_ylabel(labelled("energy", "joint_energy"))


@checked
@styled
def figure_tracking(record: Record) -> Figure | None:
    """How well the vehicle follows its reference velocity, and the force that the observer holds responsible."""
    if "disturbance" not in record.series or not has_vehicle(record):
        return None
    t, error = record["t"], record["v"] - record["command"]
    figure, axes = stacked(3, 1.5, "Velocity tracking and estimated disturbance")
    for i, (color, names) in enumerate(zip(AXES_XYZ, ("surge, roll", "sway, pitch", "heave, yaw"), strict=True)):
        linear, angular = names.split(", ")
        axes[0].plot(t, 1e3 * error[:, i], color=color, lw=0.9, label=linear)
        axes[1].plot(t, 1e3 * error[:, 3 + i], color=color, lw=0.9, label=angular)
        axes[2].plot(t, record["disturbance"][:, i], color=color, lw=0.9, label=linear)
    velocity, rate = (labelled(f"{what} error", "v", part, "m") for what, part in _TRACKED.items())
    labels = (velocity, rate, labelled("disturbance", "disturbance", "force"))
    for axis, label in zip(axes, labels, strict=True):
        axis.set_ylabel(label)
        legend_beside(axis)
        axis.set_ylim(*_robust_range(axis.lines))
    mark_time(axes, record, share=0.92)
    return figure


def _robust_range(lines: object) -> tuple[float, float]:
    """Limits that show all but the most extreme thousandth of all lines."""
    values = np.concatenate([np.asarray(line.get_ydata()) for line in lines])  # type: ignore[attr-defined]
    low, high = np.percentile(values, [0.05, 99.95])
    margin = 0.1 * max(high - low, 1e-9)
    return float(low - margin), float(high + margin)
