"""Scan quantities along a motion, inside its steps too: at evenly spaced samples, and at more of
them in steps in which a quantity comes near the ends of its range.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pinocchio as pin

from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.range_check import Peak, RangeCheck, RangeKind
from uvms_ocp.ocp.terms import Term
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.robot import Robot
from uvms_ocp.types import Array, Indices

FINE = 2e-4
"""[unit of the quantity] Largest excess that may hide between samples; steps in which more could
hide are sampled more closely.
"""
_LOOKS_PER_STEP = 4  # least intervals between samples in a step, to begin with
_LOOKS_OF_ALL_STEPS = 128  # least intervals in all steps together, to begin with
_CLOSER = (1, 4, 16)  # factors on that number, tried in order

NO_PEAK = Peak(amount=0.0, time=0.0, quantity="")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Samples:
    """States at n_s moments of each of n steps, from its beginning to its end."""

    steps: Indices
    """(n,) indices of the steps."""
    t: Array
    """(n, n_s) [s] since the first node."""
    q: Array
    """(n, n_s, n_q) [m, rad] configurations."""
    v: Array
    """(n, n_s, n_v) [m/s, rad/s] velocities."""

    @property
    def flat(self) -> tuple[Indices, Array, Array]:
        """Steps (n n_s,), q (n n_s, n_q) and v (n n_s, n_v), a row for each sample."""
        steps = np.repeat(self.steps, self.t.shape[1])
        return steps, self.q.reshape(len(steps), -1), self.v.reshape(len(steps), -1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """A trajectory of a problem, with its samples inside steps."""

    problem: OcpProblem
    """Problem whose ranges the motion is to keep."""
    trajectory: Trajectory
    """States at nodes and accelerations of steps."""
    t0: float
    """[s] time of the first node."""
    _samples: dict[tuple[int, ...], Samples] = field(default_factory=dict)

    @property
    def robot(self) -> Robot:
        """Robot that moves."""
        return self.problem.robot

    @property
    def N(self) -> int:
        """Number of steps."""
        return len(self.trajectory.a)

    @cached_property
    def h(self) -> Array:
        """(N,) [s] lengths of the steps."""
        return np.diff(self.trajectory.t)

    @cached_property
    def leaving(self) -> Array:
        """(N, n_v) [m/s, rad/s] velocities with which the motion leaves nodes, see
        `Trajectory.leaving`.
        """
        path = self.trajectory
        model = self.robot.model
        return np.array([path.leaving(model, k) for k in range(self.N)])

    @property
    def looks(self) -> int:
        """Number of intervals between samples of a step, to begin with; even, so that the middle of
        the step is among the samples.
        """
        even_share = 2 * (_LOOKS_OF_ALL_STEPS // (2 * self.N))
        return max(_LOOKS_PER_STEP, even_share)

    def reference_times(self, t: Array) -> Array:
        """Return the times [s] that references of terms are asked for: nominal, where durations are
        free.
        """
        return self.t0 + np.interp(t, self.trajectory.t, self.problem.nominal_times())

    def samples(self, steps: Indices, looks: int) -> Samples:
        """Return the states at both ends of each step and at the looks - 1 evenly spaced moments
        between them.
        """
        key = (looks, *steps.tolist())
        if key not in self._samples:
            s = np.arange(looks + 1) / looks * self.h[steps, None]
            self._samples[key] = self._states(steps, s)
        return self._samples[key]

    def _states(self, steps: Indices, s: Array) -> Samples:
        """Return the states at times s (n, n_s) [s] since the beginning of the steps."""
        path = self.trajectory
        model = self.robot.model
        moment = s[:, :, None]
        a = path.a[steps, None]
        ways = moment * self.leaving[steps, None] + moment**2 / 2 * a
        q = []
        for k, ways_of_step in zip(steps.tolist(), ways, strict=True):
            q += [pin.integrate(model, path.q[k], way) for way in ways_of_step]
        return Samples(
            steps=steps,
            t=path.t[steps, None] + s,
            q=np.array(q).reshape(*s.shape, self.robot.n_q),
            v=path.v[steps, None] + moment * a,
        )


Rows = Callable[[Samples], Array]
"""Quantities (n, n_s, m) of samples."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class QuantityRange:
    """Names of m quantities, and the ends of the ranges that they are to stay in."""

    kind: RangeKind
    """What sets the range."""
    name: str
    """Name of all quantities together, such as that of a term."""
    unit: str
    """Unit of all quantities."""
    quantities: tuple[str, ...]
    """Name of each quantity."""
    lower: Array
    """(m,) lower ends."""
    upper: Array
    """(m,) upper ends."""
    term: Term | None = None
    """Term whose rows the quantities are; `None` for limits of the robot."""

    def beyond(self, values: Array) -> tuple[Array, Array]:
        """Return by how much values (..., m) are below and above their ranges, negative inside and
        infinite for NaN.
        """
        is_nan = np.isnan(values)
        below = np.where(is_nan, np.inf, self.lower - values)
        above = np.where(is_nan, np.inf, values - self.upper)
        return below, above

    def excess(self, values: Array) -> Array:
        """Return by how much values (..., m) are outside their ranges, 0 inside."""
        below, above = self.beyond(values)
        return np.asarray(np.maximum(np.maximum(below, above), 0.0))

    def peak(self, amounts: Array, times: Array) -> Peak:
        """Return the largest of amounts (..., m), at times (...) or (..., m) [s]."""
        if not amounts.size or not amounts.max() > 0.0:
            return NO_PEAK
        index = np.unravel_index(int(amounts.argmax()), amounts.shape)
        if times.ndim < amounts.ndim:
            times = times[..., None]
        times = np.broadcast_to(times, amounts.shape)
        quantity = self.quantities[int(index[-1])]
        return Peak(amount=float(amounts[index]), time=float(times[index]), quantity=quantity)

    def checked(
        self,
        *,
        nodes: Peak,
        below: Array,
        above: Array,
        times: Array,
        slack: Array | None = None,
        resolution: float = 0.0,
    ) -> RangeCheck:
        """Return the check of quantities with these amounts (N, m) inside the steps."""
        below = np.maximum(below, 0.0)
        above = np.maximum(above, 0.0)
        if slack is None:
            slack = np.full((len(below) + 1, len(self.lower)), np.inf)
        return RangeCheck(
            kind=self.kind,
            term=self.term,
            name=self.name,
            unit=self.unit,
            quantities=self.quantities,
            at_nodes=nodes,
            between=self.peak(np.maximum(below, above), times),
            resolution=resolution,
            below=below,
            above=above,
            times=times,
            slack=slack,
            lower=self.lower,
            upper=self.upper,
        )

    def inside(self, motion: Motion, nodes: Indices, values: Array) -> Array:
        """Return how far values (n, m) at nodes (n,) are inside their ranges, (N + 1, m); infinite
        at other nodes.
        """
        below, above = self.beyond(values)
        slack = np.full((motion.N + 1, len(self.lower)), np.inf)
        slack[nodes] = -np.maximum(below, above)
        return slack

    def of_nodes(self, motion: Motion, values: Array, times: Array) -> RangeCheck:
        """Check values (n, m) at times (n,) [s], with nothing between them."""
        zeros = np.zeros((motion.N, len(self.quantities)))
        nodes = self.peak(self.excess(values), times)
        return self.checked(nodes=nodes, below=zeros, above=zeros, times=zeros)


