"""Levels in, the exact optimum out, by active sets in C or NumPy."""

from uvms_ocp.solvers.hierarchy.active_set.solver import LexicographicActiveSet as LexicographicActiveSet
