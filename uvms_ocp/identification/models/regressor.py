"""Inverse dynamics as a matrix times what it is linear in, by differentiation of the symbolic dynamics.

``tau = Y(q, v, a) phi + rest``: phi holds the rigid body's mass, first and second moments of mass, and the water's added mass,
drag, displaced mass and its first moment, for one link; the rest is what other links do.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from uvms_ocp.identification.parameters.vehicle_quantities import AXES
from uvms_ocp.model.spatial import skew
from uvms_ocp.model.symbolic.dynamics import SymbolicDynamics
from uvms_ocp.model.symbolic.tree import function
from uvms_ocp.model.symbolic.wet_links import WaterCoefficients

_MOMENTS = ("xx", "yy", "zz", "xy", "xz", "yz")
_PLACES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_LOWER = tuple((i, j) for i in range(6) for j in range(i + 1))
_ALL = tuple((i, j) for i in range(6) for j in range(6))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Regressor:
    """Of the link and the joint body that carries it."""

    names: tuple[str, ...]
    """Of the entries of phi."""
    phi: np.ndarray
    """(n,) [kg, kg m, kg m2, and the units of drag] of the model itself."""
    matrix: ca.Function
    """``q, v, a, u, Du_Dt -> Y (n_v, n)``, with water as in `SymbolicDynamics`."""


def regressor_of(dynamics: SymbolicDynamics, link: int = 0) -> Regressor:
    """Build the regressor of a link, given by its place in ``links``."""
    n_v, n_links = dynamics.model.nv, len(dynamics.links)
    shapes = {"q": (dynamics.model.nq, 1), "v": (n_v, 1), "a": (n_v, 1), "u": (3, n_links), "Du_Dt": (3, n_links)}
    given = {name: ca.SX.sym(name, *shape) for name, shape in shapes.items()}
    phi, known = ca.SX.sym("phi", len(_names())), _known(dynamics, link)
    tau = _with(dynamics, link, phi).inverse_dynamics(*given.values())
    # It does not depend on phi but for a quotient that cancels: it is taken where that is a number.
    Y = ca.substitute(ca.jacobian(tau, phi), phi, ca.DM(known))
    return Regressor(names=_names(), phi=known, matrix=function("regressor", given, {"Y": Y}))


def _names() -> tuple[str, ...]:
    body = ("mass", *(f"first moment {axis}" for axis in "xyz"), *(f"inertia {moment}" for moment in _MOMENTS))
    added = (f"added mass {AXES[i]}-{AXES[j]}" for i, j in _LOWER)
    drag = (f"{kind} drag {AXES[i]}-{AXES[j]}" for kind in ("linear", "quadratic") for i, j in _ALL)
    return (*body, *added, *drag, "displaced mass", *(f"first moment of displaced mass {axis}" for axis in "xyz"))


def _with(dynamics: SymbolicDynamics, link: int, phi: ca.SX) -> SymbolicDynamics:
    body, added, linear, quadratic, displaced = ca.vertsplit(phi, [0, 10, 31, 67, 103, 107])
    inertia = _symmetric(body[4:], _PLACES, 3)
    first = skew(body[1:4])
    rigid = ca.vertcat(ca.horzcat(body[0] * ca.SX.eye(3), -first), ca.horzcat(first, inertia))
    water = WaterCoefficients(
        added_mass=_symmetric(added, _LOWER, 6),
        linear_drag=ca.reshape(linear, 6, 6).T,
        quadratic_drag=ca.reshape(quadratic, 6, 6).T,
        displaced_mass=displaced[0],
        p_LB=displaced[1:] / displaced[0],
    )
    return dynamics.with_coefficients(rigid={dynamics.joint_of(link): rigid}, links={link: water})


def _known(dynamics: SymbolicDynamics, link: int) -> np.ndarray:
    body, wet = dynamics.model.inertias[dynamics.joint_of(link)].matrix(), dynamics.links[link]
    first = [body[5, 1], body[3, 2], body[4, 0]]
    displaced = max(dynamics.density * wet.volume, np.finfo(float).tiny)
    return np.concatenate(
        [
            [body[0, 0], *first, *(body[3 + i, 3 + j] for i, j in _PLACES)],
            [wet.added_mass[i, j] for i, j in _LOWER],
            wet.linear_drag.ravel(),
            wet.quadratic_drag.ravel(),
            displaced * np.array([1.0, *wet.p_LB]),
        ]
    )


def _symmetric(entries: ca.SX, places: tuple[tuple[int, int], ...], n: int) -> ca.SX:
    matrix = ca.SX(n, n)
    for k, (i, j) in enumerate(places):
        matrix[i, j] = matrix[j, i] = entries[k]
    return matrix
