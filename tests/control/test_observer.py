"""Law of the disturbance observer: two poles at its bandwidth, so that a step is found along a known curve."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from uvms_ocp.control.force.observer import DisturbanceObserver

DT = 1e-4


class Mass:
    """In free space, one axis per mass [kg]."""

    def __init__(self, masses: np.ndarray) -> None:
        self.masses = masses

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        return np.diag(self.masses)

    def forward_dynamics(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
        return tau / self.masses


@pytest.mark.parametrize("bandwidth", [(0.5, 1.0), (3.0, 4.0), (10.0, 20.0)])
def test_a_step_of_the_disturbance_is_found_as_fast_as_the_bandwidth_says(bandwidth: tuple[float, float]) -> None:
    w, masses, push = np.array(bandwidth), np.array([2.0, 180.0]), np.array([7.0, -40.0])
    dynamics = cast(Any, Mass(masses))
    observer = DisturbanceObserver(dynamics, bandwidth=w, limit=np.full(2, 1e3), dt=DT)
    v, n = np.zeros(2), round(6.0 / w.min() / DT)
    for k in range(n):
        estimate = observer.update(np.zeros(0), v, np.zeros(2))
        if k % (n // 20) == 0:
            elapsed = w * k * DT
            np.testing.assert_allclose(estimate / push, 1 - (1 + elapsed) * np.exp(-elapsed), atol=2e-3)
        v = v + DT * push / masses
