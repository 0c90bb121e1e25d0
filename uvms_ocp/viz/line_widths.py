"""Widths of lines [points] of figures, from the finest to the broadest; of all other lines
``figures.mplstyle`` has them.
"""

from __future__ import annotations

HAIR = 0.5
"""Where two pieces of a plan meet."""
FINE = 0.6
"""Begins of phases, spreads, residuals over time: many lines, or lines behind others."""
THIN = 0.7
"""What was measured, beside predictions."""
LIGHT = 0.8
"""Limits, and curves of many thrusters or joints in one panel."""
PLAIN = 0.9
"""Thresholds, faults, and curves of three or fewer columns."""
MEDIUM = 1.0
"""Curves of runs that are compared joint by joint."""
FIRM = 1.1
"""Curves of tasks, and of several runs in one panel."""
STRONG = 1.2
"""Curves of velocities, and bars of correlations."""
BOLD = 2.0
"""Paths and the floor."""
BROAD = 2.5
"""What a curve is compared with, behind it."""
EDGELESS = 0
"""Edges of filled areas."""
