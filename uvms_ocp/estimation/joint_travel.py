"""Tell whether the encoder of a joint goes along with a change of its rate."""

from __future__ import annotations

LEAST_TRAVEL = 0.25
"""Share of the way that a change of rate makes at its end, which an encoder that goes along has gone
at least: what changes evenly has gone half of it, what stops at once less.
"""


def goes_along(travel: float, way: float) -> bool:
    """Return whether an encoder has travelled what a change of rate explains: at least a quarter of
    the way, and not much more than all of it. A kernel.

    travel [of way]: beyond that at the rate before. way: not 0, of the whole change over the time
    of the travel, or both per time.
    """
    return LEAST_TRAVEL <= travel / way <= 1.0 + LEAST_TRAVEL
