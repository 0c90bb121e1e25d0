"""What the recordings allow, by no vehicle's numbers: how far two sensors agree, and what any
filter of the commands tells.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from driven_auv.recordings import CHANNELS, MOVING, judged
from driven_auv.vehicle import ACTUATORS
from uvms_ocp.identification.predictor import Predicted, fit_percent
from uvms_ocp.identification.recording import Recording
from uvms_ocp.identification.resampling import (
    GRID,
    rotations,
    smoothed,
)
from uvms_ocp.identification.segments import PreparedRecording

WINDOW = 1.0
"""[s] of the local quadratics that differentiate position."""
MEMORY = 6.0
"""[s] of commands that a filter knows."""
_TAP = 0.2  # [s] between two coefficients of a filter
_RIDGE = 1.0
_LAGS = np.arange(-0.6, 0.61, 0.05)  # [s]


def measured_twice(recording: Recording) -> dict[str, float | None]:
    """Fits [%] of the measured velocity by the derivative of the measured position, at the lag at
    which they agree best.
    """
    position = recording.channel("position")
    velocity = recording.channel("linear_velocity")
    t, rate = smoothed(position.undelayed_t, position.values, WINDOW, derivative=1)
    rate = np.einsum("nji,nj->ni", rotations(recording.channel("attitude"), t), rate)
    inside = (velocity.undelayed_t > t[0] + WINDOW) & (velocity.undelayed_t < t[-1] - WINDOW)
    measured_t = velocity.undelayed_t[inside]
    measured = velocity.values[inside]
    fits: dict[str, float | None] = dict.fromkeys(CHANNELS)
    for k, name in enumerate(CHANNELS[:3]):
        if measured[:, k].std() <= MOVING[name]:
            continue
        fits_by_lag = []
        for lag in _LAGS:
            shifted = np.interp(measured_t + lag, t, rate[:, k])
            fits_by_lag.append(fit_percent(measured[:, k], shifted))
        fits[name] = max(fits_by_lag)
    return fits


def filtered(recordings: Sequence[PreparedRecording], step: float) -> list[dict[str, float | None]]:
    """Fits [%] of each recording by one linear filter for each channel, fitted to all of them: it
    has seen everything.
    """
    fits: list[dict[str, float | None]] = [dict.fromkeys(CHANNELS) for _ in recordings]
    for name in CHANNELS:
        moving = []
        parts = []
        for k, recording in enumerate(recordings):
            regressors, measured = _part(recording, name, step)
            if measured.std() > MOVING[name]:
                moving.append(k)
                parts.append((regressors, measured))
        for k, fit in zip(moving, _fits(parts), strict=True):
            fits[k][name] = fit
    return fits


def n_coefficients() -> int:
    """of a filter."""
    return 2 * len(ACTUATORS.names) * round(MEMORY / _TAP) + 1


def _part(prepared: PreparedRecording, name: str, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Regressors (m, n) and what was measured (m,)."""
    (whole,) = prepared.segments(step)
    repeated = Predicted(t=whole.t, rows=whole.measured, measured=whole.measured)
    measured = judged(repeated)[name][0]
    t = whole.t[1 if name == CHANNELS[3] else 0]
    edges = np.arange(t[0] - MEMORY - 1.0, t[-1] + 1.0, GRID)
    commands = prepared.commands.mean(edges)
    beyond = commands - np.clip(commands, -ACTUATORS.dead_zone, ACTUATORS.dead_zone)
    middle = (edges[1:] + edges[:-1]) / 2
    delays = np.arange(0.0, MEMORY - _TAP / 2, _TAP)
    taps = []
    for command in np.hstack([commands, beyond]).T:
        taps += [np.interp(t - delay, middle, command) for delay in delays]
    return np.column_stack([*taps, np.ones(len(t))]), measured


def _fits(parts: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[float]:
    """Return the fits [%] of parts by one linear filter, fitted to all of them."""
    all_regressors, all_measured = zip(*parts, strict=True)
    X = np.concatenate(all_regressors)
    y = np.concatenate(all_measured)
    scale = X.std(axis=0) + 1e-6
    scale[-1] = 1.0
    S = X / scale
    coefficients = np.linalg.solve(S.T @ S + _RIDGE * np.eye(len(scale)), S.T @ y) / scale
    return [fit_percent(measured, regressors @ coefficients) for regressors, measured in parts]
