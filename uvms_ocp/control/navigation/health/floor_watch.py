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
    sensor_z: float
    """[m] of the altimeter in W."""


class Belief(NamedTuple):
    """What to do with an echo."""

    used: bool
    """Whether it is passed on."""
    why: str | None
    """What speaks against it."""


_FINE = Belief(used=True, why=None)


def spot_of(beam: Beam, echo: float, t: float) -> Spot:
    """Where the echo [m] along the beam came from at time t [s]."""
    x, y, z = (beam.origin + echo * beam.direction).tolist()
    return Spot(t, x, y, z, float(beam.origin[2]))


class FloorWatch:
    """Compares every echo with the floor that echoes showed nearby.

    A floor that is nearer is believed at once, as the safe case. One that is farther away is believed when echoes have agreed
    with each other for a while in which the vehicle moved vertically: an altimeter that is stuck shows a floor that follows
    the vehicle. The floor that was known before is kept beside a new one, and believed again after a few echoes.
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
            excess = abs(rise) - self._base - self._tuning.slope * math.hypot(spot.x - old.x, spot.y - old.y)
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
        if self._proven():
            self._known, self._before = deque([spot]), deque()
            return self._accept(spot)
        return Belief(used=False, why=f"the floor {-step:.3g} m farther at once; not believed before it proves true")

    def _fits(self, spot: Spot) -> bool:
        return abs(spot.z - self._candidate[0].z) <= self._grace(spot)

    def _grace(self, spot: Spot) -> float:
        """[m] by which two echoes from one floor may differ."""
        first = self._candidate[0]
        return self._base / 2 + self._tuning.slope / 2 * math.hypot(spot.x - first.x, spot.y - first.y)

    def _proven(self) -> bool:
        if self._candidate[-1].t - self._candidate[0].t < self._tuning.step_time:
            return False
        travel = float(np.ptp([spot.sensor_z for spot in self._candidate]))
        return travel >= max(self._tuning.step_travel, 2.0 * self._grace(self._candidate[-1]))

    def _forget(self, t: float) -> None:
        for spots in (self._known, self._before):
            while len(spots) > 1 and spots[0].t < t - self._tuning.floor_memory:
                spots.popleft()
        if len(self._candidate) > 1 and self._candidate[0].t < t - self._tuning.floor_memory:
            del self._candidate[0]
