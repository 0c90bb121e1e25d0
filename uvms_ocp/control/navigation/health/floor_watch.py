"""Whether an echo of the altimeter fits the motion of the vehicle and what the floor did so far."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from uvms_ocp.control.navigation.health.tuning import HealthTuning
from uvms_ocp.model.kinematics import Beam

_SIGMAS = 8.0
_SPACING = 0.5  # [s] between the echoes that are kept
_STEEPEST = 0.6  # of a slope along which a beam runs down
_RETURN = 3  # echoes in a row from a floor known before that bring it back


class Spot(NamedTuple):
    """Where an echo came from."""

    t: float
    """[s] when."""
    x: float
    """[m] in W."""
    y: float
    """[m] in W."""
    z: float
    """[m] in W."""
    sensor: tuple[float, float, float]
    """(3,) [m] the altimeter in W."""

    def room(self, old: Spot, slope: float) -> float:
        """By how much [m] the floor may rise or fall from an old spot to this one; slope [-]: of the steepest floor.

        A beam that goes deeper than the old spot has passed its level at a point near it or far from it: from there on both
        fall, and meet the later, the more the beam tilts.
        """
        x, y, z = self.sensor
        share = min(1.0, (z - old.z) / (z - self.z)) if z > self.z and z > old.z else 1.0
        away = math.hypot(x + share * (self.x - x) - old.x, y + share * (self.y - y) - old.y)
        if share == 1.0:
            return slope * away
        tilt = math.hypot(self.x - x, self.y - y) / (z - self.z)
        return slope * away / (1.0 - min(slope * tilt, _STEEPEST))


class Belief(NamedTuple):
    """What to do with a reading."""

    used: bool
    """Whether it is passed on."""
    why: str | None
    """What speaks against it."""
    sane: bool = True
    """Whether that is the estimate alone, if anything."""


_FINE = Belief(used=True, why=None)


def spot_of(beam: Beam, echo: float, t: float) -> Spot:
    """Where the echo [m] along the beam came from at time t [s]."""
    x, y, z = (beam.origin + echo * beam.direction).tolist()
    return Spot(t, x, y, z, tuple(beam.origin.tolist()))


class FloorWatch:
    """Compares every echo with the floor that echoes showed nearby.

    A floor that is nearer is believed at once, as the safe case. One that is farther away is believed when echoes have agreed
    with each other for a while in which the vehicle moved vertically, as an altimeter that is stuck shows a floor that follows
    the vehicle, and horizontally, as floors do not sink. The floor that was known before is kept beside a new one, and believed
    again after a few echoes.
    """

    def __init__(self, sigma: float, tuning: HealthTuning) -> None:
        """sigma [m]: noise of the altimeter."""
        self._base, self._tuning = tuning.position + _SIGMAS * sigma, tuning
        self._known: deque[Spot] = deque()
        self._before: deque[Spot] = deque()
        self._candidate: list[Spot] = []
        self._returned = 0

    def belief(self, spot: Spot) -> Belief:
        """Whether to believe an echo, in order of time."""
        self._forget(spot.t)
        step = self._step(spot, self._known)
        if step is None:
            return self._accept(spot)
        if step > 0.0:
            return self._nearer(spot, step)
        if self._before and self._step(spot, self._before) is None:
            return self._as_before(spot, step)
        self._returned = 0
        return self._farther(spot, step)

    def _step(self, spot: Spot, known: deque[Spot]) -> float | None:
        """By how much [m] the floor would rise from the known spot that fits least; `None` where all fit."""
        worst, worst_excess = None, 0.0
        for old in known:
            rise = spot.z - old.z
            excess = abs(rise) - self._base - spot.room(old, self._tuning.slope)
            if excess > worst_excess:
                worst, worst_excess = rise, excess
        return worst

    def _accept(self, spot: Spot) -> Belief:
        if not self._known or spot.t - self._known[-1].t >= _SPACING:
            self._known.append(spot)
        self._candidate, self._returned = [], 0
        return _FINE

    def _nearer(self, spot: Spot, step: float) -> Belief:
        if not self._before:
            self._before = self._known
        self._known = deque([spot])
        self._candidate, self._returned = [], 0
        return Belief(used=True, why=f"the floor {step:.3g} m nearer at once; believed, to be safe")

    def _as_before(self, spot: Spot, step: float) -> Belief:
        self._returned += 1
        if self._returned < _RETURN:
            return Belief(used=False, why=f"the floor {-step:.3g} m farther at once, where it was before")
        self._known, self._before = self._before, deque()
        return self._accept(spot)

    def _farther(self, spot: Spot, step: float) -> Belief:
        if self._candidate and not self._fits(spot):
            self._candidate = []
        self._candidate.append(spot)
        if self._proven(-step):
            self._known, self._before = deque([spot]), deque()
            return self._accept(spot)
        return Belief(used=False, why=f"the floor {-step:.3g} m farther at once; not believed before it proves true")

    def _fits(self, spot: Spot) -> bool:
        return abs(spot.z - self._candidate[0].z) <= self._grace(spot)

    def _grace(self, spot: Spot) -> float:
        """[m] by which an echo may differ from the first one that was not believed, of one floor."""
        return 0.5 * (self._base + spot.room(self._candidate[0], self._tuning.slope))

    def _proven(self, step: float) -> bool:
        """Whether the vehicle has moved as one does above a floor that is a step [m] farther away, and above another place."""
        first, here, last = self._candidate[0], self._candidate[-1], self._known[-1]
        away = math.hypot(here.sensor[0] - last.sensor[0], here.sensor[1] - last.sensor[1])
        if here.t - first.t < self._tuning.step_time or away < self._tuning.step_way or step > self._tuning.relief:
            return False
        travel = float(np.ptp([spot.sensor[2] for spot in self._candidate]))
        return travel >= max(self._tuning.step_travel, 2.0 * self._grace(self._candidate[-1]))

    def _forget(self, t: float) -> None:
        for spots in (self._known, self._before):
            while len(spots) > 1 and spots[0].t < t - self._tuning.floor_memory:
                spots.popleft()
        if len(self._candidate) > 1 and self._candidate[0].t < t - self._tuning.floor_memory:
            del self._candidate[0]
