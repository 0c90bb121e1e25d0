"""Look at quantities along a motion, inside its steps too: densely, and more closely where they
come near their range.
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
"""[unit of the quantity] By how much more a range may be left unseen before a step is looked at
more closely.
"""
_LOOKS = 4  # at each step, at least, to begin with
_ALL_LOOKS = 128  # at all steps together, at least, to begin with
_CLOSER = (1, 4, 16)  # times as many looks, where the range is near

NO_PEAK = Peak(amount=0.0, time=0.0, quantity="")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Samples:
    """States at n_s moments of each of n steps, from its beginning to its end."""

    steps: Indices
    """(n,)"""
    t: Array
    """(n, n_s) [s] since the first node."""
    q: Array
    """(n, n_s, n_q) [m, rad]"""
    v: Array
    """(n, n_s, n_v) [m/s, rad/s]"""

    @property
    def flat(self) -> tuple[Indices, Array, Array]:
        """Steps (n n_s,), q (n n_s, n_q) and v (n n_s, n_v), a row for each sample."""
        steps = np.repeat(self.steps, self.t.shape[1])
        return steps, self.q.reshape(len(steps), -1), self.v.reshape(len(steps), -1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """A trajectory, with what its problem says of it."""

    problem: OcpProblem
    trajectory: Trajectory
    t0: float
    _kept: dict[tuple[int, ...], Samples] = field(default_factory=dict)

    @property
    def robot(self) -> Robot:
        return self.problem.robot

    @property
    def N(self) -> int:
        return len(self.trajectory.a)

    @cached_property
    def h(self) -> Array:
        """(N,) [s]"""
        return np.diff(self.trajectory.t)

    @cached_property
    def leaving(self) -> Array:
        """(N, n_v) [m/s, rad/s] see `Trajectory.leaving`."""
        path = self.trajectory
        model = self.robot.model
        return np.array([path.leaving(model, k) for k in range(self.N)])

    @property
    def looks(self) -> int:
        """At each step to begin with; even, so that the middle is among them."""
        return max(_LOOKS, 2 * (_ALL_LOOKS // (2 * self.N)))

    def reference_times(self, t: Array) -> Array:
        """Times [s] that references of terms are asked for: nominal, where durations are free."""
        return self.t0 + np.interp(t, self.trajectory.t, self.problem.nominal_times())

    def samples(self, steps: Indices, looks: int) -> Samples:
        """Both ends of each step, and looks - 1 moments between them."""
        key = (looks, *steps.tolist())
        if key not in self._kept:
            s = np.arange(looks + 1) / looks * self.h[steps, None]
            self._kept[key] = self._states(steps, s)
        return self._kept[key]

    def _states(self, steps: Indices, s: Array) -> Samples:
        """At times s (n, n_s) [s] since the beginning of the steps."""
        path = self.trajectory
        model = self.robot.model
        moment = s[:, :, None]
        a = path.a[steps, None]
        ways = moment * self.leaving[steps, None] + moment**2 / 2 * a
        q = [
            [pin.integrate(model, path.q[k], way) for way in own]
            for k, own in zip(steps.tolist(), ways, strict=True)
        ]
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
    """Names and ends of quantities."""

    kind: RangeKind
    name: str
    unit: str
    quantities: tuple[str, ...]
    lower: Array
    """(m,)"""
    upper: Array
    """(m,)"""
    term: Term | None = None

    def beyond(self, values: Array) -> tuple[Array, Array]:
        """Amounts (..., m) below and above at values (..., m), negative inside; no number is
        infinitely outside.
        """
        wrong = np.isnan(values)
        below = np.where(wrong, np.inf, self.lower - values)
        above = np.where(wrong, np.inf, values - self.upper)
        return below, above

    def excess(self, values: Array) -> Array:
        """(..., m) by which values (..., m) are outside, 0 inside."""
        return np.asarray(np.maximum(np.maximum(*self.beyond(values)), 0.0))

    def peak(self, amounts: Array, times: Array) -> Peak:
        """The largest of amounts (..., m), at times (...) or (..., m) [s]."""
        if not amounts.size or not amounts.max() > 0.0:
            return NO_PEAK
        at = np.unravel_index(int(amounts.argmax()), amounts.shape)
        when = np.broadcast_to(
            times[..., None] if times.ndim < amounts.ndim else times, amounts.shape
        )
        return Peak(
            amount=float(amounts[at]), time=float(when[at]), quantity=self.quantities[int(at[-1])]
        )

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
        """Check of quantities with these amounts (N, m) inside the steps."""
        below = np.maximum(below, 0.0)
        above = np.maximum(above, 0.0)
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
            slack=np.full((len(below) + 1, len(self.lower)), np.inf) if slack is None else slack,
            lower=self.lower,
            upper=self.upper,
        )

    def inside(self, motion: Motion, nodes: Indices, values: Array) -> Array:
        """(N + 1, m) How far values (n, m) at nodes (n,) are inside; infinite at others."""
        slack = np.full((motion.N + 1, len(self.lower)), np.inf)
        slack[nodes] = -np.maximum(*self.beyond(values))
        return slack

    def of_nodes(self, motion: Motion, values: Array, times: Array) -> RangeCheck:
        """Check values (n, m) at times (n,) [s], with nothing between them."""
        none = np.zeros((motion.N, len(self.quantities)))
        nodes = self.peak(self.excess(values), times)
        return self.checked(nodes=nodes, below=none, above=none, times=none)


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
    """Look at quantities inside steps, more closely where they come near their range.

    inputs: they jump where a step begins, so that its end is inside as well. nodes: the peak there.
    """
    m = len(scope.quantities)
    below = np.zeros((motion.N, m))
    above = np.zeros((motion.N, m))
    times = np.zeros((motion.N, m))
    unseen = np.zeros((motion.N, m))
    if inputs:
        inner = slice(0, None)
    else:
        inner = slice(1, -1)
    begin = motion.samples(np.array([0]), motion.looks)
    allowed = given_by_start(motion, scope, rows(begin)[0, 0])
    for times_as_many in _CLOSER:
        samples = motion.samples(steps, times_as_many * motion.looks)
        values = rows(samples)
        under, over = scope.beyond(values)
        first = (steps == 0)[:, None, None]
        under = np.where(first, under - allowed[0], under)
        over = np.where(first, over - allowed[1], over)
        amounts = np.maximum(under, over)
        when = amounts[:, inner].argmax(axis=1)
        below[steps] = under[:, inner].max(axis=1)
        above[steps] = over[:, inner].max(axis=1)
        times[steps] = np.take_along_axis(samples.t[:, inner, None], when[:, None], axis=1)[:, 0]
        found = np.maximum(np.maximum(below[steps], above[steps]), 0.0)
        possible = amounts.max(axis=1) + _bend(values) / 2
        with np.errstate(invalid="ignore"):  # what is no number anywhere
            unseen[steps] = np.maximum(possible - found, 0.0)
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
    """(n, m) Largest second difference of values (n, n_s, m), by which they may rise between two of
    them.
    """
    with np.errstate(invalid="ignore"):
        return np.abs(np.diff(values, n=2, axis=1)).max(axis=1)


def given_by_start(motion: Motion, scope: QuantityRange, values: Array) -> tuple[Array, Array]:
    """Amounts (m,) below and above that a start with these values (m,) has by itself, where it is
    given.
    """
    given = float(motion.problem.fixed_start)
    below, above = scope.beyond(values)
    return given * finite_excess(below), given * finite_excess(above)


def finite_excess(amounts: Array) -> Array:
    """The amounts that are numbers and positive; 0 for others."""
    return np.where(np.isfinite(amounts) & (amounts > 0.0), amounts, 0.0)
