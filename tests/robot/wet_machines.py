"""One registry of machines in water: every law of the dynamics is tested on each."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
from kinematic_trees import built_model

from uvms_ocp.robot.dynamics import Dynamics, robot_dynamics
from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics
from uvms_ocp.robot.loading import list_robots, load_robot
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics


def random_link(frame: str, rng: np.random.Generator) -> LinkHydrodynamics:
    """A link with every term: full matrices, skewed placement, buoyancy off centre."""
    added, linear, quadratic = rng.normal(size=(3, 6, 6))
    return LinkHydrodynamics(
        frame=frame,
        X_FL=pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3)),
        added_mass=added @ added.T,
        linear_drag=linear @ linear.T,
        quadratic_drag=np.diag(1 + 10 * rng.uniform(size=6)) + 0.1 * quadratic,
        volume=float(rng.uniform(0.001, 0.01)),
        centre_of_buoyancy=rng.normal(size=3),
    )


def built_machine(*joint_types: str, branch_at: int | None = None) -> Dynamics:
    """A random tree with water on every tip, twice on the first, none on the third."""
    model = built_model(*joint_types, branch_at=branch_at)
    rng = np.random.default_rng(11)
    model.armature = model.armature * (
        np.arange(model.nv) >= 6
    )  # a vehicle has no rotor at its free-flyer
    tips = [frame.name for frame in model.frames if frame.name.endswith("_tip")]
    wet = [tips[0], *tips[:2], *tips[3:]]
    return Dynamics(
        SymbolicDynamics(
            model=model,
            links=tuple(random_link(tip, rng) for tip in wet),
            density=1025.0,
            damping=rng.uniform(size=model.nv) * (np.arange(model.nv) >= 6),
        )
    )


FLOATING: dict[str, Callable[[], Dynamics]] = {
    **{
        name: lambda name=name: robot_dynamics(load_robot(name))
        for name in list_robots()
        if load_robot(name).n_vehicle
    },
    "chain": lambda: built_machine(
        "free_flyer", "revolute_unaligned", "unbounded_y", "prismatic_unaligned"
    ),
    "two_arms": lambda: built_machine(
        "free_flyer", "revolute_z", "revolute_y", "revolute_unaligned", "prismatic_x", branch_at=3
    ),
}
"""Machines on a free-flyer, which a current can carry along."""

FIXED: dict[str, Callable[[], Dynamics]] = {
    **{
        name: lambda name=name: robot_dynamics(load_robot(name))
        for name in list_robots()
        if not load_robot(name).n_vehicle
    },
    "fixed_arm": lambda: built_machine("revolute_unaligned", "planar", "prismatic_z", "revolute_x"),
}

MACHINES = {**FLOATING, **FIXED}


def drift(dynamics: Dynamics, q: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Velocity (n_v,) of a floating machine that a uniform current u (3,) carries along."""
    model = dynamics.symbolic.model
    R_WB = model.jointPlacements[1].rotation @ pin.Quaternion(q[3:7]).matrix()
    return np.r_[R_WB.T @ u, np.zeros(model.nv - 3)]
