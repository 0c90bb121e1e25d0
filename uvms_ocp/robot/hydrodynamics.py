"""Fossen's terms of one link in water, written once for NumPy arrays and CasADi expressions.

All vectors of a link are in its coefficient frame L and wrenches [N, N m] are about L's origin,
linear rows first. With the velocity nu of the link and u_L of the water, both relative to W and
expressed in L [Fossen2021, ch. 6-10]:

    nu_r = nu - [u_L; 0]
    M_A nu_r_dot + C_A(nu_r) nu_r + D(nu_r) nu_r  =  wrench of the link on the water

Accelerations are *relative to free fall*: ``a`` of the link and ``w_L = R_WL.T (Du_Dt - gravity)``
of the water. Gravity cancels in the relative acceleration ``a + omega x u_L - w_L``, and ``rho V
w_L`` at the centre of buoyancy is buoyancy and Froude-Krylov force in one: the pressure gradient of
the undisturbed water on the displaced volume [Taylor1928].

``Du_Dt = du/dt + (u . grad) u`` is the acceleration of the water itself at L's origin, in both
terms [Auton1988], and not the rate at which u changes along the way of the link: a link that sinks
through steady parallel layers feels their drag, and no inertia. Of what water does that changes
from place to place this is all. Neglected are

- lift in vorticity, ``rho V C_L (u - v) x curl u`` on a body with velocity v, C_L = 1/2 for a
  sphere [Auton1988]: for one that crosses layers a third of what added mass and Froude-Krylov would
  wrongly give along its way, in that direction;
- what an anisotropic M_A adds in a gradient, ``E M_A w - M_A E w`` with the strain rate E and the
  relative velocity w of the water, and moments;
- the water's own rotation: ``nu_r`` turns with the link, so that water which turns drags no link
  along.
"""

from __future__ import annotations

from dataclasses import field

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked_dataclass, checked_on_failure, finite_array
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.drag_passivity import amplified_velocity, least_dissipation, overload
from uvms_ocp.robot.spatial import Array, column, cross, diagonal
from uvms_ocp.types import read_only

_TOLERANCE = 1e-9  # of symmetry and of signs, relative to the largest entry
# [m/s] below which the speed of a flow has no corner: drag is nothing there, of toys too
_STILL = 1e-6


def _zero6() -> np.ndarray:
    return np.zeros((6, 6))


