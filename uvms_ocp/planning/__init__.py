"""Ahead of time: trajectories, their times, and their clearance from obstacles."""

from .min_snap import Boundary as Boundary
from .min_snap import Constraint as Constraint
from .min_snap import MinSnap as MinSnap
from .min_snap import min_snap as min_snap
from .polynomial import PiecewisePolynomial as PiecewisePolynomial
