"""What the estimator got wrong, beside what it said of itself."""

from __future__ import annotations

from typing import Any

import numpy as np

from uvms_ocp.record import Record
from uvms_ocp.report.series import quantities_at

CHANCE = 0.95
"""[-] that a true error is within its bound."""


def error_bound(record: Record, quantity: str) -> float | None:
    """What the true value of a distance or an angle at the end [m] or [rad] does not exceed with a chance of `CHANCE`.

    By the estimate alone: its value there, and the covariance of its error, taken for the same in all three axes. `None`
    where the estimator gave no covariance.
    """
    spread = record.run_meta.spread(quantity)
    told = quantities_at(record, float(record["t"][-1])).get(quantity)
    if spread is None or told is None or not np.isfinite([spread, told]).all():
        return None
    return norm_bound(told, spread)


def norm_bound(told: float, spread: float) -> float:
    """What the norm of three numbers [m or rad] does not exceed with a chance of `CHANCE`.

    Mean and variance of its square are those of a multiple of chi-squared [Patnaik1949]. told [m or rad]: the norm of their
    means. spread [m or rad]: root of the sum of their variances, which are alike.
    """
    if spread == 0.0:
        return told
    from scipy.special import gammaincinv  # a tenth of a second

    variance = spread**2 / 3.0
    mean, half = spread**2 + told**2, variance * (3.0 * variance + 2.0 * told**2)  # of the square; half its variance
    of_chi_squared = 2.0 * gammaincinv(0.5 * mean**2 / half, CHANCE)
    return float(np.sqrt(half / mean * of_chi_squared))


def estimate_table(record: Record) -> list[dict[str, Any]]:
    """One row for position [m], attitude [rad] and joints [rad or m], as far as there are; none with ideal sensors.

    ``rms`` error of an axis over the second half of the run, ``spread``: the standard deviation that the filter gave, also root
    mean square, and ``ratio`` of their squares, which is 1 where the process model holds, and None
    where the spread is 0. No rows in older records.
    """
    if not {"q_measured", "q_spread"} <= record.series.keys():
        return []
    half = slice(len(record) // 2, None)
    q, measured, spread = (record[name][half] for name in ("q", "q_measured", "q_spread"))
    floating = record.run_meta.floating
    n = spread.shape[1] - (6 if floating else 0)
    plain = n > 0 and q.shape[1] == n + (7 if floating else 0)
    rows = [_row("joints", (measured - q)[:, -n:], spread[:, -n:])] if plain else []
    if not floating:
        return rows
    # The distance of two quaternions is half the angle between them; their signs do not matter.
    signs = np.sign((q[:, 3:7] * measured[:, 3:7]).sum(axis=1, keepdims=True))
    turns = 2.0 * np.linalg.norm(signs * measured[:, 3:7] - q[:, 3:7], axis=1, keepdims=True) / np.sqrt(3.0)
    return [_row("position", (measured - q)[:, :3], spread[:, :3]), _row("attitude", turns, spread[:, 3:6]), *rows]


def _row(name: str, errors: np.ndarray, spreads: np.ndarray) -> dict[str, Any]:
    error, spread = (float(np.sqrt(np.mean(values**2))) for values in (errors, spreads))
    return {"of": name, "rms": error, "spread": spread, "ratio": (error / spread) ** 2 if spread else None}
