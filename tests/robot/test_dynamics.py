"""Laws of the dynamics in water, on every machine."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
import slow_dynamics as slow
from kinematic_trees import MODELS, random_configuration
from wet_machines import drift

from uvms_ocp.errors import FrameNotFound, InvalidInput
from uvms_ocp.robot.dynamics import Dynamics, robot_dynamics
from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics, Water
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics

EXACT = 1e-10
N_STATES = 10


@dataclass(frozen=True, kw_only=True)
class MachineState:
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    u: np.ndarray
    Du_Dt: np.ndarray

    @property
    def water(self) -> Water:
        return Water(velocity=self.u, acceleration=self.Du_Dt)


def states(dynamics: Dynamics) -> list[MachineState]:
    """Random states, with water that moves differently at every link."""
    pin.seed(2)
    rng = np.random.default_rng(2)
    model = dynamics.symbolic.model
    shape = (len(dynamics.symbolic.links), 3)
    return [
        MachineState(
            q=random_configuration(model),
            v=rng.normal(size=model.nv),
            a=rng.normal(size=model.nv),
            u=rng.normal(size=shape),
            Du_Dt=rng.normal(size=shape),
        )
        for _ in range(N_STATES)
    ]


def close(actual: np.ndarray, expected: np.ndarray, relative: float) -> None:
    """Compare vectors relative to the largest entry: small entries of a large force carry its
    rounding.
    """
    scale = max(1.0, float(np.abs(expected).max(initial=0.0)))
    np.testing.assert_allclose(actual, expected, rtol=0, atol=relative * scale)


def test_inverse_dynamics_equal_the_slow_reference(dynamics: Dynamics) -> None:
    for s in states(dynamics):
        expected = slow.inverse_dynamics(dynamics.symbolic, s.q, s.v, s.a, s.u, s.Du_Dt)
        close(dynamics.inverse_dynamics(s.q, s.v, s.a, s.water), expected, EXACT)


def test_bias_forces_are_the_inverse_dynamics_without_acceleration(dynamics: Dynamics) -> None:
    for s in states(dynamics):
        expected = slow.inverse_dynamics(dynamics.symbolic, s.q, s.v, 0 * s.a, s.u, s.Du_Dt)
        close(dynamics.bias_force(s.q, s.v, s.water), expected, EXACT)


def test_mass_matrices_equal_the_slow_reference_and_are_positive_definite(
    dynamics: Dynamics,
) -> None:
    for s in states(dynamics):
        M = dynamics.mass_matrix(s.q)
        close(M, slow.mass_matrix(dynamics.symbolic, s.q), EXACT)
        close(M, M.T, EXACT)
        assert np.linalg.eigvalsh(M).min() > 0.0


def test_damping_matrices_equal_the_slow_reference(dynamics: Dynamics) -> None:
    for s in states(dynamics):
        expected = slow.damping_matrix(dynamics.symbolic, s.q, s.v, s.u)
        close(dynamics.damping_matrix(s.q, s.v, s.water), expected, EXACT)


def test_damping_takes_the_power_that_drag_and_friction_dissipate(dynamics: Dynamics) -> None:
    for s in states(dynamics):
        lost = slow.dissipated_power(dynamics.symbolic, s.q, s.v, np.zeros(3))
        assert s.v @ dynamics.damping_matrix(s.q, s.v) @ s.v == pytest.approx(lost, rel=EXACT)


def test_forward_dynamics_undo_inverse_dynamics(dynamics: Dynamics) -> None:
    for s in states(dynamics):
        tau = dynamics.inverse_dynamics(s.q, s.v, s.a, s.water)
        close(dynamics.forward_dynamics(s.q, s.v, tau, s.water), s.a, 1e-9)


def energy(dynamics: Dynamics, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> float:
    """Energy [J] in the frame that drifts with the uniform current u."""
    v_r = v - drift(dynamics, q, u) if u.any() else v
    return dynamics.kinetic_energy(q, v_r) + dynamics.potential_energy(q)


def energy_rate(dynamics: Dynamics, s: MachineState, u: np.ndarray) -> float:
    def ahead(h: float) -> float:
        q = pin.integrate(dynamics.symbolic.model, s.q, h * s.v + h * h / 2 * s.a)
        return energy(dynamics, q, s.v + h * s.a, u)

    h = 1e-4
    return (8 * (ahead(h) - ahead(-h)) - (ahead(2 * h) - ahead(-2 * h))) / (12 * h)


def net_weight(dynamics: Dynamics) -> float:
    model = dynamics.symbolic.model
    displaced = dynamics.symbolic.density * sum(link.volume for link in dynamics.symbolic.links)
    return -model.gravity.linear[2] * (pin.computeTotalMass(model) - displaced)


def test_power_is_balanced_in_still_water(dynamics: Dynamics) -> None:
    for s in states(dynamics):
        tau = dynamics.inverse_dynamics(s.q, s.v, s.a)
        lost = slow.dissipated_power(dynamics.symbolic, s.q, s.v, np.zeros(3))
        rate = energy_rate(dynamics, s, np.zeros(3))
        assert rate == pytest.approx(s.v @ tau - lost, rel=1e-6, abs=1e-6 * (abs(s.v @ tau) + lost))


def test_power_is_balanced_in_the_frame_that_drifts_with_a_current(floating: Dynamics) -> None:
    u = np.array([0.3, -0.5, 0.2])
    for s in states(floating):
        tau = floating.inverse_dynamics(s.q, s.v, s.a, Water(velocity=u))
        put_in = (s.v - drift(floating, s.q, u)) @ tau
        lost = slow.dissipated_power(floating.symbolic, s.q, s.v, u)
        rate = energy_rate(floating, s, u) - net_weight(floating) * u[2]
        assert rate == pytest.approx(put_in - lost, rel=1e-6, abs=1e-6 * (abs(put_in) + lost))


def test_a_machine_that_drifts_with_a_uniform_current_feels_no_hydrodynamic_force(
    floating: Dynamics,
) -> None:
    u = np.array([0.3, -0.5, 0.2])
    for s in states(floating):
        v = drift(floating, s.q, u)
        drifting = floating.bias_force(s.q, v, Water(velocity=u))
        close(drifting, floating.bias_force(s.q, 0 * v), EXACT)


def test_water_that_falls_freely_with_the_machine_carries_no_weight(floating: Dynamics) -> None:
    gravity = floating.symbolic.model.gravity.linear
    for s in states(floating):
        falling = drift(floating, s.q, gravity)
        force = floating.inverse_dynamics(s.q, 0 * s.v, falling, Water(acceleration=gravity))
        close(force, 0 * force, EXACT)


def test_one_water_velocity_is_the_same_as_equal_ones_at_every_link(dynamics: Dynamics) -> None:
    s = states(dynamics)[0]
    n_links = len(dynamics.symbolic.links)
    u = np.array([0.1, 0.2, 0.3])
    Du_Dt = np.array([-0.3, 0.1, 0.2])
    everywhere = Water(velocity=np.tile(u, (n_links, 1)), acceleration=np.tile(Du_Dt, (n_links, 1)))
    water = Water(velocity=u, acceleration=Du_Dt)
    close(
        dynamics.inverse_dynamics(s.q, s.v, s.a, water),
        dynamics.inverse_dynamics(s.q, s.v, s.a, everywhere),
        EXACT,
    )


def test_link_positions_are_the_origins_of_the_coefficient_frames(dynamics: Dynamics) -> None:
    s = states(dynamics)[0]
    motions = slow.link_motions(dynamics.symbolic, s.q, s.v)
    expected = np.reshape([motion.p for motion in motions], (-1, 3))
    np.testing.assert_allclose(dynamics.link_positions(s.q), expected, atol=EXACT)


def test_derivatives_of_inverse_dynamics_equal_finite_differences(dynamics: Dynamics) -> None:
    model = dynamics.symbolic.model
    n_links = len(dynamics.symbolic.links)
    q = ca.SX.sym("q", model.nq)
    x = ca.SX.sym("x", 3 * model.nv)
    u = ca.SX.sym("u", 3, n_links)
    Du_Dt = ca.SX.sym("Du_Dt", 3, n_links)
    step, v, a = ca.vertsplit(x, [0, model.nv, 2 * model.nv, 3 * model.nv])
    moved = dynamics.symbolic.symbolic.integrate(q, step)
    tau = dynamics.symbolic.inverse_dynamics(moved, v, a, u, Du_Dt)
    derivative = ca.Function("derivative", [q, x, u, Du_Dt], [ca.jacobian(tau, x)])

    def force(s: MachineState, point: np.ndarray) -> np.ndarray:
        step, v, a = np.split(point, 3)
        return dynamics.inverse_dynamics(pin.integrate(model, s.q, step), v, a, s.water)

    h = 1e-6
    for s in states(dynamics)[:3]:
        point = np.r_[0 * s.v, s.v, s.a]
        differences = [
            force(s, point + h * e) - force(s, point - h * e) for e in np.eye(3 * model.nv)
        ]
        exact = np.asarray(derivative(s.q, point, s.u.T, s.Du_Dt.T))
        close(exact, np.transpose(differences) / (2 * h), 1e-6)


@pytest.mark.parametrize("name", MODELS)
def test_without_water_the_dynamics_are_pinocchio_s(name: str) -> None:
    model = MODELS[name]()
    dry = Dynamics(SymbolicDynamics(model=model))
    data = model.createData()
    for s in states(dry):
        tau = pin.rnea(model, data, s.q, s.v, s.a)
        close(dry.inverse_dynamics(s.q, s.v, s.a), tau, EXACT)
        close(dry.bias_force(s.q, s.v), pin.nonLinearEffects(model, data, s.q, s.v), EXACT)
        M = slow.mass_matrix(dry.symbolic, s.q)
        close(dry.mass_matrix(s.q), M, EXACT)
        assert dry.kinetic_energy(s.q, s.v) == pytest.approx(s.v @ M @ s.v / 2, rel=EXACT)
        potential = pin.computePotentialEnergy(model, data, s.q)
        assert dry.potential_energy(s.q) == pytest.approx(potential, rel=EXACT, abs=EXACT)
        close(dry.forward_dynamics(s.q, s.v, tau), pin.aba(model, data, s.q, s.v, tau), 1e-9)


def test_density_scales_buoyancy() -> None:
    robot = load_robot("girona_maris7_full")
    q = robot.configuration()
    still = np.zeros(robot.n_v)
    fresh, sea = (robot_dynamics(robot, density) for density in (998.0, 1025.0))
    volume = sum(link.volume for link in fresh.symbolic.links)
    lift = fresh.bias_force(q, still)[2] - sea.bias_force(q, still)[2]
    assert lift == pytest.approx(27.0 * 9.81 * volume)


def test_unknown_link_frames_are_refused() -> None:
    model = MODELS["free_flyer"]()
    with pytest.raises(FrameNotFound, match="unknown frame 'fin'"):
        SymbolicDynamics(model=model, links=(LinkHydrodynamics(frame="fin"),))


def test_a_negative_density_is_refused() -> None:
    with pytest.raises(InvalidInput, match=r"density -1\.0 kg/m3 given; allowed: 0 or more"):
        SymbolicDynamics(model=pin.Model(), density=-1.0)


def test_damping_of_the_wrong_shape_is_refused() -> None:
    with pytest.raises(InvalidInput, match=r"damping of shape \(2,\) given; allowed: \(0,\)"):
        SymbolicDynamics(model=pin.Model(), damping=np.zeros(2))


@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf])
def test_joint_friction_that_feeds_energy_is_refused(value: float) -> None:
    model = MODELS["free_flyer"]()
    with pytest.raises(InvalidInput, match=r"damping \[.*\] given; allowed: finite, 0 or more"):
        SymbolicDynamics(model=model, damping=np.full(model.nv, value))


def test_a_velocity_of_the_wrong_shape_is_refused(dynamics: Dynamics) -> None:
    s = states(dynamics)[0]
    with pytest.raises(InvalidInput, match=r"bias_force: v of shape \(1,\) given; allowed: "):
        dynamics.bias_force(s.q, np.zeros(1))
