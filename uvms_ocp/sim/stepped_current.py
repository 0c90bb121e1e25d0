"""Currents that set in while the robot is under way, on top of what flows there anyway."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.sim.currents import Current, cosine_slope, cosine_step
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.faults import Fault
from uvms_ocp.sim.seafloor import Seafloor, ground_at

RISE = 2.0
"""[s] from nothing to the whole step, and back at its end."""
LAYER = 2.0
"""[m] above the floor over which the vertical part grows from 0 (assumed): no water flows through
the floor.
"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SteppedCurrent(Current):
    """A current with steps on top, each a cosine in time; their vertical part is a cosine in the
    height above the floor.

    The horizontal outflow that the vertical part would bring about above the floor is neglected.
    """

    base: Current
    """Current without the faults."""
    seafloor: Seafloor
    """Floor, through which no water flows."""
    faults: tuple[Fault, ...]
    """Steps of the current."""

    def velocity(self, p_W: np.ndarray, t: float) -> np.ndarray:
        base = self.base.velocity(p_W, t)
        step = self._step(t)
        if step.any():
            return base + self._shape(p_W, step)
        return base

    def rate(self, p_W: np.ndarray, t: float) -> np.ndarray:
        base = self.base.rate(p_W, t)
        slope = self._sum(t, lambda elapsed: cosine_slope(elapsed / RISE) / RISE)
        if slope.any():
            return base + self._shape(p_W, slope)
        return base

    def gradient(self, p_W: np.ndarray, t: float) -> np.ndarray:
        base = self.base.gradient(p_W, t)
        vertical = self._step(t)[2]
        if not vertical:
            return base
        # The vertical part fades towards the floor.
        added = np.zeros((len(p_W), 3, 3))
        floor, normals = ground_at(self.seafloor, p_W[:, :2])
        heights = (p_W[:, 2] - floor).tolist()
        slopes = np.array([cosine_slope(height / LAYER) / LAYER for height in heights])
        added[:, 2] = vertical * (slopes[:, None] * normals / normals[:, 2:])
        return base + added

    def _step(self, t: float) -> np.ndarray:
        """Return the velocity (3,) [m/s] of all steps together, far above the floor."""
        return self._sum(t, lambda elapsed: cosine_step(elapsed / RISE))

    def _sum(self, t: float, growth: Callable[[float], float]) -> np.ndarray:
        """Sum the steps (3,) at time t [s], each times its growth since the onset less that since
        its end.
        """
        parts = []
        for fault in self.faults:
            share = growth(t - fault.onset) - growth(t - fault.end)
            parts.append(share * np.array(fault.values))
        return np.asarray(np.sum(parts, axis=0))

    def _shape(self, p_W: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Return a step (n, 3) at points p_W (n, 3), less its vertical part near the floor."""
        field = np.tile(step, (len(p_W), 1))
        if step[2]:
            heights = p_W[:, 2] - ground_at(self.seafloor, p_W[:, :2])[0]
            field[:, 2] *= [cosine_step(height / LAYER) for height in heights.tolist()]
        return field


def with_steps(environment: Environment, faults: Sequence[Fault]) -> Environment:
    """Return the environment with the steps of its current that are among the faults."""
    current_faults = tuple(fault for fault in faults if fault.location.family == "current")
    if not current_faults:
        return environment
    return replace(
        environment,
        current=SteppedCurrent(
            base=environment.current, seafloor=environment.seafloor, faults=current_faults
        ),
    )
