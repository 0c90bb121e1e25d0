"""Inertia of a rigid body that some distribution of mass has, whatever the coordinates [Rucker2022].

A body has mass m, centre of mass c and the second moment of its mass about c, ``S = int (r - c)(r - c)' dm``. Exactly where
m > 0 and S is positive definite, its pseudo-inertia ``[[S + m c c', m c], [m c', m]]`` is, and some mass that fills a volume
has these numbers: the triangle inequality of inertias follows. log m, c and the log-Cholesky factor of S are the factor of the
pseudo-inertia, up to a smooth change that lets mass and centre be known apart from the rest.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.spatial import skew


def second_moment(inertia: np.ndarray) -> np.ndarray:
    """S (3, 3) [kg m2] of a rotational inertia (3, 3) [kg m2], both about the centre of mass.

    Raises InvalidInput for an inertia that no body has.
    """
    S = np.trace(inertia) / 2 * np.eye(3) - inertia
    if not np.linalg.eigvalsh(S).min() > 0.0:
        raise InvalidInput(
            "inertia of no body given; allowed: each principal moment less than the sum of the other two"
        )
    return S


def rotational_inertia(S: ca.SX) -> ca.SX:
    """Inertia (3, 3) [kg m2] of a second moment S (3, 3) [kg m2], both about the centre of mass."""
    return ca.trace(S) * ca.SX.eye(3) - S


def spatial_inertia(mass: ca.SX, centre: ca.SX, S: ca.SX) -> ca.SX:
    """(6, 6) [kg, kg m, kg m2] about the origin of the frame in which the centre of mass (3,) [m] is given, linear first."""
    c = skew(centre)
    upper = ca.horzcat(mass * ca.SX.eye(3), -mass * c)
    return ca.vertcat(upper, ca.horzcat(mass * c, rotational_inertia(S) - mass * c @ c))


def pseudo_inertia(mass: ca.SX, centre: ca.SX, S: ca.SX) -> ca.SX:
    """(4, 4) [kg m2, kg m, kg] positive definite for a positive mass [kg] and S (3, 3) [kg m2], whatever the centre (3,) [m]."""
    first = mass * centre
    return ca.vertcat(ca.horzcat(S + first @ centre.T, first), ca.horzcat(first.T, mass))
