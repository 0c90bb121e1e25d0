"""Laws of the simulated thrusters."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.integrate import quad

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.description import Thruster
from uvms_ocp.robot.electrical_power import joint_power
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import (
    curve_of_table,
    thrust_of_signals,
    unactuated_axes,
    unreachable_axes,
)
from uvms_ocp.sim.thrusters import N_DECAYS, Thrusters


def robot_with(**changes: object) -> Robot:
    """girona_maris7 with every thruster changed."""
    robot = load_robot("girona_maris7")
    thrusters = tuple(
        Thruster.model_validate({**dict(thruster), **changes})
        for thruster in robot.description.thrusters
    )
    return replace(robot, description=robot.description.model_copy(update={"thrusters": thrusters}))


class ThrusterBank:
    """The expressions of `Thrusters`, called step by step."""

    def __init__(self, robot: Robot) -> None:
        self.model = Thrusters.of(robot)
        n = len(robot.description.thrusters)
        thrust = ca.SX.sym("f", n)
        requested = ca.SX.sym("c", n)
        decay = ca.SX.sym("d", n, N_DECAYS)
        dt = ca.SX.sym("h")
        share = ca.SX.sym("s", n)
        offset = ca.SX.sym("o", n)
        after = self.model.step(thrust, self.model.target(requested, share, offset), decay, dt)
        self._step = ca.Function("bank", [thrust, requested, share, offset, decay, dt], after)
        self.thrust = np.zeros(n)
        self.energy = np.zeros(n)
        self.share = np.ones(n)
        self.offset = np.zeros(n)

    def step(self, command: ArrayLike, dt: float) -> np.ndarray:
        decay = self.model.decay(dt)
        after, energy = self._step(
            self.thrust, np.array(command), self.share, self.offset, decay, dt
        )
        self.thrust = np.array(after)[:, 0]
        self.energy = self.energy + np.array(energy)[:, 0]
        return self.thrust

    @property
    def power(self) -> np.ndarray:
        return np.array(ca.evalf(self.model.power(ca.SX(self.thrust))))[:, 0]


@pytest.mark.parametrize("dt", [1e-3, 0.02, 0.5])
def test_lag_is_the_exact_exponential(dt: float) -> None:
    bank = ThrusterBank(robot_with(time_constant=0.2))
    command = np.array([100.0, -50.0, 10.0, 1.0, 0.0])
    for step in range(1, 6):
        thrust = bank.step(command, dt)
        np.testing.assert_allclose(thrust, command * (1.0 - np.exp(-step * dt / 0.2)), rtol=1e-12)


def test_without_lag_thrust_is_the_command() -> None:
    bank = ThrusterBank(robot_with(time_constant=0.0))
    np.testing.assert_array_equal(
        bank.step([100.0, -50.0, 10.0, 1.0, 0.0], 1e-3), [100.0, -50.0, 10.0, 1.0, 0.0]
    )


def test_thrust_never_leaves_the_limits() -> None:
    bank = ThrusterBank(robot_with(minimum=-20.0, maximum=30.0))
    rng = np.random.default_rng(0)
    for _ in range(300):
        thrust = bank.step(rng.normal(scale=100.0, size=5), 0.05)
        assert (thrust >= -20.0).all()
        assert (thrust <= 30.0).all()


def test_a_command_inside_the_dead_zone_gives_no_thrust() -> None:
    bank = ThrusterBank(robot_with(dead_zone=5.0, time_constant=0.0))
    np.testing.assert_array_equal(
        bank.step([4.9, -4.9, 5.0, -5.0, 0.0], 1e-3), [0.0, 0.0, 5.0, -5.0, 0.0]
    )


def test_energy_is_the_integral_of_the_power() -> None:
    bank = ThrusterBank(robot_with(time_constant=0.2))
    bank.step(np.full(5, 100.0), 0.1)
    start = bank.thrust[0]
    spent = bank.energy[0]
    for _ in range(50):
        bank.step(np.full(5, 20.0), 0.01)

    def power(t: float) -> float:
        return 800.0 * (abs(20.0 + (start - 20.0) * np.exp(-t / 0.2)) / 150.0) ** 1.5

    assert bank.energy[0] - spent == pytest.approx(
        quad(power, 0.0, 0.5, epsabs=1e-12)[0], rel=1e-10
    )
    assert bank.power[0] == pytest.approx(power(0.5))


def test_full_thrust_takes_the_reference_power() -> None:
    bank = ThrusterBank(robot_with(time_constant=0.0))
    bank.step(np.full(5, -150.0), 2.0)
    np.testing.assert_allclose(bank.power, 800.0)
    np.testing.assert_allclose(bank.energy, 1600.0)


def test_signals_go_through_the_curve() -> None:
    robot = robot_with(curve=((-1.0, -40.0), (0.0, 0.0), (0.5, 20.0), (1.0, 90.0)))
    thrust = thrust_of_signals(robot, np.array([-1.0, -0.5, 0.25, 0.75, 2.0]))
    np.testing.assert_allclose(thrust, [-40.0, -20.0, 10.0, 55.0, 90.0])


@pytest.mark.parametrize("exponent", [1.0, 1.5, 1.7, 2.0])
def test_power_follows_the_exponent_of_the_file(exponent: float) -> None:
    model = Thrusters.of(robot_with(power={"thrust": 100.0, "watts": 500.0, "exponent": exponent}))
    thrust = np.array([-100.0, -30.0, 0.0, 50.0, 100.0])
    power = np.array(ca.evalf(model.power(ca.SX(thrust))))[:, 0]
    np.testing.assert_allclose(power, 500.0 * (np.abs(thrust) / 100.0) ** exponent, rtol=1e-13)


def test_what_takes_unknown_power_takes_unknown_energy() -> None:
    bank = ThrusterBank(robot_with(power=None))
    bank.step(np.full(5, 50.0), 0.1)
    assert np.isnan(bank.energy).all()
    assert (bank.thrust > 0).all()


def test_a_condition_acts_behind_the_dead_zone_and_within_the_limits() -> None:
    bank = ThrusterBank(robot_with(dead_zone=5.0, minimum=-20.0, maximum=30.0, time_constant=0.0))
    bank.share = np.array([1.0, 0.5, -1.0, 0.0, 0.0])
    bank.offset = np.array([0.0, 0.0, 0.0, 12.0, 90.0])
    np.testing.assert_array_equal(
        bank.step([4.0, 6.0, 28.0, -9.0, 0.0], 1e-3), [0.0, 3.0, -20.0, 12.0, 30.0]
    )


@pytest.mark.parametrize("minimum", [-40.0, 0.0])
def test_without_a_curve_signals_are_shares_of_the_limits(minimum: float) -> None:
    robot = robot_with(minimum=minimum, maximum=80.0)
    signals = np.array([-2.0, -1.0, -0.25, 0.5, 1.5])
    thrust = [minimum, minimum, 0.25 * minimum, 40.0, 80.0]
    np.testing.assert_allclose(thrust_of_signals(robot, signals), thrust, atol=1e-12)


@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan, np.inf])
def test_a_step_of_no_length_is_refused(dt: float) -> None:
    with pytest.raises(InvalidInput, match="allowed: more than 0"):
        Thrusters.of(load_robot("girona_maris7")).decay(dt)


def test_five_thrusters_of_the_girona_leave_roll() -> None:
    assert unactuated_axes(load_robot("girona_maris7")) == (3,)
    assert unactuated_axes(load_robot("girona_maris7_full")) == ()


def test_axes_out_of_reach_follow_from_the_layout() -> None:
    surge_only = np.eye(6)[:, :1]
    assert unreachable_axes(surge_only) == (1, 2, 3, 4, 5)
    assert unreachable_axes(np.zeros((6, 0))) == (0, 1, 2, 3, 4, 5)
    assert unreachable_axes(np.eye(6)) == ()


@pytest.mark.parametrize("seed", range(8))
def test_of_axes_that_are_equally_out_of_reach_rounding_decides_nothing(seed: int) -> None:
    """One thruster that pushes ahead beside the middle: its moment, in the layout's own units,
    weighs as much as its force.
    """
    force = np.array([[1.0], [0.0], [0.0], [0.0], [0.0], [0.3]])
    rng = np.random.default_rng(seed)
    assert unreachable_axes(force * (1.0 + 1e-15 * rng.normal(size=force.shape))) == (1, 2, 3, 4, 5)
    assert unreachable_axes(force + 1e-16 * rng.normal(size=force.shape)) == (1, 2, 3, 4, 5)


def test_a_fixed_base_has_no_vehicle_axes() -> None:
    assert unactuated_axes(load_robot("planar5")) == ()


def test_joint_power_counts_braking_and_losses() -> None:
    power = joint_power(np.array([3.0, -3.0, 5.0]), np.array([2.0, 2.0, 0.0]), 0.6)
    np.testing.assert_allclose(power, [10.0, 10.0, 0.0])


def test_a_dead_band_is_a_plateau_of_the_curve() -> None:
    robot = robot_with(curve=((-1.0, -40.0), (-0.08, 0.0), (0.0, 0.0), (0.1, 0.0), (1.0, 50.0)))
    thrust = thrust_of_signals(robot, np.array([-0.54, -0.08, 0.05, 0.1, 0.55]))
    np.testing.assert_allclose(thrust, [-20.0, 0.0, 0.0, 0.0, 25.0], atol=1e-12)


# Tables of a bench: a known curve, measured with noise and at several voltages, is found again.

PWM = np.arange(1100.0, 1901.0, 25.0)


def bench(volts: float) -> np.ndarray:
    """Thrust [N] of a thruster with a dead band of 25 us to either side."""
    beyond = np.sign(PWM - 1500.0) * np.maximum(np.abs(PWM - 1500.0) - 25.0, 0.0) / 375.0
    return np.where(beyond < 0.0, 0.8, 1.0) * 3.0 * volts * beyond * np.abs(beyond)


def test_the_curve_of_a_table_is_the_thruster_s() -> None:
    order = np.random.default_rng(2).permutation(2 * len(PWM))
    curve, off = curve_of_table(
        np.tile(PWM, 2)[order], np.r_[bench(16.0) + 0.5, bench(16.0) - 0.5][order]
    )
    np.testing.assert_allclose(curve, np.column_stack([PWM, bench(16.0)]), atol=1e-12)
    assert off == pytest.approx(0.0, abs=1e-12)
    assert len(robot_with(curve=curve).description.thrusters[0].curve) == len(
        PWM
    )  # as a robot file takes it


def test_a_voltage_between_those_of_the_table_is_between_their_curves() -> None:
    volts = np.repeat([12.0, 16.0, 20.0], len(PWM))
    thrust = np.concatenate([bench(voltage) for voltage in (12.0, 16.0, 20.0)])
    curve, _ = curve_of_table(np.tile(PWM, 3), thrust, volts, at=14.8)
    np.testing.assert_allclose(np.transpose(curve)[1], bench(14.8), atol=1e-9)
    with pytest.raises(InvalidInput, match="24 V given; allowed: 12 to 20 V"):
        curve_of_table(np.tile(PWM, 3), thrust, volts, at=24.0)


@pytest.mark.parametrize("voltages", [(12.0, 16.0), (14.0, 16.0), (12.0, 16.0, 20.0)])
def test_a_table_of_several_voltages_has_no_one_curve(voltages: tuple[float, ...]) -> None:
    thrust = np.concatenate([bench(voltage) for voltage in voltages])
    with pytest.raises(InvalidInput, match=r"at several voltages.*give --voltage COLUMN"):
        curve_of_table(np.tile(PWM, len(voltages)), thrust)


def test_noise_that_falls_is_levelled_and_how_far_is_said() -> None:
    thrust = bench(16.0) + np.random.default_rng(0).normal(scale=2.0, size=len(PWM))
    curve, off = curve_of_table(PWM, thrust)
    fitted = np.transpose(curve)[1]
    assert (np.diff(fitted) >= 0.0).all()
    assert 0.0 < off == pytest.approx(np.abs(fitted - thrust).max())
    with pytest.raises(InvalidInput, match="give the opposite"):
        curve_of_table(PWM, -thrust)
