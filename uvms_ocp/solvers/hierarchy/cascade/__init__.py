"""Levels in, the optimum of one quadratic program after the other out."""

from uvms_ocp.solvers.hierarchy.cascade.solver import LexicographicQp as LexicographicQp
from uvms_ocp.solvers.hierarchy.cascade.solver import conic_plugins as conic_plugins
