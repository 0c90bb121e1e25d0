"""What the recordings allow, by no vehicle's numbers: how far two sensors agree, and what any
filter of the commands tells.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from driven_auv.recordings import CHANNELS, MOVING, judged
from driven_auv.vehicle import ACTUATORS
from uvms_ocp.identification.fit import Predicted, fit_percent
from uvms_ocp.identification.recording import GRID, Recording, rotations, smoothed
from uvms_ocp.identification.rollout import PreparedRecording

WINDOW = 1.0
"""[s] of the local quadratics that differentiate position."""
MEMORY = 6.0
"""[s] of commands that a filter knows."""
# [s],
_TAP = 0.2
_RIDGE = 1.0
_LAGS = np.arange(-0.6, 0.61, 0.05)


def measured_twice(recording: Recording) -> dict[str, float | None]:
    """Fits [%] of the measured velocity by the derivative of the measured position, at the lag at
    which they agree best.
    """
    position, velocity = recording.channel("position"), recording.channel("linear_velocity")
    t, rate = smoothed(position.undelayed_t, position.values, WINDOW, derivative=1)
    rate = np.einsum("nji,nj->ni", rotations(recording.channel("attitude"), t), rate)
    inside = (velocity.undelayed_t > t[0] + WINDOW) & (velocity.undelayed_t < t[-1] - WINDOW)
    at = velocity.undelayed_t[inside]
    seen = velocity.values[inside]
    found: dict[str, float | None] = dict.fromkeys(CHANNELS)
    for k, name in enumerate(CHANNELS[:3]):
        if seen[:, k].std() > MOVING[name]:
            found[name] = max(
                fit_percent(seen[:, k], np.interp(at + lag, t, rate[:, k])) for lag in _LAGS
            )
    return found


def filtered(recordings: Sequence[PreparedRecording], step: float) -> list[dict[str, float | None]]:
    """Fits [%] of each recording by one linear filter for each channel, fitted to all of them: it
    has seen everything.
    """
    found: list[dict[str, float | None]] = [dict.fromkeys(CHANNELS) for _ in recordings]
    for name in CHANNELS:
        parts = [_part(one, name, step) for one in recordings]
        chosen = [k for k, (_, seen) in enumerate(parts) if seen.std() > MOVING[name]]
        for k, value in zip(chosen, _fits([parts[k] for k in chosen]), strict=True):
            found[k][name] = value
    return found


def n_coefficients() -> int:
    """of a filter."""
    return 2 * len(ACTUATORS.names) * round(MEMORY / _TAP) + 1


def _part(one: PreparedRecording, name: str, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Regressors (m, n) and what was seen (m,)."""
    (whole,) = one.stretches(step)
    seen = judged(Predicted(t=whole.t, rows=whole.measured, measured=whole.measured))[name][0]
    t = whole.t[1 if name == CHANNELS[3] else 0]
    edges = np.arange(t[0] - MEMORY - 1.0, t[-1] + 1.0, GRID)
    told = one.commands.mean(edges)
    beyond = told - np.clip(told, -ACTUATORS.dead_zone, ACTUATORS.dead_zone)
    middle = (edges[1:] + edges[:-1]) / 2
    past = np.arange(0.0, MEMORY - _TAP / 2, _TAP)
    taps = [
        np.interp(t - late, middle, column)
        for column in np.hstack([told, beyond]).T
        for late in past
    ]
    return np.column_stack([*taps, np.ones(len(t))]), seen


def _fits(parts: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[float]:
    X, y = np.concatenate([X for X, _ in parts]), np.concatenate([y for _, y in parts])
    scale = X.std(axis=0) + 1e-6
    scale[-1] = 1.0
    S = X / scale
    coefficients = np.linalg.solve(S.T @ S + _RIDGE * np.eye(len(scale)), S.T @ y) / scale
    return [fit_percent(seen, own @ coefficients) for own, seen in parts]
