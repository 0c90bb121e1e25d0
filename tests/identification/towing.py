"""Towing and decay tests of one axis, simulated by other code than the toolkit's."""

from __future__ import annotations

import numpy as np

NOISE = 0.005
FINE = 1e-3
"""[m/s, rad/s] of what is seen, [s] of a step."""


def moved(
    mass: float, linear: float, quadratic: float, pushes: tuple[float, ...], speed: float
) -> tuple[np.ndarray, np.ndarray]:
    """Speeds at 10 Hz under pushes that last 5 s each: ``mass v' = push - linear v - quadratic |v| v``, by small steps."""
    rng = np.random.default_rng(3)
    speeds = []
    for k in range(int(5.0 * len(pushes) / FINE)):
        if k % 100 == 0:
            speeds.append(speed)
        speed += (
            FINE
            * (pushes[int(k * FINE / 5.0)] - linear * speed - quadratic * abs(speed) * speed)
            / mass
        )
    return 0.1 * np.arange(len(speeds)), np.array(speeds) + NOISE * rng.normal(size=len(speeds))
