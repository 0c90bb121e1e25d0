"""Laws of allocation without thrusters that are faulty."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from uvms_ocp.control.faults.verdicts import ThrusterEffectiveness
from uvms_ocp.control.force.allocation import Allocation, allocation_of
from uvms_ocp.robot.loading import list_robots, load_robot

ROBOTS = [name for name in list_robots() if load_robot(name).description.thrusters]
EFFECTS = {
    "dead": ({0: 0.0}, {}),
    "two dead": ({0: 0.0, 3: 0.0}, {}),
    "weak": ({1: 0.4}, {}),
    "reversed": ({2: -0.9}, {}),
    "stuck": ({1: 0.0}, {1: 0.3}),
    "all at once": ({0: 0.0, 1: 0.5, 2: -1.0, 3: 0.0}, {3: -0.2}),
}
WRENCHES = np.random.default_rng(0).normal(size=(100, 6)) * np.geomspace(0.01, 3.0, 100)[:, None]


@pytest.fixture(params=ROBOTS, scope="module")
def whole(request: pytest.FixtureRequest) -> Allocation:
    return allocation_of(load_robot(request.param))


@pytest.fixture(params=EFFECTS, scope="module")
def effectiveness(request: pytest.FixtureRequest, whole: Allocation) -> ThrusterEffectiveness:
    shares, constants = EFFECTS[request.param]
    n = len(whole.upper)
    share = np.ones(n)
    constant = np.zeros(n)
    for i, value in shares.items():
        share[i] = value
    for i, value in constants.items():
        constant[i] = value * whole.upper[i]
    return ThrusterEffectiveness(share=share, constant=constant)


@pytest.fixture(scope="module")
def wrenches(whole: Allocation) -> np.ndarray:
    """From gentle to far beyond the limits, in the size of this robot."""
    return WRENCHES * np.linalg.norm(whole.matrix * whole.upper, axis=1)


def test_what_is_asked_stays_inside_the_limits_and_nothing_is_asked_of_what_does_not_follow(
    whole: Allocation, effectiveness: ThrusterEffectiveness, wrenches: np.ndarray
) -> None:
    degraded = replace(whole, effectiveness=effectiveness)
    for wrench in wrenches:
        result = degraded.allocate(wrench)
        requested = effectiveness.asked(result.thrust)
        assert (requested >= whole.lower - 1e-9).all()
        assert (requested <= whole.upper + 1e-9).all()
        assert not requested[effectiveness.share == 0.0].any()
        np.testing.assert_allclose(effectiveness.given(requested), result.thrust, atol=1e-9)


def test_no_thrust_without_the_faulty_ones_comes_closer(
    whole: Allocation, effectiveness: ThrusterEffectiveness, wrenches: np.ndarray
) -> None:
    degraded = replace(whole, effectiveness=effectiveness)
    is_alive = effectiveness.share != 0.0
    ends = np.array([effectiveness.share * whole.lower, effectiveness.share * whole.upper])[
        :, is_alive
    ]
    constant_wrench = whole.matrix @ effectiveness.constant
    weight = whole.wrench_weight
    for wrench in wrenches:
        result = degraded.allocate(wrench)
        np.testing.assert_allclose(
            result.reached + result.unreachable, wrench, rtol=1e-12, atol=1e-9
        )
        np.testing.assert_allclose(whole.matrix @ result.thrust, result.reached, atol=1e-9)
        cost = 0.5 * np.sum((weight * result.unreachable) ** 2)
        limits = (ends.min(axis=0), ends.max(axis=0))
        matrix = weight[:, None] * whole.matrix[:, is_alive]
        requested = weight * (wrench - constant_wrench)
        oracle = lsq_linear(matrix, requested, limits, method="bvls", tol=1e-15)
        assert cost <= oracle.cost + 1e-9 * (1.0 + requested @ requested)


def test_fewer_thrusters_never_come_closer_nor_take_less_power_for_the_same_wrench(
    whole: Allocation, wrenches: np.ndarray
) -> None:
    n = len(whole.upper)
    degraded = replace(
        whole,
        effectiveness=ThrusterEffectiveness(share=np.r_[0.0, np.ones(n - 1)], constant=np.zeros(n)),
    )
    for wrench in wrenches:
        by_works = degraded.allocate(wrench)
        all_of_them = whole.allocate(wrench)
        lost, optimum = (
            np.linalg.norm(whole.wrench_weight * result.unreachable)
            for result in (by_works, all_of_them)
        )
        assert lost >= optimum - 1e-9 * max(1.0, optimum)
        same = whole.allocate(by_works.reached)
        assert power(whole, by_works.thrust) >= (1.0 - 5e-3) * power(whole, same.thrust)


def test_a_weak_thruster_is_spared_for_its_power() -> None:
    whole = allocation_of(load_robot("girona_maris7_full"))
    share = np.ones(8)
    share[4] = 0.5
    damaged = replace(whole, effectiveness=ThrusterEffectiveness(share=share, constant=np.zeros(8)))
    thrust = damaged.allocate([0, 0, 40.0, 0, 0, 0]).thrust
    np.testing.assert_allclose(whole.matrix @ thrust, [0, 0, 40.0, 0, 0, 0], atol=1e-6)
    # The others can only do as much as the balance of roll and pitch allows.
    np.testing.assert_allclose(
        thrust[4:], [thrust[4], 20.0 - thrust[4], 20.0 - thrust[4], thrust[4]], atol=1e-6
    )
    assert 0.0 < thrust[4] < 9.0


def power(allocation: Allocation, thrust: np.ndarray) -> float:
    return float(allocation.power_factor @ np.abs(thrust) ** allocation.power_exponent)


def test_sound_thrusters_give_what_they_are_asked_to_the_last_bit() -> None:
    effectiveness = ThrusterEffectiveness.sound(8)
    thrust = np.random.default_rng(0).normal(size=8)
    np.testing.assert_array_equal(effectiveness.given(thrust), thrust)
    np.testing.assert_array_equal(effectiveness.asked(thrust), thrust)


def test_without_limits_it_is_the_thrust_of_least_squares_and_least_weighted_norm(
    whole: Allocation, effectiveness: ThrusterEffectiveness
) -> None:
    works = effectiveness.works
    n = len(whole.upper)
    factor = np.linspace(1.0, 3.0, n)
    square = {"power_exponent": np.full(n, 2.0), "power_factor": factor, "dead_zone": np.zeros(n)}
    free = replace(
        whole, lower=np.full(n, -1e6), upper=np.full(n, 1e6), effectiveness=effectiveness, **square
    )
    root = np.sqrt(factor[works]) / np.abs(effectiveness.share[works])
    weight = whole.wrench_weight
    oracle = (
        np.linalg.pinv(weight[:, None] * whole.matrix[:, works] / root, rcond=1e-9) / root[:, None]
    )
    for wrench in WRENCHES:
        thrust = oracle @ (weight * (wrench - whole.matrix @ effectiveness.constant))
        scale = np.abs(thrust).max()
        np.testing.assert_allclose(
            free.allocate(wrench).thrust[works], thrust, rtol=1e-9, atol=1e-9 * scale
        )


def test_the_thrust_of_random_thrusters_of_any_rank_is_that_of_least_squares() -> None:
    rng = np.random.default_rng(5)
    for k in range(200):
        n = int(rng.integers(1, 13))
        rank = int(rng.integers(1, 7))
        matrix = rng.normal(size=(6, rank)) @ rng.normal(size=(rank, n))
        limit = np.full(n, 1e6)
        plain = {
            "power_factor": np.ones(n),
            "power_exponent": np.full(n, 2.0),
            "dead_zone": np.zeros(n),
        }
        free = Allocation(matrix=matrix, lower=-limit, upper=limit, **plain)
        wrench = rng.normal(size=6)
        thrust = np.linalg.lstsq(matrix, wrench, rcond=1e-9)[0]
        scale = np.abs(thrust).max()
        np.testing.assert_allclose(
            free.allocate(wrench).thrust, thrust, rtol=1e-7, atol=1e-7 * scale, err_msg=str(k)
        )
