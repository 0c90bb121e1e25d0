"""Numeric dynamics of a robot in water, fast enough for a simulation step in Python."""

from __future__ import annotations

from dataclasses import field
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked, checked_dataclass, checked_on_failure
from uvms_ocp.codegen.buffered import BufferedFunction
from uvms_ocp.record.display import FieldTable
from uvms_ocp.robot.coefficients import links_in_water
from uvms_ocp.robot.hydrodynamics import STILL_WATER, Water
from uvms_ocp.robot.robot import Robot, require_normalized
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics
from uvms_ocp.types import Positive

_function = lru_cache(maxsize=16)(SymbolicDynamics.function)
"""One for all `Dynamics` of the same equations, each of which calls it through memory of its
own.
"""


@checked_dataclass(check=checked_on_failure, kw_only=False, eq=False, repr=False)
class Dynamics(FieldTable):
    """Equations of motion ``M a + C v + D v + g = tau``; see `SymbolicDynamics` for the terms.

    Water moves as one, or link by link in the order of ``symbolic.links``. Arguments of the wrong
    shape, and quaternions whose norm is not 1, raise InvalidInput. Not for use from two threads at
    once.
    """

    symbolic: SymbolicDynamics
    """Equations of motion as expressions and ``ca.Function``s."""
    _functions: dict[str, BufferedFunction] = field(default_factory=dict, init=False, repr=False)
    """Functions by the name of their term, made when first asked for: few callers need them all."""

    def __post_init__(self) -> None:
        # What has no equations is refused here, not when they are asked for.
        len(self.symbolic.links)

    def inverse_dynamics(
        self, q: ArrayLike, v: ArrayLike, a: ArrayLike, water: Water = STILL_WATER
    ) -> np.ndarray:
        """Compute the generalized force tau (n_v,) [N, N m] for the acceleration a (n_v,) [m/s2,
        rad/s2].

        q (n_q,) [m, rad]; v (n_v,) [m/s, rad/s].
        """
        u = water.velocity.T
        Du_Dt = water.acceleration.T
        return self._evaluate("inverse_dynamics", q, v, a, u, Du_Dt)

    def forward_dynamics(
        self, q: ArrayLike, v: ArrayLike, tau: ArrayLike, water: Water = STILL_WATER
    ) -> np.ndarray:
        """Compute the acceleration a (n_v,) [m/s2, rad/s2] under the generalized force tau (n_v,)
        [N, N m].

        q (n_q,) [m, rad]; v (n_v,) [m/s, rad/s].
        """
        u = water.velocity.T
        Du_Dt = water.acceleration.T
        return self._evaluate("forward_dynamics", q, v, tau, u, Du_Dt)

    def bias_force(self, q: ArrayLike, v: ArrayLike, water: Water = STILL_WATER) -> np.ndarray:
        """Compute the generalized force (n_v,) [N, N m] for zero acceleration: ``C v + D v + g``.

        q (n_q,) [m, rad]; v (n_v,) [m/s, rad/s].
        """
        return self._evaluate("bias_force", q, v, water.velocity.T, water.acceleration.T)

    def mass_matrix(self, q: ArrayLike) -> np.ndarray:
        """Compute the rigid-body plus added mass M (n_v, n_v) [kg, kg m, kg m2], symmetric, at q
        (n_q,) [m, rad].
        """
        n_v = self.symbolic.model.nv
        return self._evaluate("mass_matrix", q).reshape(n_v, n_v)

    def damping_matrix(self, q: ArrayLike, v: ArrayLike, water: Water = STILL_WATER) -> np.ndarray:
        """Compute the symmetric part of D(q, v_r) (n_v, n_v) [N/(m/s), N m/(rad/s)]: drag of all
        links and joint friction.

        q (n_q,) [m, rad]; v (n_v,) [m/s, rad/s].
        """
        n_v = self.symbolic.model.nv
        return self._evaluate("damping_matrix", q, v, water.velocity.T).reshape(n_v, n_v)

    def drag_slope(self, q: ArrayLike, v: ArrayLike, water: Water = STILL_WATER) -> np.ndarray:
        """Compute the derivative (n_v, n_v) [N/(m/s), N m/(rad/s)] of drag and joint friction with
        respect to v (n_v,) [m/s, rad/s], its symmetric part, at q (n_q,) [m, rad].
        """
        n_v = self.symbolic.model.nv
        return self._evaluate("drag_slope", q, v, water.velocity.T).reshape(n_v, n_v)

    def kinetic_energy(self, q: ArrayLike, v: ArrayLike) -> float:
        """Compute the kinetic energy ``1/2 v.T M v`` [J] at q (n_q,) [m, rad] and v (n_v,) [m/s,
        rad/s].

        With v relative to a uniform current it is the energy in the drifting frame.
        """
        return float(self._evaluate("kinetic_energy", q, v)[0])

    def potential_energy(self, q: ArrayLike) -> float:
        """Compute the potential energy of weight and buoyancy [J] at q (n_q,) [m, rad], zero at the
        origin of W.
        """
        return float(self._evaluate("potential_energy", q)[0])

    def link_positions(self, q: ArrayLike) -> np.ndarray:
        """Return the positions in W (n_links, 3) [m] at which a sheared current acts on the links,
        at q (n_q,) [m, rad].
        """
        return self._evaluate("link_positions", q).reshape(3, -1).T

    def _evaluate(self, term: str, q: ArrayLike, *arguments: ArrayLike) -> np.ndarray:
        """Return the only output of the function of a term. Raises `InvalidInput` for a q of
        another shape, or that is not normalized.
        """
        if term not in self._functions:
            self._functions[term] = BufferedFunction(_function(self.symbolic, term))
        (output,) = self._functions[term](q, *arguments)
        require_normalized(self.symbolic.model, q)
        return output


@checked
def robot_dynamics(robot: Robot, density: Positive | None = None) -> Dynamics:
    """Return the dynamics of a robot with the water of its description and the joint friction of its URDF.

    density: of the water [kg/m3]; default the description's.
    """
    description = robot.description
    symbolic = SymbolicDynamics(
        model=robot.model,
        links=links_in_water(description, density),
        density=description.water_density if density is None else density,
        damping=np.asarray(robot.model.damping, dtype=float),
    )
    return Dynamics(symbolic)


cached_dynamics = lru_cache(maxsize=8)(robot_dynamics)
"""`robot_dynamics`, made once where many runs have one robot."""
