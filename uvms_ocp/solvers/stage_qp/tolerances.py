"""Tolerances of the interior-point method in C, to which they are macros."""

ROUNDING = 4e-15
"""Pivot, relative to its diagonal entry, that may be rounding alone."""
TINY = 1e-290
"""Pivot that is none."""
INDEFINITE = 1e-9
"""Negative pivot, relative to its diagonal entry, that is no rounding."""
DAMPED = 1e-8
"""Pivot, relative to its diagonal entry, that takes the place of rounding."""
SMALLEST_CURVATURE = 1e-12
"""Diagonal entry that pivots are compared with, relative to the largest."""
ELASTICITY = 1e-7
"""Compliance of equalities in one step, relative to that of the stiffest variable; what it leaves,
the next one takes.
"""
SIDE_ELASTICITY = 1e-5
"""Elasticity of inequalities, relative to the one of equalities."""
SLOW = 1e-7
"""Curvature that steps of a second run reckon with in every direction, relative to gradient over
variables.
"""
PHASE_ONE = 1e-6
"""Curvature in phase one, beside a cost of 1 for what is missed."""
TO_BOUNDARY = 0.995
"""Share of the way to the nearest bound."""
SHORT_STEP = 0.1
"""Share of a step that the second order has spoilt."""
FLOOR = 1e-4
"""Complementarity aimed at, relative to the tolerance: less only loses digits."""
SHARPER = 1e3
"""of complementarity: a bound that only just binds is missed by the root of what is left of it."""
LEAST_SIZE = 1e-3
"""[unit of z] variables below which a gradient is compared with the curvature."""
UNCLEAR = 1.0
"""Relative change by a step that does not tell whether a bound is approached."""
MANY_CHANGES = 4
"""Number of bounds that change, above which the number must fall to half from round to round."""
VAIN_CHANGES = 2
"""Rounds in which fewer do not."""
MOST_CORRECTIONS = 10
"""Most corrections of a solution without inequalities."""
EXACT = 1e-5
"""Relative to the tolerance: those corrections go on down to this while they help."""
ROUGHLY = 1e-2
"""Share of the tolerance down to which corrections go on where the tolerance is above the next."""
ROUND = 0.5
"""Share of the tolerance down to which corrections go on while bounds are still changed."""
HOPELESSLY = 0.9
"""Share of what is left above the tolerance, of which less than the rest is taken by a correction
that leads nowhere.
"""
FINISHED = 1e-5
"""tolerance above which what an interior point comes close to is not looked for: it keeps off the
bounds.
"""
SHARP = 1e-2
"""Relative to the tolerance: by how much a side must be missed to be held."""
FAR = 0.5
"""Failure of all conditions from which the solution of a QP nearby is no start."""
NEARER = 1e2
"""Factor on complementarity at a warm start: more where that is far, less where it is not."""
LEAST_MISSED = 0.1
"""[unit of z] violation of bounds that a cold start reckons with."""
STUCK = 1e-7
"""Share of a step that leads nowhere."""
HOPELESS = 1e6
"""Factor by which multipliers grow where there is no point."""
INEXACT_TOLERANCES = 1e3
"""Tolerances to which an optimum can still be used."""
MOST_VAIN = 6
"""Iterations that bring such an optimum no nearer, after which it stays as it is."""
MOST_HIGH = 15
"""Iterations in which the violation does not fall, after which phase one is asked."""
ENDLESS = 1e12
"""[unit of z] variables beyond which a cost falls without end."""
