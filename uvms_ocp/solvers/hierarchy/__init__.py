"""Lexicographic least squares: levels of linear rows in strict order, and the velocity that is best
for them.
"""

from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet as LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.cascade import (
    LexicographicQp as LexicographicQp,
    conic_plugins as conic_plugins,
)
