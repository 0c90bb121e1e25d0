"""Numbers that C and NumPy share."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class StageTolerances:
    """Relative ones, without a unit."""

    rounding: float = 4e-15
    """[-] pivot, relative to its diagonal entry, that may be rounding alone."""
    tiny: float = 1e-290
    """[-] pivot that is none."""
    indefinite: float = 1e-9
    """[-] negative pivot, relative to its diagonal entry, that is no rounding."""
    damped: float = 1e-8
    """[-] pivot, relative to its diagonal entry, that takes the place of rounding."""
    smallest_curvature: float = 1e-12
    """[-] relative to the largest: what a diagonal entry is at least, where it is a measure."""
    elasticity: float = 1e-7
    """[-] compliance of hard rows in one step, relative to that of the stiffest variable; what it leaves, the next step takes."""
    phase_one: float = 1e-6
    """[-] curvature of phase one, beside a cost of 1 for what is missed."""
    to_boundary: float = 0.995
    """[-] share of the way to the nearest bound."""


STAGE_TOLERANCES = StageTolerances()
