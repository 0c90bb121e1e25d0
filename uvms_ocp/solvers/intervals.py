"""How far numbers are from the interval they should be in, for NumPy arrays and CasADi expressions alike."""

from __future__ import annotations

from uvms_ocp.functions.elementwise import Array, clipped


def distance(y: Array, lower: Array, upper: Array) -> Array:
    """Signed distance of y to [lower, upper], entry by entry: negative below, 0 inside; NaN where y is.

    y, lower and upper (...) [unit of y].
    """
    return y - clipped(y, lower, upper)


def excess(y: Array, lower: Array, upper: Array) -> Array:
    """By how much y is outside of [lower, upper], entry by entry, on either side; NaN where y is.

    y, lower and upper (...) [unit of y].
    """
    return abs(distance(y, lower, upper))
