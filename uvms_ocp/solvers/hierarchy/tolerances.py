"""Every tolerance of the active set and of its certificate, for the core in C (`core_source` makes macros of them) and Python."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class Tolerances:
    """What counts as rounding, and what does not. The size of a row is ``|a| + |bound|``.

    `[rate]` is the unit of a row, `[velocity]` that of an entry of v.
    """

    largest: float = 1e15
    """[rate/velocity] Entry of a Jacobian from which on rows are invalid: beside it, rounding alone is as large as an ordinary
    row."""
    endless: float = 1e300
    """[rate, velocity] A bound from here on is no size to measure rounding by, and a velocity none to return: sums and squares
    overflow."""
    vanished: float = 1e-13
    """[-] Of the largest row: smaller rows are what is left of a cancellation, and count as nothing."""
    even: float = 1e3
    """[-] Largest over smallest row; beyond, what is rounding to one row decides about another, so that a run is doubtful."""

    rank_tolerance: float = 1e-8
    """[-] Of a row: with less of it in the free space it depends on the rows before. A division by less would leave fewer
    than half of the digits."""
    rank_noise: float = 1e-14
    """[-] Over the smallest pivot so far: directions carry the rounding error of their own pivot, and a small pivot makes
    dependent rows look independent."""
    clear: float = 1e-5
    """[-] Of a row: a smaller pivot leaves open what depends on what, so that a run is doubtful."""
    nothing: float = 1e-11
    """[-] Of a row taken for dependent: where more of it is independent, it is open whether it was, and a run is doubtful."""

    feasible: float = 1e-12
    """[-] Of the size of a row: by how much it may be beyond a bound before it becomes active. Well above what rounding does
    to a sum of a few dozen products."""
    consistent: float = 1e-10
    """[-] Of the size of a row: by how much an active row may miss what the factorisation has promised. Above `feasible`,
    as the errors of all levels above add up in it."""
    significant: float = 1e-14
    """[-] Of the size of a row: a smaller slack decides nothing for lower levels. Far below `feasible`: else a row dropped
    for the sake of lower levels blocks at once for the sake of this slack."""
    moved: float = 1e-9
    """[-] Of the largest velocity and 1: a shorter step is a standstill, of which too many in a row are a cycle."""
    multiplier: float = 1e-10
    """[-] Of the sum of slack times row: multipliers of this size have the right sign whatever it is."""
    wrong: float = 1e-12
    """[-] Multipliers smaller than this are rounding, however small the slack they balance."""
    decisive: float = 1e4
    """[-] Of `multiplier`: beyond it the sign decides for all levels below; short of it, the opposite sign at a lower level
    leaves the run doubtful."""
    balanced: float = 5e-8
    """[-] Of slack times row and 1: gradient that the multipliers may leave of a level; above it a run is doubtful."""

    certified: float = 1e-8
    """[-] A run that does not vouch for itself counts as solved if its certificate is at most this: the conditions of an
    optimum then hold to half of the digits."""
    active: float = 1e-9
    """[-] Of the size of a row: distance to a bound below which the row may carry a multiplier of the certificate."""
    slight: float = 1e-12
    """[-] Of the size of a row: slack above rounding, if its level is balanced to `slightly_balanced`; `active` if not."""
    slightly_balanced: float = 1e-4
    """[-] Of slack times row: a slack as small as the distance to a bound must be balanced by itself to be one."""
    rounding: float = 2.2e-16
    """[-] Of ``|a| |v|`` and the number of velocities: what rounding leaves open of ``a v``. The spacing of doubles at 1."""
    descent: float = 1e-14
    """[-] Of a gradient: multipliers that reduce it by less are no descent but rounding, and could be taken for ever."""
    no_gradient: float = 1e-11
    """[-] A gradient this small needs no multipliers: it is far below `certified` without any."""

    touching: float = 1e-9
    """[-] Of ``1 + sum |a|``: rows this near to a bound where the cascade has ended start the next run active."""
    tied: float = 1e-9
    """[-] Of 1 and the norm: levels whose residuals differ by less are equally good; of two runs, a lower level decides."""


TOLERANCES = Tolerances()
