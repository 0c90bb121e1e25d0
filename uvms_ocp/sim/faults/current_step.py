"""Currents that set in while the robot is under way, on top of what flows there anyway."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.sim.currents import Current
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.faults.fault import Fault
from uvms_ocp.sim.seafloor import Seafloor, ground_at

RISE = 2.0
"""[s] from nothing to the whole step, and back at its end."""
LAYER = 2.0
"""[m] above the floor over which the vertical part grows from 0 (assumed): no water flows through the floor."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SteppedCurrent(Current):
    """A current with steps on top, each a cosine in time; their vertical part is a cosine in the height above the floor.

    The horizontal outflow that the vertical part would bring about above the floor is neglected.
    """

    base: Current
    """What flows without the faults."""
    seafloor: Seafloor
    """Through which nothing flows."""
    faults: tuple[Fault, ...]
    """Steps of the current."""

    def velocity(self, p_W: np.ndarray, t: float) -> np.ndarray:
        base, step = self.base.velocity(p_W, t), self._step(t)
        return base + self._shape(p_W, step) if step.any() else base

    def rate(self, p_W: np.ndarray, t: float) -> np.ndarray:
        base, slope = self.base.rate(p_W, t), self._slope(t)
        return base + self._shape(p_W, slope) if slope.any() else base

    def gradient(self, p_W: np.ndarray, t: float) -> np.ndarray:
        base, vertical = self.base.gradient(p_W, t), self._step(t)[2]
        if not vertical:
            return base
        added = np.zeros((len(p_W), 3, 3))
        added[:, 2] = vertical * self._slope_of_share(p_W)
        return base + added

    def _step(self, t: float) -> np.ndarray:
        """(3,) [m/s] of all steps together, far above the floor."""
        parts = [(_risen(t - fault.onset) - _risen(t - fault.end)) * np.array(fault.values) for fault in self.faults]
        return np.sum(parts, axis=0)

    def _slope(self, t: float) -> np.ndarray:
        """(3,) [m/s2] of `_step` over time."""
        parts = [(_rising(t - fault.onset) - _rising(t - fault.end)) * np.array(fault.values) for fault in self.faults]
        return np.sum(parts, axis=0)

    def _shape(self, p_W: np.ndarray, step: np.ndarray) -> np.ndarray:
        """(n, 3): a step at points p_W (n, 3), less its vertical part near the floor."""
        field = np.tile(step, (len(p_W), 1))
        if step[2]:
            heights = p_W[:, 2] - ground_at(self.seafloor, p_W[:, :2])[0]
            field[:, 2] *= [_smooth(height / LAYER) for height in heights.tolist()]
        return field

    def _slope_of_share(self, p_W: np.ndarray) -> np.ndarray:
        """(n, 3) [1/m] gradient of the share of the vertical part that is left at points p_W (n, 3)."""
        floor, normals = ground_at(self.seafloor, p_W[:, :2])
        slopes = [_smooth_slope(height / LAYER) / LAYER for height in (p_W[:, 2] - floor).tolist()]
        return np.array(slopes)[:, None] * normals / normals[:, 2:]


def with_steps(environment: Environment, faults: Sequence[Fault]) -> Environment:
    """The environment with the steps of its current that are among the faults."""
    own = tuple(fault for fault in faults if fault.strikes.family == "current")
    if not own:
        return environment
    current = SteppedCurrent(base=environment.current, seafloor=environment.seafloor, faults=own)
    return replace(environment, current=current)


def _risen(elapsed: float) -> float:
    return _smooth(elapsed / RISE)


def _rising(elapsed: float) -> float:
    return _smooth_slope(elapsed / RISE) / RISE


def _smooth(share: float) -> float:
    """From 0 at 0 to 1 at 1, level beyond both."""
    return 0.5 - 0.5 * math.cos(math.pi * min(max(share, 0.0), 1.0))


def _smooth_slope(share: float) -> float:
    return 0.5 * math.pi * math.sin(math.pi * share) if 0.0 < share < 1.0 else 0.0