def scanned(
    motion: Motion,
    scope: QuantityRange,
    rows: Rows,
    nodes: Peak,
    steps: Indices,
    *,
    inputs: bool,
    slack: Array | None = None,
) -> RangeCheck:
    """Check quantities inside steps, at more samples where they come near the ends of their range.

    nodes: their peak at nodes. inputs: the quantities are inputs, which jump between steps, so that
    samples at both ends belong to the step too.
    """
    m = len(scope.quantities)
    below = np.zeros((motion.N, m))
    above = np.zeros((motion.N, m))
    times = np.zeros((motion.N, m))
    unseen = np.zeros((motion.N, m))
    if inputs:
        inner = slice(0, None)
        allowed_below = allowed_above = np.zeros(m)  # no given start excuses them
    else:
        inner = slice(1, -1)
        begin = motion.samples(np.array([0]), motion.looks)
        allowed_below, allowed_above = given_by_start(motion, scope, rows(begin)[0, 0])
    for times_as_many in _CLOSER:
        samples = motion.samples(steps, times_as_many * motion.looks)
        values = rows(samples)
        under, over = scope.beyond(values)
        is_first = (steps == 0)[:, None, None]
        under = np.where(is_first, under - allowed_below, under)
        over = np.where(is_first, over - allowed_above, over)
        amounts = np.maximum(under, over)
        moment = amounts[:, inner].argmax(axis=1)
        below[steps] = under[:, inner].max(axis=1)
        above[steps] = over[:, inner].max(axis=1)
        times[steps] = np.take_along_axis(samples.t[:, inner, None], moment[:, None], axis=1)[:, 0]
        seen_excess = np.maximum(np.maximum(below[steps], above[steps]), 0.0)
        possible = amounts.max(axis=1) + _bend(values) / 2
        with np.errstate(invalid="ignore"):  # infinite less infinite
            unseen[steps] = np.maximum(possible - seen_excess, 0.0)
        steps = steps[(unseen[steps] > FINE).any(axis=1)]
        if not len(steps):
            break
    return scope.checked(
        nodes=nodes,
        below=below,
        above=above,
        times=times,
        slack=slack,
        resolution=float(np.nan_to_num(unseen, nan=np.inf).max(initial=0.0)),
    )


def _bend(values: Array) -> Array:
    """Return the largest second difference (n, m) of values (n, n_s, m): half of it bounds how far
    they rise above their samples.
    """
    with np.errstate(invalid="ignore"):
        return np.abs(np.diff(values, n=2, axis=1)).max(axis=1)


def given_by_start(motion: Motion, scope: QuantityRange, values: Array) -> tuple[Array, Array]:
    """Return by how much values (m,) at the start are below and above their ranges, where the start
    is given; 0 where it is free.
    """
    is_given = float(motion.problem.fixed_start)
    below, above = scope.beyond(values)
    return is_given * finite_excess(below), is_given * finite_excess(above)


def finite_excess(amounts: Array) -> Array:
    """Return the amounts that are numbers and positive; 0 for others."""
    return np.where(np.isfinite(amounts) & (amounts > 0.0), amounts, 0.0)
