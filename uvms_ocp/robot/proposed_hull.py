"""Propose added mass and drag of a hull by the box around it and its mass: potential flow of the
ellipsoid in that box, and drag of its faces.

Frames and floats let water through, so that a hull moves less water than the ellipsoid in its box:
the geometric mean of both masses fits published vehicles from 11 to 1,900 kg. One that is as heavy
as the water in its box is that box, with edges, and moves more.
"""

from __future__ import annotations

import numpy as np

_SAME_SIDE = 1e-6  # relative: an ellipsoid as round as that turns no water
_ELLIPSOID = np.pi / 6.0  # volume over that of the box around it
_CUBE = 0.68
"""Added mass of a cube over that of the water in it (DNV-RP-C205, table D-2)."""
_SOLID = float(np.log(_CUBE / (0.5 * _ELLIPSOID)) / np.log(1.0 / _ELLIPSOID))
"""Exponent of the share of the ellipsoid that a hull fills, above 1, with which a cube has `_CUBE`.
"""
_SQUARE_PRISM = 0.725 / 16
"""Added inertia of a long square prism over that of the water in it, which the corners of a box add
to the ellipsoid.
"""
ADDED_MASS_INTERVAL = (0.3, 2.5)
"""Published added mass over the proposed one, in nine of ten entries."""
DRAG_INTERVAL = (0.25, 6.0)
"""Published quadratic drag over the proposed one, in nine of ten entries."""
_TURNING = 3.0
"""Drag of a hull that turns over that of its bare faces: ducts and frames stand far out."""
_FINE = 3.0  # longest side over the others, from which a hull is taken for a streamlined one


def hull_added_mass(sides: np.ndarray, mass: float, density: float) -> np.ndarray:
    """Return the added mass (6,) [kg, kg m2] along and about the axes of the box around a hull with
    sides (3,) [m] and a mass [kg], in water of a density [kg/m3].
    """
    solid = ellipsoid_added_mass(sides, density)
    box = density * float(np.prod(sides))
    squares = np.asarray(sides) ** 2
    for axis in range(3):
        a, b = np.delete(squares, axis)
        solid[3 + axis] += 2.0 * _SQUARE_PRISM * box * a * b / (a + b)
    share = min(mass / (_ELLIPSOID * box), 1.0 / _ELLIPSOID)
    if share < 1.0:
        return np.asarray(np.sqrt(share) * solid)
    return np.asarray(share**_SOLID * solid)


def ellipsoid_added_mass(sides: np.ndarray, density: float) -> np.ndarray:
    """Return the added mass (6,) [kg, kg m2] of an ellipsoid with axes (3,) [m] in water of a density
    [kg/m3], by Lamb's integrals (Lamb, Hydrodynamics, art. 114 and 115).
    """
    from scipy.special import elliprd

    squares = (np.asarray(sides, dtype=float) / 2.0) ** 2
    product = float(np.sqrt(np.prod(squares)))
    mass = density * 4.0 / 3.0 * np.pi * product
    alpha = np.zeros(3)
    for axis in range(3):
        integral = elliprd(*np.delete(squares, axis), squares[axis])
        alpha[axis] = 2.0 / 3.0 * product * integral
    added = np.zeros(6)
    added[:3] = mass * alpha / (2.0 - alpha)
    for axis in range(3):
        b2, c2 = np.delete(squares, axis)
        beta, gamma = np.delete(alpha, axis)
        difference = b2 - c2
        if abs(difference) <= _SAME_SIDE * (b2 + c2):
            continue
        denominator = 2.0 * difference + (b2 + c2) * (beta - gamma)
        added[3 + axis] = mass / 5.0 * difference**2 * (gamma - beta) / denominator
    return added


def hull_drag(sides: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the quadratic drag (6,) of a hull, from that of the bare faces of its box (6,): more
    where it turns, less along a long hull.
    """
    drag = np.array(faces, dtype=float)
    drag[3:] *= _TURNING
    long_axis = int(np.argmax(sides))
    fineness = float(sides[long_axis] / np.sqrt(np.prod(np.delete(sides, long_axis))))
    drag[long_axis] *= min(1.0, (_FINE / fineness) ** 2)
    return drag
