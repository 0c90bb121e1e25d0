"""Net weight and mass of the load of each tool, learnt from disturbances by an extended Kalman
filter.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.types import Positive, Range

LOAD_FRAME = "tool"
"""Frame that carries the load of a robot with one tool."""

WEIGHT = 0
MASS = 1
"""Indices of the weight and the mass at the first tool in the state; the next two are of the second
tool, and so on.
"""
_CURRENT_WALK = (
    0.01  # [m/s] by which the current may change within a second: the sea's, for any robot
)
LASTING_FORCE = 0.005
"""Force that the model lacks for long on every axis, share of the most that thrusters or motors
give there.
"""
_LASTING_TIME = 60.0  # [s] after which that force has become another
_UNSTEADY = 0.001  # force, the same share, below which the disturbance is noise at least
# [s] for which the disturbance is wrong in the same way: what the model lacks of a motion lasts
# longer than noise
_ALIKE = 2.0
LEAST_ACCELERATION = 0.05
"""[m/s2] of the tool, below which nothing is learnt of the mass: noise of the velocity looks the
same. Accelerations of robots that swim alike are alike, whatever their size.
"""
# standard deviations, root mean square of all axes, beyond which another load or current is there
_SURPRISE = 4.0
_MEMORY = 10.0  # [s] over which the size of the noise is taken
_OUTLIER = 3.0  # times its size, beyond which a change of the noise counts as that
# times that noise is taken for more at first, and [s] after which it is by e less
_FIRST_NOISE = 300.0
_COOLING = 1.0
_PATIENCE = 3  # looks at a surprise, one after the other, that are one
_GRAVITY = 9.81  # [m/s2]
_NO_FORCE = 1e-9  # share of the largest limit: rounding on an axis that no thruster acts on
# noise of an observer is alike for so many times 1 / bandwidth, by the integral of its correlation
_COLOUR = 4.0


@checked_dataclass()
class LoadLearning:
    """Tuning of `LoadLearner`. Raises `InvalidInput` for a number that is not finite and > 0, and a
    share outside 0 to 1.
    """

    feed_forward: bool = True
    """The learnt weight follows the arm's posture at once, and not as fast as the observer."""
    period: Positive = 0.1
    """[s] between two looks at the disturbance."""
    settling: Positive = 1.5
    """[s] after a start, or after a velocity that was not to be trusted, that are not looked at."""
    weight: Positive | None = None
    """[N] standard deviation of the net weight before anything is known of it; default: the weight
    that thrusters lift, or of a robot without them its own.
    """
    mass: Positive | None = None
    """[kg] standard deviation of the mass before anything is known of it; default: the mass of that
    weight in air.
    """
    current: Positive = 0.5
    """[m/s] standard deviation of the current in each direction before anything is known of it: the
    sea's, whatever the robot.
    """
    drag: Annotated[float, Range(0.0, 1.0)] = 0.1
    """Share of its slope that the drag of a moving tool's velocity may be wrong by."""
    scale: Annotated[float, Range(0.0, 1.0)] = 0.03
    """Relative accuracy of the known forces of thrusters and motors: standard errors of weight and
    mass are no smaller share.
    """


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LoadSample:
    """A disturbance that was found, and what a load at each tool or a current would make of it."""

    disturbance: np.ndarray
    """(n_v,) [N, N m] disturbance that the observer found."""
    weight: np.ndarray
    """(n_v, n_tools) [N, N m] disturbance that 1 N of net weight makes."""
    mass: np.ndarray
    """(n_v, n_tools) [N, N m] disturbance that 1 kg makes."""
    drag: np.ndarray
    """(n_v,) [N, N m] constant part of a current's disturbance, to which `slopes` times the current
    is added.
    """
    slopes: np.ndarray
    """(n_v, 3) [N s/m, N s] slopes of the disturbance with the current."""
    velocity: np.ndarray
    """(3, n_tools) [m/s] velocities of the tools in W."""
    usable: np.ndarray
    """(n_v,) True for axes that tell anything of the load."""


