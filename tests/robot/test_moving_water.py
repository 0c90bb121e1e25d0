"""Laws of machines in water that changes from place to place."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest
import slow_dynamics as slow
from kinematic_trees import random_configuration
from wet_machines import drift

from uvms_ocp.robot.dynamics import Dynamics
from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics, Water, drag_wrench
from uvms_ocp.robot.loading import list_robots, list_variants, load_robot
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics
from uvms_ocp.sim.currents import Current, GustyCurrent, ShearedCurrent, water_at

LAYERS = ShearedCurrent(
    z=[-9.0, -1.0, 0.5, 9.0], velocities=[[0, 0, 0], [0.4, 0.1, 0], [0.5, -0.2, 0], [0.9, 0, 0]]
)
GUSTS = GustyCurrent(base=LAYERS, sigma=0.1, seed=1)
T = 3.0  # [s]


@dataclass(frozen=True, kw_only=True)
class Boosted(Current):
    """Another field seen from a frame that moves with -c: its velocities with c added, its profile
    carried along or not.
    """

    base: Current
    c: np.ndarray
    carried: bool

    def velocity(self, p_W: np.ndarray, t: float) -> np.ndarray:
        return self.base.velocity(p_W, t) + self.c

    def rate(self, p_W: np.ndarray, t: float) -> np.ndarray:
        moved = self.base.gradient(p_W, t) @ self.c if self.carried else 0.0
        return self.base.rate(p_W, t) - moved

    def gradient(self, p_W: np.ndarray, t: float) -> np.ndarray:
        return self.base.gradient(p_W, t)


@dataclass(frozen=True, kw_only=True)
class Motion:
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray


def motions(dynamics: Dynamics) -> Iterator[Motion]:
    pin.seed(4)
    rng = np.random.default_rng(4)
    model = dynamics.symbolic.model
    for _ in range(5):
        yield Motion(
            q=random_configuration(model), v=rng.normal(size=model.nv), a=rng.normal(size=model.nv)
        )


def boosted(dynamics: Dynamics, s: Motion, c: np.ndarray) -> Motion:
    """The same motion with c added to the velocity of everything: as its axes turn, the components
    of c change.
    """
    more = drift(dynamics, s.q, c)
    turning = np.r_[-np.cross(s.v[3:6], more[:3]), np.zeros(len(s.v) - 3)]
    return Motion(q=s.q, v=s.v + more, a=s.a + turning)


def force(dynamics: Dynamics, s: Motion, current: Current) -> np.ndarray:
    return dynamics.inverse_dynamics(
        s.q, s.v, s.a, water_at(current, dynamics.link_positions(s.q), T)
    )


def assert_close(actual: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_allclose(
        actual, expected, rtol=0, atol=1e-9 * max(1.0, np.abs(expected).max())
    )


@pytest.mark.parametrize("carried", [False, True])
@pytest.mark.parametrize("current", [LAYERS, GUSTS], ids=["layers", "gusts"])
def test_a_horizontal_velocity_added_to_water_and_robot_changes_no_force(
    floating: Dynamics, current: Current, carried: bool
) -> None:
    c = np.array([0.7, -0.4, 0.0])
    for s in motions(floating):
        moved = force(
            floating, boosted(floating, s, c), Boosted(base=current, c=c, carried=carried)
        )
        assert_close(moved, force(floating, s, current))


@pytest.mark.parametrize("current", [LAYERS, GUSTS], ids=["layers", "gusts"])
def test_a_vertical_velocity_added_to_both_changes_no_force_if_the_profile_moves_with_it(
    floating: Dynamics, current: Current
) -> None:
    c = np.array([0.0, 0.0, 0.5])
    for s in motions(floating):
        before = force(floating, s, current)
        moving = boosted(floating, s, c)
        assert_close(force(floating, moving, Boosted(base=current, c=c, carried=True)), before)
        left_behind = force(floating, moving, Boosted(base=current, c=c, carried=False))
        assert np.abs(left_behind - before)[:3].max() > 1e-3


def without_drag(dynamics: Dynamics) -> Dynamics:
    links = [
        replace(link, linear_drag=np.zeros(6), quadratic_drag=np.zeros(6))
        for link in dynamics.symbolic.links
    ]
    return Dynamics(replace(dynamics.symbolic, links=tuple(links)))


@pytest.mark.sampled
def test_a_machine_that_sinks_through_steady_layers_feels_their_drag_and_no_other_force(
    floating: Dynamics,
) -> None:
    slippery = without_drag(floating)
    layer = ShearedCurrent.over_floor([0.3, 0.0, 0.0], floor_z=-40.0, thickness=5.0)
    for s in motions(floating):
        for height in (2.0, 1.0, 0.5, 0.3):
            q = np.r_[s.q[:2], height - 40.0, s.q[3:]]
            water = water_at(layer, floating.link_positions(q), T)
            sinking = drift(floating, q, np.array([0.0, 0.0, -0.2]))
            still = slippery.bias_force(q, sinking)
            assert_close(slippery.bias_force(q, sinking, water)[:3], still[:3])
            felt = floating.bias_force(q, sinking, water) - floating.bias_force(q, sinking)
            assert np.abs(felt[:3]).max() > 1e-3


def sphere(added: float) -> Dynamics:
    """Neutrally buoyant, without drag; `added` is its added mass in displaced masses."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    centre = np.array([0.1, -0.2, 0.3])
    mass = 4.0
    density = 1000.0
    model.appendBodyToJoint(joint, pin.Inertia(mass, centre, 0.02 * np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("hull", joint, 0, pin.SE3(np.eye(3), centre), pin.FrameType.BODY))
    M_A = np.r_[np.full(3, added * mass), np.zeros(3)]
    link = LinkHydrodynamics(frame="hull", added_mass=M_A, volume=mass / density)
    return Dynamics(SymbolicDynamics(model=model, links=(link,), density=density))


@pytest.mark.parametrize("added", [0.0, 0.5, 3.0])
def test_a_neutrally_buoyant_drag_free_sphere_accelerates_as_the_water_however_it_moves(
    added: float,
) -> None:
    dynamics = sphere(added)
    rng = np.random.default_rng(7)
    for s in motions(dynamics):
        water = Water(velocity=rng.normal(size=3), acceleration=rng.normal(size=3))
        a = dynamics.forward_dynamics(s.q, s.v, np.zeros(6), water)
        (motion,) = slow.link_motions(dynamics.symbolic, s.q, s.v)
        nu = motion.J @ s.v
        nu_dot = motion.J @ a + motion.J_dot @ s.v
        assert_close(motion.R @ (nu_dot[:3] + np.cross(nu[3:], nu[:3])), water.acceleration)
        assert_close(nu_dot[3:], np.zeros(3))


def energy_rate(dry: Dynamics, s: Motion) -> float:
    """Rate [W] of the kinetic energy along the motion."""

    def ahead(h: float) -> float:
        return dry.kinetic_energy(
            pin.integrate(dry.symbolic.model, s.q, h * s.v + h * h / 2 * s.a), s.v + h * s.a
        )

    h = 1e-4
    return (8 * (ahead(h) - ahead(-h)) - (ahead(2 * h) - ahead(-2 * h))) / (12 * h)


def weight_power(dynamics: Dynamics, s: Motion) -> float:
    model = dynamics.symbolic.model
    data = model.createData()
    pin.centerOfMass(model, data, s.q, s.v)
    return float(pin.computeTotalMass(model) * model.gravity.linear @ data.vcom[0])


@pytest.mark.sampled
def test_kinetic_energy_of_the_bodies_changes_by_the_power_of_efforts_weight_and_each_wrench_of_the_water(
    dynamics: Dynamics,
) -> None:
    symbolic = dynamics.symbolic
    rng = np.random.default_rng(5)
    dry = Dynamics(SymbolicDynamics(model=symbolic.model))  # bodies and rotors alone
    for s in motions(dynamics):
        tau = rng.normal(size=len(s.v))
        water = water_at(GUSTS, dynamics.link_positions(s.q), T)
        felt = replace(s, a=dynamics.forward_dynamics(s.q, s.v, tau, water))
        friction = 0.0 if symbolic.damping is None else symbolic.damping @ s.v**2
        wrenches = slow.water_wrenches(
            symbolic, felt.q, felt.v, felt.a, water.velocity, water.acceleration
        )
        parts = [tau @ s.v, -friction, weight_power(dynamics, s)]
        for motion, (added, dragged, pressure) in zip(
            slow.link_motions(symbolic, s.q, s.v), wrenches, strict=True
        ):
            nu = motion.J @ s.v
            parts += [-nu @ added, -nu @ dragged, nu @ pressure]
        scale = np.abs(parts).sum()
        assert energy_rate(dry, felt) == pytest.approx(sum(parts), rel=1e-6, abs=1e-6 * scale)


WET = [(name, variant) for name in list_robots() for variant in (None, *list_variants(name))]


@pytest.mark.parametrize(("name", "variant"), WET)
def test_drag_never_feeds_the_motion_relative_to_the_water(name: str, variant: str | None) -> None:
    rng = np.random.default_rng(6)
    for link in load_robot(name, variant=variant).hydrodynamics:
        for nu_r in rng.normal(size=(200, 6)) * 10 ** rng.uniform(-3, 1, (200, 1)):
            assert (
                nu_r @ drag_wrench(link.linear_drag, link.quadratic_drag, nu_r, link.by_flow) >= 0.0
            )