@checked_dataclass(eq=False)
class LinkHydrodynamics:
    """Hydrodynamic coefficients of one link. Arrays are read-only; a diagonal (6,) is accepted for
    every matrix.

    Raises InvalidInput for a wrong shape, NaN, an asymmetric or indefinite added mass, a negative
    volume, and drag that feeds energy at some velocity, by the condition of
    `uvms_ocp.robot.drag_passivity`.
    """

    frame: str
    """Frame F of the model that carries the link; it may be fixed to a joint body at any
    placement.
    """
    X_FL: pin.SE3 = field(default_factory=pin.SE3.Identity)
    """Pose of the coefficient frame L in F, forward-left-up axes."""
    added_mass: np.ndarray = field(default_factory=_zero6)
    """M_A (6, 6) [kg, kg m, kg m2] in L."""
    linear_drag: np.ndarray = field(default_factory=_zero6)
    """Wrench per velocity (6, 6) [N/(m/s), N m/(rad/s)] in L."""
    quadratic_drag: np.ndarray = field(default_factory=_zero6)
    """Wrench per ``|nu_j| nu_j``, column by column, (6, 6) [N/(m/s)^2, N m/(rad/s)^2] in L."""
    by_flow: bool = False
    """Quadratic drag of translation counts how fast the water flows past in all, see `flow_speeds`;
    the matrix is a diagonal.
    """
    volume: float = 0.0
    """Displaced volume [m3]."""
    centre_of_buoyancy: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Position (3,) [m] in F."""

    def __post_init__(self) -> None:
        for name in ("added_mass", "linear_drag", "quadratic_drag"):
            value = getattr(self, name)
            matrix = np.diag(value) if np.shape(value) == (6,) else value
            object.__setattr__(self, name, finite_array(f"{self.frame}: {name}", matrix, (6, 6)))
        centre = finite_array(f"{self.frame}: centre_of_buoyancy", self.centre_of_buoyancy, (3,))
        object.__setattr__(self, "centre_of_buoyancy", centre)
        if not (np.isfinite(self.volume) and self.volume >= 0.0):
            raise InvalidInput(f"{self.frame}: volume {self.volume} m3 given; allowed: 0 or more")
        check_added_mass(self.added_mass, f"{self.frame}: added_mass ")
        check_linear_drag(self.linear_drag, f"{self.frame}: linear_drag ")
        check_quadratic_drag(
            self.linear_drag, self.quadratic_drag, f"{self.frame}: quadratic_drag "
        )
        check_flow_drag(self.quadratic_drag, self.by_flow, f"{self.frame}: quadratic_drag ")

    @property
    def p_LB(self) -> np.ndarray:
        """Centre of buoyancy (3,) [m] in L."""
        return np.asarray(self.X_FL.actInv(self.centre_of_buoyancy))


@checked_dataclass(check=checked_on_failure, eq=False)
class Water:
    """Motion of the undisturbed water in W where the links are: one row for all (3,), or one per
    link (n_links, 3).

    Raises `InvalidInput` for another shape and for numbers that are not finite.
    """

    velocity: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Velocity u (3,) or (n_links, 3) [m/s]."""
    acceleration: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Acceleration ``Du_Dt = du/dt + (u . grad) u`` (3,) or (n_links, 3) [m/s2]: of the water's
    particles, whatever the links do.
    """

    def __post_init__(self) -> None:
        for name, value in (("velocity", self.velocity), ("acceleration", self.acceleration)):
            if np.shape(value)[-1:] != (3,) or not np.isfinite(value).all():
                raise InvalidInput(
                    f"water: {name} = {value}; give finite numbers, (3,) or (n_links, 3)"
                )
            object.__setattr__(self, name, read_only(value, np.float64))


STILL_WATER = Water()
"""Water at rest."""


def relative_velocity(nu: Array, u_L: Array) -> Array:
    """Compute ``nu_r`` (6,) [m/s, rad/s] of a link with nu (6,) [m/s, rad/s] in water with u_L (3,)
    [m/s].
    """
    return column(nu[:3] - u_L, nu[3:])


def relative_acceleration(a: Array, nu: Array, u_L: Array, w_L: Array) -> Array:
    """Compute ``nu_r_dot`` (6,) [m/s2, rad/s2] of the link relative to the water at it, from
    accelerations relative to free fall.

    a (6,) [m/s2, rad/s2] and nu (6,) [m/s, rad/s] of the link; w_L (3,) [m/s2] and u_L (3,) [m/s]
    of the water. In axes that turn with the link u_L changes by ``R_WL.T Du_Dt - omega x u_L`` for
    a particle of the water: taking nu_dot for nu_r_dot is right in still water only.
    """
    return column(a[:3] + cross(nu[3:], u_L) - w_L, a[3:])


def added_mass_wrench(M_A: Array, nu_r: Array, nu_r_dot: Array) -> Array:
    """Compute ``M_A nu_r_dot + C_A(nu_r) nu_r`` (6,) [N, N m], Kirchhoff's equations [Fossen2021,
    sec. 6.2].

    M_A (6, 6) [kg, kg m, kg m2]; nu_r (6,) [m/s, rad/s]; nu_r_dot (6,) [m/s2, rad/s2].
    """
    momentum = M_A @ nu_r
    rate = M_A @ nu_r_dot
    linear = nu_r[:3]
    angular = nu_r[3:]
    force = rate[:3] + cross(angular, momentum[:3])
    return column(force, rate[3:] + cross(angular, momentum[3:]) + cross(linear, momentum[:3]))


def flow_speeds(nu_r: Array, by_flow: bool) -> Array:
    """Return the speeds (6,) [m/s, rad/s] that quadratic drag counts at nu_r (6,) [m/s, rad/s]:
    along each axis, or of the whole flow.

    By axes the same body is dragged less along a diagonal of its axes than along an axis, by up to
    42 %. By the flow its force is ``-q_i |u| u_i``: the same on the axes, an ellipsoid between them.
    Rotation has no flow with a direction: each of its axes has its own rate either way.
    """
    if not by_flow:
        return abs(nu_r)
    return column((nu_r[:3].T @ nu_r[:3] + _STILL**2) ** 0.5 + 0 * nu_r[:3], abs(nu_r[3:]))


def damping_matrix(
    linear_drag: Array, quadratic_drag: Array, nu_r: Array, by_flow: bool = False
) -> Array:
    """Compute ``D(nu_r)`` (6, 6) [N/(m/s), N m/(rad/s)] at nu_r (6,) [m/s, rad/s].

    linear_drag (6, 6) [N/(m/s), N m/(rad/s)]; quadratic_drag (6, 6) [N/(m/s)^2, N m/(rad/s)^2];
    by_flow: see `flow_speeds`.
    """
    return linear_drag + quadratic_drag @ diagonal(flow_speeds(nu_r, by_flow))


def drag_wrench(
    linear_drag: Array, quadratic_drag: Array, nu_r: Array, by_flow: bool = False
) -> Array:
    """Compute ``D(nu_r) nu_r`` (6,) [N, N m] at nu_r (6,) [m/s, rad/s].

    linear_drag (6, 6) [N/(m/s), N m/(rad/s)]; quadratic_drag (6, 6) [N/(m/s)^2, N m/(rad/s)^2];
    by_flow: see `flow_speeds`.
    """
    return linear_drag @ nu_r + quadratic_drag @ (flow_speeds(nu_r, by_flow) * nu_r)


def pressure_wrench(displaced_mass: Array, p_LB: Array, w_L: Array) -> Array:
    """Compute the wrench (6,) [N, N m] of the undisturbed water on the link: buoyancy and
    Froude-Krylov force at p_LB (3,) [m].

    displaced_mass () [kg]: density times volume; w_L (3,) [m/s2]: acceleration of the water
    relative to free fall.
    """
    force = displaced_mass * w_L
    return column(force, cross(p_LB, force))


def check_added_mass(matrix: np.ndarray, where: str = "") -> None:
    """Raise `InvalidInput` where an added mass (6, 6) [kg, kg m, kg m2] is not symmetric, or
    indefinite.
    """
    scale = float(np.abs(matrix).max())
    half = np.abs(matrix / 2 - matrix.T / 2)  # halves first: their difference is finite
    if half.max() > _TOLERANCE / 2 * scale:
        i, j = np.unravel_index(np.argmax(half), (6, 6))
        entries = (
            f"entry {i + 1}, {j + 1} is {matrix[i, j]:g} and {j + 1}, {i + 1} is {matrix[j, i]:g}"
        )
        raise InvalidInput(
            f"{where}is not symmetric, but for a rounded last digit: {entries}; give a symmetric"
            " matrix"
        )
    smallest = float(np.linalg.eigvalsh(matrix).min())
    if smallest < -_TOLERANCE * scale:
        raise InvalidInput(
            f"{where}has the eigenvalue {smallest:.6g}; allowed: 0 or more, as an inertia is not"
            " indefinite"
        )


def check_linear_drag(matrix: np.ndarray, where: str = "") -> None:
    """Raise `InvalidInput` where linear drag (6, 6) [N/(m/s), N m/(rad/s)] feeds energy."""
    axis, power = least_dissipation(matrix)
    if power < 0.0:
        raise InvalidInput(
            f"{where}{_feeding((axis, -power))}; allowed: no eigenvalue below 0 in its symmetric"
            " part"
        )


def check_quadratic_drag(linear: np.ndarray, quadratic: np.ndarray, where: str = "") -> None:
    """Raise `InvalidInput` where the quadratic drag (6, 6) [N/(m/s)^2, N m/(rad/s)^2] may feed
    energy.

    linear (6, 6) [N/(m/s), N m/(rad/s)] is what an example of it is to overcome.
    """
    worst = int(np.argmin(np.diag(quadratic)))
    if quadratic[worst, worst] < 0.0:
        problem = _feeding(amplified_velocity(linear, quadratic, np.eye(6)[worst]))
        raise InvalidInput(f"{where}{problem}; allowed: a diagonal of 0 or more")
    factor, d = overload(quadratic)
    if factor > 1.0 + _TOLERANCE:
        problem = _feeding(amplified_velocity(linear, quadratic, d))
        raise InvalidInput(
            f"{where}{problem}; allowed: couplings at most {1 / factor:.3g} times as large"
        )


def check_flow_drag(quadratic: np.ndarray, by_flow: bool, where: str = "") -> None:
    """Raise `InvalidInput` where the quadratic drag (6, 6) [N/(m/s)^2, N m/(rad/s)^2] by the flow
    has couplings.
    """
    if by_flow and np.count_nonzero(quadratic - np.diag(np.diag(quadratic))):
        raise InvalidInput(
            f"{where}by the flow has couplings; allowed: a diagonal, of 6 numbers, or drag by axes"
        )


def _feeding(proof: tuple[np.ndarray, float] | None) -> str:
    if proof is None:
        return "may feed energy: its diagonal does not outweigh its couplings"
    nu, power = proof
    entries = ", ".join(f"{entry:.4g}" for entry in nu)
    return f"feeds {power:.3g} W at nu = ({entries}) m/s, rad/s"
