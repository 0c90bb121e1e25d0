"""Law of the disturbance observer: two poles at its bandwidth, so that a step is found along a
known curve.
"""

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


class Pair:
    """Two axes whose inertias are coupled [kg], as a vehicle's and a joint's."""

    links = ()
    M = np.array([[2.0, 1.0], [1.0, 3.0]])

    def mass_matrix(self, q: ca.SX) -> ca.SX:
        return ca.SX(self.M)

    def forward_dynamics(self, q: ca.SX, v: ca.SX, tau: ca.SX, u: ca.SX, Du_Dt: ca.SX) -> ca.SX:
        return ca.SX(np.linalg.inv(self.M)) @ tau


def observer_of(masses: np.ndarray, w: np.ndarray, limit: float = 1e3) -> DisturbanceObserver:
    return DisturbanceObserver(
        ObserverLaw(bandwidth=w, limit=np.full(2, limit), dt=DT), Mass(masses), 0
    )


@pytest.mark.sampled
@pytest.mark.parametrize("bandwidth", [(0.5, 1.0), (3.0, 4.0), (10.0, 20.0)])
def test_a_step_of_the_disturbance_is_found_as_fast_as_the_bandwidth_says(
    bandwidth: tuple[float, float],
) -> None:
    w = np.array(bandwidth)
    masses = np.array([2.0, 180.0])
    push = np.array([7.0, -40.0])
    observer = observer_of(masses, w)
    v = np.zeros(2)
    n = round(6.0 / w.min() / DT)
    for k in range(n):
        estimate = observer.update(np.zeros(0), v, np.zeros(2))
        if k % (n // 20) == 0:
            elapsed = w * k * DT
            np.testing.assert_allclose(
                estimate / push, 1 - (1 + elapsed) * np.exp(-elapsed), atol=2e-3
            )
        v = v + DT * push / masses


def test_what_a_disturbance_does_to_an_axis_is_kept_where_that_loses_its_inertia() -> None:
    masses = np.array([2.0, 180.0])
    push = np.array([7.0, -40.0])
    v = np.zeros(2)
    observer = DisturbanceObserver(
        ObserverLaw(bandwidth=np.full(2, 10.0), limit=np.full(2, 1e3), dt=DT), Scaled(masses), 1
    )
    for _ in range(20_000):
        estimate = observer.update(np.ones(1), v, np.zeros(2))
        v = v + DT * push / masses
    after = observer.update(np.full(1, 0.01), v, np.zeros(2))
    np.testing.assert_allclose(estimate, push, rtol=1e-3)
    np.testing.assert_allclose(after, 0.01 * push, rtol=1e-3)


def test_a_disturbance_is_never_more_than_its_limit() -> None:
    observer = observer_of(np.ones(2), np.full(2, 10.0), limit=2.0)
    v = np.zeros(2)
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


@pytest.mark.parametrize("bandwidth", [(3.0, 4.0), (4.0, 3.0), (3.0, 1.0), (1.0, 3.0), (3.0, 0.2)])
@pytest.mark.parametrize("dt", [1 / 20, 1 / 200])
def test_what_acts_on_the_faster_axis_is_not_taken_for_a_push_on_the_slower_one(
    bandwidth: tuple[float, float], dt: float
) -> None:
    """A reversed thruster whose push grew was a torque of 17 N m on joints whose encoders were
    doubted; they drove the arm.
    """
    law = ObserverLaw(bandwidth=np.array(bandwidth), limit=np.full(2, 1e3), dt=dt)
    observer = DisturbanceObserver(law, Pair(), 0)
    fast = int(np.argmax(bandwidth))
    v = np.zeros(2)
    for k in range(round(4.0 / dt)):
        estimate = observer.update(np.zeros(0), v, np.zeros(2))
        v = v + dt * np.linalg.solve(Pair.M, 20.0 * k * dt * np.eye(2)[fast])
    assert estimate[fast] > 40.0
    assert abs(estimate[1 - fast]) < 1e-9


@pytest.mark.parametrize("fast", [0, 1])
def test_a_slow_axis_whose_velocity_is_wrong_drives_the_fast_one_by_no_more_than_its_own_gain(
    fast: int,
) -> None:
    bandwidth = np.where(np.arange(2) == fast, 8.0, 1.0)
    observer = DisturbanceObserver(
        ObserverLaw(bandwidth=bandwidth, limit=np.full(2, 1e3), dt=0.01), Pair(), 0
    )
    observer.update(np.zeros(0), np.zeros(2), np.zeros(2))
    wrong = 0.3 * np.eye(2)[1 - fast]
    np.testing.assert_allclose(
        observer.update(np.zeros(0), wrong, np.zeros(2)), 0.01 * Pair.M @ wrong, rtol=1e-9
    )
