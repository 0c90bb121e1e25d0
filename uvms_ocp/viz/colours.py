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
DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (4, 1.5, 1, 1.5)))
"""Dashes of lines, one after the other where the colours come again."""


def line_style(k: int) -> dict[str, Any]:
    """Return the colour of the k-th line of many, and dashes where the colours come again."""
    n_before, color = divmod(k, len(LINES))
    return {"color": LINES[color], "ls": DASHES[n_before % len(DASHES)]}
