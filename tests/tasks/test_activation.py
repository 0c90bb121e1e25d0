"""Bells: range, end values and continuous slope."""

from __future__ import annotations

import numpy as np
import pytest

from uvms_ocp.tasks.activation import SmoothActivation

BELL = SmoothActivation(0.2, 0.7)


def sampled(step: float = 1e-4) -> tuple[np.ndarray, np.ndarray]:
    x = np.arange(0.0, 1.0, step)
    return x, np.array([float(BELL.increasing(value)) for value in x])


def test_a_bell_stays_between_zero_and_one_and_rises() -> None:
    x, y = sampled()
    assert y.min() == 0.0
    assert y.max() == 1.0
    assert (np.diff(y) >= 0).all()
    assert (y[x <= BELL.start] == 0).all()
    assert (y[x >= BELL.end + 1e-12] == 1).all()


def test_a_bell_has_a_continuous_slope() -> None:
    x, y = sampled()
    curvature = np.pi**2 / 2 / (BELL.end - BELL.start) ** 2
    slope = np.gradient(y, x)
    assert np.abs(np.diff(slope)).max() <= 1.01 * curvature * (x[1] - x[0])


def test_decreasing_is_the_mirror_of_increasing() -> None:
    for x in (0.0, 0.3, 0.45, 0.6, 1.0):
        assert float(BELL.decreasing(x)) == pytest.approx(1 - float(BELL.increasing(x)), abs=1e-15)
