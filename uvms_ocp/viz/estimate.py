"""How well the estimator knew where the robot was, and how well it said so."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uvms_ocp.arguments import checked
from uvms_ocp.record import Record
from uvms_ocp.viz.series import axis_names, has_vehicle, labelled, n_joints, phase_spans
from uvms_ocp.viz.style import AXES_XYZ, LINES, legend_beside, shade_phases, shown, stacked, styled

_SHOWN = 98.0  # [%] of the ticks whose bands fit; before the first readings they are endless


@checked
@styled
def figure_estimate(record: Record) -> Figure | None:
    """Errors of position, attitude and joints, estimate less truth, within two standard deviations that the filter gives."""
    panels = _panels(record) if {"q", "q_measured", "q_spread"} <= record.series.keys() else []
    if not panels:
        return None
    figure, axes = stacked(len(panels), 1.5, "Estimate less truth, and two standard deviations")
    for axis, (label, names, colors, errors, spreads) in zip(axes, panels, strict=True):
        _draw(axis, record["t"], names, colors, errors, spreads)
        axis.set_ylabel(label)
    shade_phases(axes, phase_spans(record), share=0.92)
    return figure


_Panel = tuple[str, Sequence[str], Sequence[str], np.ndarray, np.ndarray]


def _panels(record: Record) -> list[_Panel]:
    q, measured, spread = record["q"], record["q_measured"], record["q_spread"]
    found: list[_Panel] = []
    if has_vehicle(record):
        place, turn = 1e3 * (measured - q)[:, :3], 1e3 * _turns(q[:, 3:7], measured[:, 3:7])
        found += [
            (labelled("position", "q", "position", "m"), ("x", "y", "z"), AXES_XYZ, place, 1e3 * spread[:, :3]),
            (
                labelled("attitude", "q_spread", "attitude", "m"),
                ("roll", "pitch", "yaw"),
                AXES_XYZ,
                turn,
                1e3 * spread[:, 3:6],
            ),
        ]
    n = n_joints(record)
    if n and q.shape[1] == n + (7 if has_vehicle(record) else 0) and spread.shape[1] >= n:
        names = [shown(name, 10) for name in axis_names(record, n)]
        colors = [LINES[i % len(LINES)] for i in range(n)]
        found.append(
            (labelled("joints", "q", "joints", "m"), names, colors, 1e3 * (measured - q)[:, -n:], 1e3 * spread[:, -n:])
        )
    return found


def _turns(true: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """(n, 3) [rad] the small rotation in B from the true attitude to the measured one; quaternions (n, 4) [-] xyzw."""
    v, w, vm, wm = true[:, :3], true[:, 3:], measured[:, :3], measured[:, 3:]
    vector, scalar = w * vm - wm * v - np.cross(v, vm), w * wm + (v * vm).sum(axis=1, keepdims=True)
    return np.asarray(2.0 * np.sign(scalar) * vector)


def _draw(
    axis: Axes, t: np.ndarray, names: Sequence[str], colors: Sequence[str], errors: np.ndarray, spreads: np.ndarray
) -> None:
    for i, (name, color) in enumerate(zip(names, colors, strict=True)):
        axis.plot(t, errors[:, i], color=color, lw=0.9, label=name)
        for sign in (-2.0, 2.0):
            axis.plot(t, sign * spreads[:, i], color=color, lw=0.6, ls=":")
    largest = max(float(np.percentile(2.0 * spreads, _SHOWN)), float(np.percentile(np.abs(errors), _SHOWN)), 1e-9)
    axis.set_ylim(-1.2 * largest, 1.2 * largest)
    legend_beside(axis)
