"""In grams, millimetres and minutes the dynamics, and the shares of thrust, are what they are in SI
units.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.control.force.allocation import allocation_of
from uvms_ocp.robot.dynamics import Dynamics, robot_dynamics
from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics, Water
from uvms_ocp.robot.loading import list_robots, load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics

M = 7.0
L = 3.0
T = 0.4
"""What a kilogram, a metre and a second are in the other units."""
_SPATIAL = np.array([L] * 3 + [1.0] * 3)
"""Of a twist, but for the time."""


def placed(X: pin.SE3) -> pin.SE3:
    return pin.SE3(X.rotation, L * X.translation)


def model_of(model: pin.Model) -> pin.Model:
    scaled = model.copy()
    for k in range(1, model.njoints):
        inertia = model.inertias[k]
        scaled.jointPlacements[k] = placed(model.jointPlacements[k])
        scaled.inertias[k] = pin.Inertia(
            M * inertia.mass, L * inertia.lever, M * L**2 * inertia.inertia
        )
    for k, frame in enumerate(model.frames):
        scaled.frames[k].placement = placed(frame.placement)
    scaled.gravity.linear = model.gravity.linear * L / T**2
    return scaled


def link_of(link: LinkHydrodynamics) -> LinkHydrodynamics:
    """Forces and moments are of twists, their rates, and their squares."""
    force = M * L**2 / (T**2 * _SPATIAL)
    return replace(
        link,
        X_FL=placed(link.X_FL),
        added_mass=link.added_mass * np.outer(force, T**2 / _SPATIAL),
        linear_drag=link.linear_drag * np.outer(force, T / _SPATIAL),
        quadratic_drag=link.quadratic_drag * np.outer(force, T**2 / _SPATIAL**2),
        volume=L**3 * link.volume,
        centre_of_buoyancy=L * link.centre_of_buoyancy,
    )


def axes_of(robot: Robot) -> np.ndarray:
    """(n_v,) a metre or a radian of each axis in the other units."""
    slides = np.array([L if joint.slides else 1.0 for joint in robot.joints])
    return np.concatenate([_SPATIAL, slides]) if robot.n_vehicle else slides


@pytest.mark.parametrize("name", list_robots())
def test_forces_are_the_same_in_other_units(name: str) -> None:
    robot = load_robot(name)
    rng = np.random.default_rng(2)
    symbolic = robot_dynamics(robot).symbolic
    axes = axes_of(robot)
    force = M * L**2 / (T**2 * axes)  # so that power is a power
    model = model_of(symbolic.model)
    model.armature = symbolic.model.armature * M * L**2 / axes**2
    friction = None if symbolic.damping is None else symbolic.damping * M * L**2 / (T * axes**2)
    links = tuple(link_of(link) for link in symbolic.links)
    scaled_dynamics = Dynamics(
        SymbolicDynamics(
            model=model, links=links, density=symbolic.density * M / L**3, damping=friction
        )
    )
    dynamics = Dynamics(symbolic)
    for _ in range(5):
        q = pin.integrate(robot.model, robot.configuration(), rng.uniform(-0.8, 0.8, robot.n_v))
        v = rng.normal(size=robot.n_v)
        a = rng.normal(size=robot.n_v)
        u = rng.normal(size=3)
        q_scaled = q.copy()
        lengths = [range(3)] if robot.n_vehicle else []
        lengths += [range(joint.q.start, joint.q.stop) for joint in robot.joints if joint.slides]
        for entries in lengths:
            q_scaled[list(entries)] *= L
        tau = dynamics.inverse_dynamics(q, v, a, Water(velocity=u))
        tau_scaled = scaled_dynamics.inverse_dynamics(
            q_scaled, v * axes / T, a * axes / T**2, Water(velocity=u * L / T)
        )
        np.testing.assert_allclose(
            tau_scaled, tau * force, rtol=1e-9, atol=1e-9 * np.abs(tau * force).max()
        )


@pytest.mark.parametrize(
    "name", [name for name in list_robots() if load_robot(name).description.thrusters]
)
def test_a_wrench_in_other_units_of_force_is_shared_out_alike(name: str) -> None:
    allocation = allocation_of(load_robot(name))
    rng = np.random.default_rng(3)
    scaled_allocation = replace(allocation, lower=M * allocation.lower, upper=M * allocation.upper)
    for _ in range(50):
        wrench = allocation.matrix @ rng.uniform(1.5 * allocation.lower, 1.5 * allocation.upper)
        usual = allocation.allocate(wrench)
        scaled = scaled_allocation.allocate(M * wrench)
        np.testing.assert_allclose(
            scaled.reached, M * usual.reached, atol=1e-5 * M * np.abs(wrench).max()
        )
        assert scaled.saturated == usual.saturated
