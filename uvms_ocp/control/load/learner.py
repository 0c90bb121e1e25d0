"""What the tool carries: learnt tick by tick, told for the record, and carried along with the arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from uvms_ocp.control.load.learning import LoadLearning
from uvms_ocp.control.load.load_filter import CURRENT, MASS, WEIGHT, LoadFilter, Look
from uvms_ocp.control.load.load_forces import COLUMNS, Follower, response_function, tool_function
from uvms_ocp.functions.buffered import BufferedFunction
from uvms_ocp.functions.compile import compile_function
from uvms_ocp.model.symbolic.dynamics import SymbolicDynamics

_CERTAIN = 3.0  # standard errors that a weight must have to be carried along


@dataclass(frozen=True, kw_only=True, slots=True)
class LoadEstimate:
    """Of a point load at the tool."""

    weight: float
    """[N] net weight in water, downwards."""
    weight_error: float
    """[N] its standard error."""
    mass: float
    """[kg] NaN while it is undetermined."""
    mass_error: float
    """[kg] its standard error."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadFunctions:
    """What a learner evaluates, for one robot and observer; see `load_functions`."""

    tool: ca.Function
    """As `tool_function` has it."""
    response: ca.Function
    """As `response_function` has it."""


def load_functions(body: SymbolicDynamics, law: Follower) -> LoadFunctions:
    """Compiled where there is a compiler."""
    return LoadFunctions(compile_function(tool_function(body)), compile_function(response_function(body, law)))


class LoadLearner:
    """Learns from an observer's estimate. Holds what it knows: build one per run.

    Around each tick of the observer it is called twice: `carry` before, `learn` after it.
    """

    def __init__(
        self, functions: LoadFunctions, settings: LoadLearning, *, limit: np.ndarray, bandwidth: np.ndarray, dt: float
    ) -> None:
        """limit (n_v,) [N, N m] and bandwidth (n_v,) [rad/s] of the observer, dt [s] its period."""
        self._tool, self._response = BufferedFunction(functions.tool), BufferedFunction(functions.response)
        self._every, self._settling = max(1, round(settings.period / dt)), round(settings.settling / dt)
        self._settings, self._dt, n = settings, dt, len(limit)
        self._limit = limit
        # Looks are whole ticks apart.
        self.filter = LoadFilter(replace(settings, period=self._every * dt), limit, bandwidth)
        """What is known."""
        self._estimate, self._innovation = np.zeros((n, COLUMNS)), np.zeros((n, COLUMNS))
        self._weight, self._velocity = np.zeros(n), np.zeros(3)
        self._acceleration = np.zeros(3)
        self._ticks = 0
        self._free = np.ones(n, dtype=bool)

    @property
    def load(self) -> LoadEstimate:
        """What is carried, as far as it is known."""
        mass, error = float(self.filter.x[MASS]), self.filter.error(MASS)
        known = error <= max(self._settings.mass_error, self._settings.mass_share * abs(mass))
        return LoadEstimate(
            weight=float(self.filter.x[WEIGHT]),
            weight_error=self.filter.error(WEIGHT),
            mass=mass if known else float("nan"),
            mass_error=error,
        )

    def leave(self, jammed: Sequence[int]) -> None:
        """Axes [-] of v that do not move, and tell nothing."""
        self._free[list(jammed)] = False

    def carry(self, q: np.ndarray, v: np.ndarray, estimate: np.ndarray) -> None:
        """Turn the learnt weight in the observer's estimate (n_v,) [N, N m], which is changed, with the arm.

        q (n_q,) [m, rad], v (n_v,) [m/s, rad/s], about to be observed.
        """
        before, was = self._weight, self._velocity
        self._weight, self._velocity = self._tool(q, v)
        # What is no number would never be forgotten.
        follows = self._ticks > 0 and bool(np.isfinite(self._velocity - was).all())
        self._acceleration = (self._velocity - was) / self._dt if follows else np.zeros(3)
        if follows and self._settings.feed_forward and self._is_certain():
            moved = np.where(self._free, self.filter.x[WEIGHT] * (self._weight - before), 0.0)
            estimate += moved
            self._estimate[:, 0] += moved

    def learn(self, q: np.ndarray, v: np.ndarray, estimate: np.ndarray, share: np.ndarray, sure: bool) -> None:
        """From the observer's estimate (n_v,) [N, N m] of this tick, at q (n_q,) [m, rad] and v (n_v,) [m/s, rad/s].

        share (n_v,) [-] of its bandwidth; sure: whether it observes, at velocities that are to be trusted. An estimate at
        its limit tells nothing either.
        """
        if not (sure and (np.abs(estimate) < self._limit).all()):
            self._ticks, self._innovation[:] = 0, 0.0
            return
        current = self.filter.x[CURRENT]
        given = (q, v, self._acceleration, current, share, self._estimate, self._innovation)
        self._estimate, self._innovation = self._response(*given)
        self._ticks += 1
        if self._ticks > self._settling and self._ticks % self._every == 0:
            self.filter.take(self._look(estimate))

    def telemetry(self) -> dict[str, float]:
        """For the record [N, N, kg, kg]."""
        load = self.load
        return {f"load_{name}": getattr(load, name) for name in load.__slots__}

    def _is_certain(self) -> bool:
        return abs(float(self.filter.x[WEIGHT])) > _CERTAIN * self.filter.error(WEIGHT)

    def _look(self, estimate: np.ndarray) -> Look:
        turned, weight, mass, drag, *slopes = self._estimate.T
        return Look(
            disturbance=estimate - turned,
            weight=weight,
            mass=mass,
            drag=drag,
            slopes=np.column_stack(slopes),
            velocity=self._velocity,
            known=self._free,
        )
