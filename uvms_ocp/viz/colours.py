"""Colours of figures, which colour-blind readers can tell apart, and dashes of lines."""

from __future__ import annotations

from typing import Any

LINES = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9", "#000000")
"""Colours of lines [Okabe2008], without the yellow that vanishes on white."""
BLUE, VERMILLION, GREEN, ORANGE, PINK, SKY, BLACK = LINES
AXES_XYZ = (VERMILLION, GREEN, BLUE)
THRESHOLD = "#555555"
"""Colour of limits and of their texts."""
FADED = "#AEB4B9"
"""Colour of curves while their task is off."""
FAULT = VERMILLION
"""Colour of the begin and the end of a fault, and of its name."""
TRUST = {"good": GREEN, "suspect": ORANGE, "lost": VERMILLION}
"""Colours of channels by how far they are trusted."""
PHASES = ((BLUE, 0.09), (ORANGE, 0.12), (GREEN, 0.1), (PINK, 0.16), ("#808080", 0.12))
"""Colours of phases and how much they cover, on light and dark paper."""
PHASE_BEGIN = "#9AA3AB"
"""Colour of the line at which a phase begins."""
BREAK = "#D5DADF"
"""Colour of the line where two pieces of a plan meet."""
FLOOR = "#8C6D46"
OBSTACLE = "#D9B48F"
OBSTACLE_EDGE = "#8A5A2B"
DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (4, 1.5, 1, 1.5)))
"""Dashes of lines, one after the other where the colours come again."""


def line_style(k: int) -> dict[str, Any]:
    """Return the colour of the k-th line of many, and dashes where the colours come again."""
    n_before, color = divmod(k, len(LINES))
    return {"color": LINES[color], "ls": DASHES[n_before % len(DASHES)]}
