"""Law of the disturbance observer: two poles at its bandwidth, so that a step is found along a known curve."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from uvms_ocp.control.force.observer import DisturbanceObserver, ObserverLaw
from uvms_ocp.errors import InvalidInput

DT = 1e-4


class Mass:
    """In free space, one axis per mass [kg]."""

    links = ()

    def __init__(self, masses: np.ndarray) -> None:
        self.masses = masses

    def mass_matrix(self, q: ca.SX) -> ca.SX:
        return ca.SX(np.diag(self.masses))

    def forward_dynamics(self, q: ca.SX, v: ca.SX, tau: ca.SX, u: ca.SX, Du_Dt: ca.SX) -> ca.SX:
        return tau / self.masses


class Scaled(Mass):
    """The same with masses that are q (1,) times as large."""

    def mass_matrix(self, q: ca.SX) -> ca.SX:
        return q * super().mass_matrix(q)

    def forward_dynamics(self, q: ca.SX, v: ca.SX, tau: ca.SX, u: ca.SX, Du_Dt: ca.SX) -> ca.SX:
        return super().forward_dynamics(q, v, tau / q, u, Du_Dt)


def observer_of(masses: np.ndarray, w: np.ndarray, limit: float = 1e3) -> DisturbanceObserver:
    return DisturbanceObserver(ObserverLaw(bandwidth=w, limit=np.full(2, limit), dt=DT), Mass(masses), 0)


@pytest.mark.parametrize("bandwidth", [(0.5, 1.0), (3.0, 4.0), (10.0, 20.0)])
def test_a_step_of_the_disturbance_is_found_as_fast_as_the_bandwidth_says(bandwidth: tuple[float, float]) -> None:
    w, masses, push = np.array(bandwidth), np.array([2.0, 180.0]), np.array([7.0, -40.0])
    observer = observer_of(masses, w)
    v, n = np.zeros(2), round(6.0 / w.min() / DT)
    for k in range(n):
        estimate = observer.update(np.zeros(0), v, np.zeros(2))
        if k % (n // 20) == 0:
            elapsed = w * k * DT
            np.testing.assert_allclose(estimate / push, 1 - (1 + elapsed) * np.exp(-elapsed), atol=2e-3)
        v = v + DT * push / masses


def test_what_a_disturbance_does_to_an_axis_is_kept_where_that_loses_its_inertia() -> None:
    masses, push, v = np.array([2.0, 180.0]), np.array([7.0, -40.0]), np.zeros(2)
    observer = DisturbanceObserver(ObserverLaw(bandwidth=np.full(2, 10.0), limit=np.full(2, 1e3), dt=DT), Scaled(masses), 1)
    for _ in range(20_000):
        found = observer.update(np.ones(1), v, np.zeros(2))
        v = v + DT * push / masses
    after = observer.update(np.full(1, 0.01), v, np.zeros(2))
    np.testing.assert_allclose(found, push, rtol=1e-3)
    np.testing.assert_allclose(after, 0.01 * push, rtol=1e-3)


def test_a_disturbance_is_never_more_than_its_limit() -> None:
    observer, v = observer_of(np.ones(2), np.full(2, 10.0), limit=2.0), np.zeros(2)
    for _ in range(10_000):
        estimate = observer.update(np.zeros(0), v, np.zeros(2))
        v = v + DT * np.array([3.0, -5.0])
        assert (np.abs(estimate) <= 2.0).all()
    np.testing.assert_allclose(estimate, [2.0, -2.0])


def test_what_is_no_number_is_not_taken_for_a_disturbance_at_its_limit() -> None:
    observer = observer_of(np.ones(2), np.full(2, 10.0))
    observer.update(np.zeros(0), np.zeros(2), np.zeros(2))
    assert np.isnan(observer.update(np.zeros(0), np.array([np.nan, 0.0]), np.zeros(2))[0])


@pytest.mark.parametrize("bandwidth", [0.0, -1.0, np.nan, 1 / DT])
def test_a_bandwidth_that_the_period_does_not_bear_is_refused(bandwidth: float) -> None:
    with pytest.raises(InvalidInput, match="bandwidth"):
        observer_of(np.ones(2), np.array([1.0, bandwidth]))
