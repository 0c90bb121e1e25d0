"""How much stricter a plan is than the mission asks: what is flown departs from what was planned."""

from __future__ import annotations

from dataclasses import dataclass

from uvms_ocp.arguments import Magnitude, checked

_LEAST = 0.25  # share of a threshold that a plan may use, however large the margin


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class Margins:
    """Of thresholds and limits: of each a quarter is left in any case."""

    position: Magnitude = 0.02
    """[m] of positions and distances."""
    angle: Magnitude = 0.01
    """[rad]"""
    altitude: Magnitude = 0.01
    """[m]"""
    links: Magnitude = 0.03
    """[m] between the robot's own links."""
    hold: Magnitude = 0.2
    """[s] beyond the time for which conditions have to hold."""


def inside(limit: float, margin: float) -> float:
    """What a plan keeps below, so that what is flown stays below a limit [m or rad]; margin [m or rad]."""
    return max(limit - margin, _LEAST * limit)