class LoadFilter:
    """Kalman filter of the loads and the current. Holds its estimate: build one per run."""

    def __init__(
        self,
        settings: LoadLearning,
        limit: np.ndarray,
        bandwidth: np.ndarray,
        n_tools: int = 1,
        *,
        heaviest: float,
    ) -> None:
        """limit (n_v,) [N, N m]: of thrusters and motors; bandwidth (n_v,) [rad/s]: of the
        observer; heaviest [N]: weight of a load that the robot may carry.

        Raises `InvalidInput` for a limit that is none, or nothing.
        """
        n = require_limits(limit)
        # Looks whose noise has little in common lie as far apart.
        apart = max(1, round(_COLOUR / (float(bandwidth.min()) * settings.period)))
        self._settings = settings
        self._last = deque[np.ndarray](maxlen=apart)
        lasting = (LASTING_FORCE * limit) ** 2
        self.loads = slice(2 * n_tools)
        self.current = slice(2 * n_tools, 2 * n_tools + 3)
        """Slices of the state: weight and mass by turns, and the current."""
        weight = settings.weight or heaviest
        mass = settings.mass or heaviest / _GRAVITY
        prior = [*n_tools * [weight**2, mass**2], *3 * [settings.current**2]]
        self._prior = np.concatenate([prior, lasting])
        self._least = (_UNSTEADY * limit) ** 2
        self._variance = self._least.copy()
        self._colour = np.maximum(_COLOUR / bandwidth, _ALIKE) / settings.period
        self._surprised = 0
        self._waits = 0
        self._heat = _FIRST_NOISE
        self.x = np.zeros(self.current.stop + n)
        """(2 n_tools + 3 + n_v,) net weight [N], mass [kg] by turns, current (3,) [m/s] in W,
        lasting force (n_v,) [N, N m].
        """
        self.P = np.diag(self._prior)
        """Covariance of `x`, in the products of its units."""

    def error(self, place: int) -> float:
        """Return the standard error of an entry of `x`, in its unit, with that of the forces'
        scale.
        """
        return math.hypot(math.sqrt(self.P[place, place]), self._settings.scale * self.x[place])

    def update(self, look: LoadSample) -> None:
        """Update the estimate by a sample, a period after the last."""
        self._forget()
        inertial_force = np.linalg.norm(look.mass, axis=0)
        weight_force = np.linalg.norm(look.weight, axis=0)
        accelerates = inertial_force > LEAST_ACCELERATION * weight_force
        mass = np.where(accelerates, look.mass, 0.0)
        loads = np.stack([look.weight, mass], axis=2).reshape(len(mass), -1)
        H = np.hstack([loads, look.slopes, np.eye(len(mass))])
        missed = look.disturbance - H @ self.x - look.drag
        self._listen(missed, look.usable)
        variance = np.einsum("ij,jk,ik->i", H, self.P, H) + self._variance
        usable = look.usable
        # What is known cannot be true any more: another load, or another current.
        surprises = usable.any() and np.mean(missed[usable] ** 2 / variance[usable]) > _SURPRISE**2
        if surprises:
            self._surprised += 1
        else:
            self._surprised = 0
        if self._surprised >= _PATIENCE:
            self._begin_anew()
        if self._waits:
            self._waits -= 1
            return
        # Looks count little until the drag is that of the current there is: its slopes at others
        # mislead for good. Drag that is not as the model has it, and masses that are not looked at,
        # are noise too.
        self._heat *= math.exp(-self._settings.period / _COOLING)
        drag = np.abs(look.slopes @ look.velocity).max(axis=1)
        variance = self._variance + (self._settings.drag * drag) ** 2
        squares = (np.diag(self.P) + self.x**2)[self.loads][MASS::2]
        noise = (1.0 + self._heat) * self._colour * variance + (look.mass - mass) ** 2 @ squares
        self._correct(H[look.usable], missed[look.usable], noise[look.usable])

    def _forget(self) -> None:
        """Propagate by a period: the current walks, and the force that the model lacks is
        forgotten.
        """
        period = self._settings.period
        keep = np.ones(len(self.x))
        keep[self.current.stop :] = math.exp(-period / _LASTING_TIME)
        self.x *= keep
        self.P = keep[:, None] * self.P * keep
        self.P[np.diag_indices_from(self.P)] += (1.0 - keep**2) * self._prior
        self.P[self.current, self.current] += np.eye(3) * _CURRENT_WALK**2 * period

    def _listen(self, missed: np.ndarray, usable: np.ndarray) -> None:
        """Learn the noise from how the residual changes within the memory of the observer."""
        if len(self._last) == self._last.maxlen:
            square = np.minimum((missed - self._last[0]) ** 2 / 2, _OUTLIER**2 * self._variance)
            gain = np.where(usable, self._settings.period / _MEMORY, 0.0)
            self._variance = np.maximum(
                self._variance + gain * (square - self._variance), self._least
            )
        self._last.append(missed)

    def _begin_anew(self) -> None:
        """Forget all that was learnt, and wait until the observer has settled."""
        self._surprised = 0
        self._heat = _FIRST_NOISE
        # What was missed was missed by what is forgotten now: at least that look is left out.
        self._waits = max(1, round(self._settings.settling / self._settings.period))
        self.x = np.zeros_like(self.x)
        self.P = np.diag(self._prior)
        self._last.clear()

    def _correct(self, H: np.ndarray, missed: np.ndarray, noise: np.ndarray) -> None:
        S = H @ self.P @ H.T + np.diag(noise)
        K = np.linalg.solve(S, H @ self.P).T
        self.x = self.x + K @ missed
        remaining = np.eye(len(self.x)) - K @ H
        self.P = remaining @ self.P @ remaining.T + K @ np.diag(noise) @ K.T


def require_limits(limit: np.ndarray) -> int:
    """Return the number of axes of a limit (n_v,) [N, N m]. Raises `InvalidInput` where one bears
    no force, or any.
    """
    no_force = _NO_FORCE * limit[np.isfinite(limit)].max(initial=0.0)
    wrong = np.flatnonzero(~((limit > no_force) & (limit < np.inf)))
    if len(wrong):
        problem = f"axes {wrong.tolist()} of {len(limit)} bear no force, or have no limit of it"
        raise InvalidInput(
            f"{problem}; a load is learnt in shares of it: give joints an effort, or load=None"
        )
    return len(limit)
