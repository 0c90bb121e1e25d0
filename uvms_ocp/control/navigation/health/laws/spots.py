"""Where echoes came from, in rings of those that are remembered."""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.functions.kernels.layout import Layout, Sized

MOST_SPOTS = 128
_STEEPEST = 0.6  # of a slope along which a beam runs down


class Spot(Layout):
    """Where an echo came from, in W."""

    t: float
    """[s] when."""
    x: float
    """[m]"""
    y: float
    """[m]"""
    z: float
    """[m]"""
    sensor_x: float
    """[m]"""
    sensor_y: float
    """[m]"""
    sensor_z: float
    """[m]"""
    lowest: float
    """[m] of the sensor until the next spot that is kept."""
    highest: float
    """[m] the same."""


class Spots(Layout):
    """In the order of time, in a ring."""

    first: int
    count: int
    kept: Annotated[list[Spot], Sized(MOST_SPOTS)]


def slot_of(s: Spots, k: int) -> int:
    """Of spot k [-], from the oldest."""
    return (s.first + k) % len(s.kept)


def append_spot(s: Spots, new: Spot) -> None:
    """Keep a spot; where all places are taken the oldest goes."""
    if s.count == len(s.kept):
        forget_first(s)
    _copy_spot(s.kept[slot_of(s, s.count)], new)
    s.count += 1


def forget_first(s: Spots) -> None:
    """The oldest goes."""
    s.first = (s.first + 1) % len(s.kept)
    s.count -= 1


def forget_older(s: Spots, t: float) -> None:
    """Those from before time t [s] go, the last one aside."""
    while s.count > 1 and s.kept[s.first].t < t:
        forget_first(s)


def keep_alone(s: Spots, new: Spot) -> None:
    """A spot and nothing before it."""
    s.count = 0
    append_spot(s, new)


def copy_spots(to: Spots, other: Spots) -> None:
    """Make one the same as the other."""
    to.first = 0
    to.count = 0
    for k in range(other.count):
        append_spot(to, other.kept[slot_of(other, k)])


def step_to(known: Spots, new: Spot, base: float, slope: float) -> float:
    """By how much [m] the floor would rise from the known spot that fits least to a new one; 0 where all fit.

    base [m]: that is nothing. slope [-]: of the steepest floor.
    """
    worst, worst_excess = 0.0, 0.0
    for k in range(known.count):
        old = known.kept[slot_of(known, k)]
        beyond = abs(new.z - old.z) - base
        if beyond > worst_excess:
            excess = beyond - room(new, old, slope)
            if excess > worst_excess:
                worst = new.z - old.z
                worst_excess = excess
    return worst


def room(new: Spot, old: Spot, slope: float) -> float:
    """By how much [m] the floor may rise or fall from an old spot to a new one; slope [-]: of the steepest floor.

    A beam that goes deeper than the old spot has passed its level at a point near it or far from it: from there on both
    fall, and meet the later, the more the beam tilts.
    """
    dx, dy, fall = new.x - new.sensor_x, new.y - new.sensor_y, new.sensor_z - new.z
    share = min(1.0, (new.sensor_z - old.z) / fall) if fall > 0.0 and new.sensor_z > old.z else 1.0
    away = slope * _length(new.sensor_x + share * dx - old.x, new.sensor_y + share * dy - old.y)
    if share == 1.0:
        return away
    return away / (1.0 - min(slope * (_length(dx, dy) / fall), _STEEPEST))


def apart(a: Spot, b: Spot) -> float:
    """[m] horizontally between the places of the sensor."""
    return _length(a.sensor_x - b.sensor_x, a.sensor_y - b.sensor_y)


def travel(s: Spots) -> float:
    """[m] between the lowest and the highest place of the sensor."""
    lowest, highest = math.inf, -math.inf
    for k in range(s.count):
        spot = s.kept[slot_of(s, k)]
        lowest = min(lowest, spot.lowest)
        highest = max(highest, spot.highest)
    return highest - lowest


def _length(x: float, y: float) -> float:
    return math.sqrt(x * x + y * y)


def _copy_spot(to: Spot, new: Spot) -> None:
    to.t = new.t
    to.x = new.x
    to.y = new.y
    to.z = new.z
    to.sensor_x = new.sensor_x
    to.sensor_y = new.sensor_y
    to.sensor_z = new.sensor_z
    to.lowest = new.sensor_z
    to.highest = new.sensor_z
