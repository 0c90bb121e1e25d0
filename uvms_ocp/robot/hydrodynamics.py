"""Fossen's terms of one link in water, written once for NumPy arrays and CasADi expressions; drag
must dissipate.

At nu the water gets the power ``L(nu) + C(nu)``, ``L = nu.T D_lin nu`` and ``C = sum_ij Q_ij nu_i |nu_j| nu_j`` from the
matrices of `uvms_ocp.robot.hydrodynamics.damping_matrix`. In a given direction it is ``s^2 L + s^3 C`` at the speed
s: the first part decides where s is small, the second where it is large, so that neither may be negative anywhere.

L is not if the symmetric part of D_lin has no negative eigenvalue, and only then.

C is not if there are weights ``d_k > 0`` with, for every axis k,

    sum_{j != k} |Q_kj| d_j^2  +  2 sum_{i != k} |Q_ik| d_i d_k  <=  3 Q_kk d_k^2.

Proof, with ``x_k = |nu_k| / d_k``: every coupling takes ``-|Q_ij| d_i d_j^2 x_i x_j^2`` at worst, and ``x_i x_j^2`` is at
most ``(x_i^3 + 2 x_j^3) / 3``, the geometric mean of x_i^3, x_j^3, x_j^3 and the arithmetic one. What all of them take of
``x_k^3`` is the left side times ``d_k / 3``, and ``Q_kk |nu_k|^3`` gives the right side times that.

The condition is necessary too where one choice of signs turns all couplings against the diagonal,
as with two coupled axes and ``Q_ij Q_ji >= 0``: the best weights are then a velocity that is fed.
Elsewhere it is stricter than need be: of two couplings ``Q_ij = -Q_ji`` it allows a quarter of what
is harmless.

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
from itertools import permutations, product

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked_dataclass, checked_on_failure, finite_array
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.spatial import Array, column, cross, diagonal
from uvms_ocp.types import read_only

# Whether drag takes energy out of every motion, or feeds some.
#
# At nu the water gets the power ``L(nu) + C(nu)``, ``L = nu.T D_lin nu`` and ``C = sum_ij Q_ij nu_i
# |nu_j| nu_j`` from the matrices of `uvms_ocp.robot.hydrodynamics.damping_matrix`. In a given
# direction it is ``s^2 L + s^3 C`` at the speed s: the first part decides where s is small, the
# second where it is large, so that neither may be negative anywhere.
#
# L is not if the symmetric part of D_lin has no negative eigenvalue, and only then.
#
# C is not if there are weights ``d_k > 0`` with, for every axis k,
#
#     sum_{j != k} |Q_kj| d_j^2  +  2 sum_{i != k} |Q_ik| d_i d_k  <=  3 Q_kk d_k^2.
#
# Proof, with ``x_k = |nu_k| / d_k``: every coupling takes ``-|Q_ij| d_i d_j^2 x_i x_j^2`` at worst,
# and ``x_i x_j^2`` is at most ``(x_i^3 + 2 x_j^3) / 3``, the geometric mean of x_i^3, x_j^3, x_j^3
# and the arithmetic one. What all of them take of ``x_k^3`` is the left side times ``d_k / 3``, and
# ``Q_kk |nu_k|^3`` gives the right side times that.
#
# The condition is necessary too where one choice of signs turns all couplings against the diagonal,
# as with two coupled axes and ``Q_ij Q_ji >= 0``: the best weights are then a velocity that is fed.
# Elsewhere it is stricter than need be: of two couplings ``Q_ij = -Q_ji`` it allows a quarter of
# what is harmless.

_STEPS = 200  # of the search for weights, which gains a digit in 5 to 20 steps
_ROUNDING = 1e-9
# of the largest entry, for drag of an axis: the third root of it, 1e-9, is what couplings may then
# be
_LEAST = 1e-27
_SIGNS = np.array(list(product((1.0, -1.0), repeat=6)))
_PAIRS = np.array(
    [
        a + t * b
        for a, b in permutations(np.eye(6), 2)
        for t in np.outer((1, -1), np.geomspace(1e-3, 1, 25)).flat
    ]
)

_TOLERANCE = 1e-9  # of symmetry and of signs, relative to the largest entry
_STILL = 1e-6  # [m/s] below which the speed of a flow has no corner


def least_dissipation(linear_drag: np.ndarray) -> tuple[np.ndarray, float]:
    """A velocity nu (6,) [m/s, rad/s] and the power [W] that linear drag takes there, negative if
    any velocity is fed.

    linear_drag (6, 6) [N/(m/s), N m/(rad/s)]. Its diagonal decides by its signs alone. The rest is
    judged in units in which the diagonal is 1, as Sylvester's law of inertia allows, so that an
    axis with little drag is not lost in the rounding of another; an axis without drag of its own
    bears no couplings at all.
    """
    S = linear_drag / 2 + linear_drag.T / 2  # halves first: their sum is finite
    diagonal = np.diag(S)
    couplings = S - np.diag(np.diag(S))
    worst = int(np.argmin(diagonal))
    if diagonal[worst] < 0.0 or not couplings.any():
        return np.eye(6)[worst], float(diagonal[worst])
    root = np.sqrt(diagonal)
    fed = np.argwhere(np.abs(couplings) > (1.0 + _ROUNDING) * np.outer(root, root))
    if len(fed):  # of these two axes alone; what is left below has couplings of at most 1
        i, j = sorted(fed[0], key=lambda axis: diagonal[axis])
        nu = np.eye(6)[i] - np.eye(6)[j] * S[i, j] / max(diagonal[j], abs(S[i, j]))
        return nu, float(nu @ S @ nu)
    units = 1.0 / np.where(diagonal > 0.0, root, 1.0)
    values, axes = np.linalg.eigh(units[:, None] * S * units)
    nu = units * axes[:, 0] / np.abs(units * axes[:, 0]).max()
    return nu, float(nu @ S @ nu) if values[0] < -_ROUNDING else 0.0


def overload(quadratic_drag: np.ndarray) -> tuple[float, np.ndarray]:
    """Compute the factor by which couplings exceed what the diagonal bears, and d (6,) of the axes
    they overload.

    quadratic_drag (6, 6) [N/(m/s)^2, N m/(rad/s)^2], its diagonal not negative. At a factor of at
    most 1, rounding aside, drag never feeds energy. Above it the factor is the least that any
    weights d [m/s, rad/s] show.

    That is the largest eigenvalue of the tensor of the couplings, which is symmetric and not
    negative: the power method of [Ng2009] approaches it from above.
    """
    couplings = np.abs(quadratic_drag) * (1.0 - np.eye(6))
    if not couplings.any():
        return 0.0, np.zeros(6)
    root = _units(quadratic_drag, _LEAST)
    B = couplings / np.outer(root, root**2)
    d = np.ones(6)
    for _ in range(_STEPS):
        shares = (B @ d**2 / d**2 + 2 * B.T @ d / d) / 3
        if shares.max() <= 1.0 + _ROUNDING:
            break
        d = d * np.sqrt(1.0 + shares)  # the added 1 keeps the iteration from turning in circles
        d = np.maximum(d / d.max(), 1e-60)
    return float(shares.max()), np.where(shares > 1.0 + _ROUNDING, d, 0.0) / root


def amplified_velocity(
    linear_drag: np.ndarray, quadratic_drag: np.ndarray, d: np.ndarray
) -> tuple[np.ndarray, float] | None:
    """A velocity nu (6,) [m/s, rad/s] and the power [W] that drag feeds there, if one is found.

    linear_drag (6, 6) [N/(m/s), N m/(rad/s)]; quadratic_drag (6, 6) [N/(m/s)^2, N m/(rad/s)^2]; d
    (6,) [m/s, rad/s]: magnitudes of the entries to try with all signs, beside those of two axes
    each.
    """
    candidates = np.vstack([_SIGNS * d, _PAIRS / _units(quadratic_drag, _ROUNDING)])
    candidates /= np.abs(candidates).max(axis=1, keepdims=True)
    gains = -((candidates @ quadratic_drag) * np.abs(candidates) * candidates).sum(axis=1)
    best = int(np.argmax(gains))
    if gains[best] > 0.0:
        return _rounded(candidates[best], linear_drag, quadratic_drag)
    return None


def _rounded(
    nu: np.ndarray, linear: np.ndarray, quadratic: np.ndarray
) -> tuple[np.ndarray, float] | None:
    """Nu with four digits, as it is printed, and the power there: at a speed where quadratic drag
    outgrows the linear one.
    """
    slow = nu @ linear @ nu
    fast = nu @ quadratic @ (np.abs(nu) * nu)
    speed = 1.0 if slow + fast < 0.0 else 2.0 * slow / -fast
    nu = np.array([float(f"{speed * entry:.4g}") for entry in nu]) + 0.0  # without -0
    power = -float(nu @ linear @ nu + nu @ quadratic @ (np.abs(nu) * nu))
    if power > 0.0:
        return (nu, power)
    return None


def _units(quadratic_drag: np.ndarray, least: float) -> np.ndarray:
    """Factors (6,) that bring velocities to units in which the diagonal is 1, as far as it is
    there.
    """
    return np.asarray(
        np.cbrt(np.maximum(np.diag(quadratic_drag), least * np.abs(quadratic_drag).max()))
    )


# Fossen's terms of one link in water, written once for NumPy arrays and CasADi expressions.
#
# All vectors of a link are in its coefficient frame L and wrenches [N, N m] are about L's origin,
# linear rows first. With the velocity nu of the link and u_L of the water, both relative to W and
# expressed in L [Fossen2021, ch. 6-10]:
#
#     nu_r = nu - [u_L; 0]
#     M_A nu_r_dot + C_A(nu_r) nu_r + D(nu_r) nu_r  =  wrench of the link on the water
#
# Accelerations are *relative to free fall*: ``a`` of the link and ``w_L = R_WL.T (Du_Dt -
# gravity)`` of the water. Gravity cancels in the relative acceleration ``a + omega x u_L - w_L``,
# and ``rho V w_L`` at the centre of buoyancy is buoyancy and Froude-Krylov force in one: the
# pressure gradient of the undisturbed water on the displaced volume [Taylor1928].
#
# ``Du_Dt = du/dt + (u . grad) u`` is the acceleration of the water itself at L's origin, in both
# terms [Auton1988], and not the rate at which u changes along the way of the link: a link that
# sinks through steady parallel layers feels their drag, and no inertia. Of what water does that
# changes from place to place this is all. Neglected are
#
# - lift in vorticity, ``rho V C_L (u - v) x curl u`` on a body with velocity v, C_L = 1/2 for a sphere [Auton1988]: for one
#   that crosses layers a third of what added mass and Froude-Krylov would wrongly give along its way, in that direction;
# - what an anisotropic M_A adds in a gradient, ``E M_A w - M_A E w`` with the strain rate E and the relative velocity w of
#   the water, and moments;
# - the water's own rotation: ``nu_r`` turns with the link, so that water which turns drags no link along.


def _zero6() -> np.ndarray:
    return np.zeros((6, 6))


@checked_dataclass(eq=False)
class LinkHydrodynamics:
    """Hydrodynamic coefficients of one link. Arrays are read-only; a diagonal (6,) is accepted for
    every matrix.

    Raises InvalidInput for a wrong shape, NaN, an asymmetric or indefinite added mass, a negative
    volume, and drag that feeds energy at some velocity, by the condition of
    `uvms_ocp.robot.hydrodynamics`.
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
            if np.shape(value) == (6,):
                matrix = np.diag(value)
            else:
                matrix = value
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
    """(3,) or (n_links, 3) [m/s] u."""
    acceleration: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """(3,) or (n_links, 3) [m/s2] ``Du_Dt = du/dt + (u . grad) u``: of the water's particles,
    whatever the links do.
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
    """``nu_r`` (6,) [m/s, rad/s] of a link with nu (6,) [m/s, rad/s] in water with u_L (3,)
    [m/s].
    """
    return column(nu[:3] - u_L, nu[3:])


def relative_acceleration(a: Array, nu: Array, u_L: Array, w_L: Array) -> Array:
    """``nu_r_dot`` (6,) [m/s2, rad/s2]: of the link relative to the water at it, from accelerations
    relative to free fall.

    a (6,) [m/s2, rad/s2] and nu (6,) [m/s, rad/s] of the link; w_L (3,) [m/s2] and u_L (3,) [m/s]
    of the water. In axes that turn with the link u_L changes by ``R_WL.T Du_Dt - omega x u_L`` for
    a particle of the water: taking nu_dot for nu_r_dot is right in still water only.
    """
    return column(a[:3] + cross(nu[3:], u_L) - w_L, a[3:])


def added_mass_wrench(M_A: Array, nu_r: Array, nu_r_dot: Array) -> Array:
    """``M_A nu_r_dot + C_A(nu_r) nu_r`` (6,) [N, N m], Kirchhoff's equations [Fossen2021, sec.
    6.2].

    M_A (6, 6) [kg, kg m, kg m2]; nu_r (6,) [m/s, rad/s]; nu_r_dot (6,) [m/s2, rad/s2].
    """
    momentum = M_A @ nu_r
    rate = M_A @ nu_r_dot
    linear = nu_r[:3]
    angular = nu_r[3:]
    force = rate[:3] + cross(angular, momentum[:3])
    return column(force, rate[3:] + cross(angular, momentum[3:]) + cross(linear, momentum[:3]))


def flow_speeds(nu_r: Array, by_flow: bool) -> Array:
    """Speeds (6,) [m/s, rad/s] that quadratic drag counts at nu_r (6,) [m/s, rad/s]: along each
    axis, or of the whole flow.

    By axes the same body is dragged less along a diagonal of its axes than along an axis, by up to 42 %. By the flow its force is
    ``-q_i |u| u_i``: the same on the axes, an ellipsoid between them. Rotation has no flow with a direction: each of its axes
    has its own rate either way.
    """
    if not by_flow:
        return abs(nu_r)
    return column((nu_r[:3].T @ nu_r[:3] + _STILL**2) ** 0.5 + 0 * nu_r[:3], abs(nu_r[3:]))


def damping_matrix(
    linear_drag: Array, quadratic_drag: Array, nu_r: Array, by_flow: bool = False
) -> Array:
    """``D(nu_r)`` (6, 6) [N/(m/s), N m/(rad/s)] at nu_r (6,) [m/s, rad/s].

    linear_drag (6, 6) [N/(m/s), N m/(rad/s)]; quadratic_drag (6, 6) [N/(m/s)^2, N m/(rad/s)^2];
    by_flow: see `flow_speeds`.
    """
    return linear_drag + quadratic_drag @ diagonal(flow_speeds(nu_r, by_flow))


def drag_wrench(
    linear_drag: Array, quadratic_drag: Array, nu_r: Array, by_flow: bool = False
) -> Array:
    """``D(nu_r) nu_r`` (6,) [N, N m] at nu_r (6,) [m/s, rad/s].

    linear_drag (6, 6) [N/(m/s), N m/(rad/s)]; quadratic_drag (6, 6) [N/(m/s)^2, N m/(rad/s)^2];
    by_flow: see `flow_speeds`.
    """
    return linear_drag @ nu_r + quadratic_drag @ (flow_speeds(nu_r, by_flow) * nu_r)


def pressure_wrench(displaced_mass: Array, p_LB: Array, w_L: Array) -> Array:
    """Wrench (6,) [N, N m] of the undisturbed water on the link: buoyancy and Froude-Krylov force
    at p_LB (3,) [m].

    displaced_mass () [kg]: density times volume; w_L (3,) [m/s2]: acceleration of the water
    relative to free fall.
    """
    force = displaced_mass * w_L
    return column(force, cross(p_LB, force))


def check_added_mass(matrix: np.ndarray, where: str = "") -> None:
    """Raise `InvalidInput` where an added mass (6, 6) [kg, kg m, kg m2] is not symmetric, or
    indefinite.
    """
    scale = max(1.0, float(np.abs(matrix).max()))
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
    return f"feeds {power:.3g} W at nu = ({', '.join(f'{entry:.4g}' for entry in nu)}) m/s, rad/s"
