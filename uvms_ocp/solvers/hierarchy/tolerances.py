"""Tolerances of the active set and its certificate, shared by C (as macros) and Python.

They separate rounding from results. The size of a row is ``|a| + |bound|``, in normal units
(`certificate.normal_rows`).
"""

from __future__ import annotations

LARGEST = 1e15
"""[rate/velocity] Entry of a Jacobian from which on rows are invalid: beside it, rounding alone is
as large as an ordinary row.
"""
ENDLESS = 1e300
"""[rate, velocity] A bound from here on is no size to measure rounding by, and a velocity none to
return: sums and squares overflow.
"""
VANISHED = 1e-13
"""Relative to the largest row: smaller rows are remainders of a cancellation, and count as
nothing.
"""
UNNOTICED = 1e-12
"""[rate] A row that counts as nothing and can change its rate by less is missed by nobody."""
SMALL_SQUARE = 1e-200
"""[rate^2/velocity^2] A sum of squares from here on has lost digits to underflow."""

RANK_TOLERANCE = 1e-8
"""Relative to a row: with less of it in the free space it depends on the rows before. A division by
less would leave fewer than half of the digits.
"""
RANK_NOISE = 1e-14
"""Over the smallest pivot so far: directions carry the rounding error of their own pivot, and a
small pivot makes dependent rows look independent.
"""
RECOMPUTED = 0.01
"""Relative to what was left of a row when it was last computed: with less, what is left is computed
anew, as subtractions have taken two of its digits.
"""
CAREFUL_RANK = 1e-12
"""`RANK_TOLERANCE` of the second attempt level by level, to which more rows are independent."""
CAREFUL_NOISE = 1e-15
"""`RANK_NOISE` of the second attempt level by level."""

FEASIBLE = 1e-12
"""Relative to the size of a row: by how much it may be beyond a bound before it becomes active.
Well above what rounding does to a sum of a few dozen products.
"""
SIGNIFICANT = 1e-14
"""Relative to the size of a row: a smaller slack decides nothing for lower levels. Far below
`FEASIBLE`: else a row dropped for the sake of lower levels blocks at once for the sake of this
slack.
"""
MOVED = 1e-9
"""Relative to the largest velocity and 1: a shorter step is a standstill, of which too many in a
row are a cycle.
"""
MULTIPLIER = 1e-10
"""Relative to the sum of slack times row: multipliers of this size have the right sign whatever it
is.
"""
CAREFUL_MULTIPLIER = 1e-7
"""`MULTIPLIER` of the second attempt level by level, which drops fewer rows for rounding."""
WRONG = 1e-12
"""Multipliers smaller than this are rounding, however small the slack they balance."""

CERTIFIED = 1e-7
"""Relative to the residual of a level or to the unit of rates (`NormalRows.unit`): a result counts
as solved if no level can exceed its optimum by more. At an optimum rounding alone leaves 1e-8, the
accuracy of the gradient of a level of residual 1e-8.
"""
RESOLVED = 1e-3
"""Rounding of the rows, times their multipliers, is in the certificate where it is more than this,
in normal units: which of nearly dependent rows is in conflict is then unknown.
"""
REACH = 2.0
"""Radius within which a better velocity is sought, in normal units: twice the velocity asked
for.
"""
NEGLIGIBLE = 1e-9
"""A multiplier of the wrong sign that adds no more to the certificate is left as it is."""
ROUNDING = 2.3e-16
"""Relative to ``|a| |v|`` and the number of velocities: rounding error of ``a v``. The spacing of
doubles at 1 is 2.22e-16.
"""
DESCENT = 1e-16
"""Relative to a gradient: multipliers that reduce it by less are no descent but rounding."""
LEAST_DESCENT = 1e-18
"""Second `DESCENT`, where no certificate is found with the first: large multipliers of nearly
dependent rows.
"""

TOUCHING = 1e-9
"""Relative to ``1 + sum |a|``: rows this near to a bound where the levels have ended one by one
start the next run active, and a level above is held up to this.
"""
TIED = 1e-9
"""Relative to 1 and the norm: levels whose residuals differ by less are equally good; of two runs,
a lower level decides.
"""
