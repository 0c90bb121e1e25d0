"""Kalman filters of the joints, one each, in NumPy: the twin of joints.c."""

from __future__ import annotations

import math

import numpy as np

from uvms_ocp.estimation.filter_memory import (
    CONSTANTS,
    JOINT_SLOTS,
    N_CHANNELS,
    ChannelIndex,
    FilterMemory,
    ProcessNoise,
)
from uvms_ocp.estimation.measurement_update import (
    free_expired,
    free_slot,
    gate_allowance,
    is_due,
    nearest_clone,
    record_outcome,
    space_clones,
    time_since_accepted,
    update_lag,
)
from uvms_ocp.estimation.vehicle_model import are_determined, response_variance
from uvms_ocp.types import Array, Mask

_FIRST = ChannelIndex.JOINT_POSITIONS
_CHANNELS = (ChannelIndex.JOINT_POSITIONS, ChannelIndex.JOINT_VELOCITIES)


def predict(m: FilterMemory) -> None:
    """Advance by the time of the tick."""
    if m.has_command[0]:
        change = m.commanded[6:] - m.commanded_rates
        m.joint_x[:, 1] += change
        m.joint_P[:, 1, 1] += response_variance(m, change)
        m.commanded_rates[:] = m.commanded[6:]
    dt, step = float(m.dt[0]), float(min(m.dt[0], CONSTANTS.longest_step))
    if dt <= 0.0:
        return
    x, P, drive = m.joint_x, m.joint_P, m.drive[ProcessNoise.JOINT] ** 2
    x[:, 0] += step * x[:, 1]
    P[:, 0, :] += step * P[:, 1, :]
    P[:, :, 0] += step * P[:, :, 1]
    P[:, 0, 0] += drive * (dt * dt * dt / 3)
    P[:, 0, 1] += drive * (dt * dt / 2)
    P[:, 1, 0] += drive * (dt * dt / 2)
    P[:, 1, 1] += drive * dt
    for i in range(2):
        lost = ~np.isfinite(x[:, i])
        unknown = lost | ~are_determined(P[:, i, i], m.joint_limit[i] ** 2)
        carried = unknown & ~lost & (i == 1) & (P[:, i, i] > 0.0) & (P[:, i, i] < np.inf)
        share = (m.joint_limit[i] / np.sqrt(P[carried, i, i]))[:, None]
        P[carried, i, :] *= share
        P[carried, :, i] *= share
        P[unknown & ~carried, i, :] = 0.0
        P[unknown & ~carried, :, i] = 0.0
        P[unknown, i, i] = m.joint_limit[i] ** 2
        x[unknown if i == 1 else lost, i] = 0.0


def fuse(m: FilterMemory) -> None:
    """Use what is fresh, then clone what late channels see now."""
    space_clones(m, _FIRST, N_CHANNELS, JOINT_SLOTS)
    for c in _CHANNELS:
        if m.fresh[c] and _is_usable(m, c):
            _ingest(m, c)
    for c in _CHANNELS:
        if m.lag[c] > 0.0:
            free_expired(m, c, m.joint_owner, m.joint_taken)
            if is_due(m, c):
                _clone(m, c)


def _is_usable(m: FilterMemory, c: ChannelIndex) -> bool:
    fits = m.last[c] < m.stamp[c] <= m.now[0] + CONSTANTS.early
    return bool(fits and (np.abs(m.joint_value[c - _FIRST]) <= CONSTANTS.largest).all())


def _ingest(m: FilterMemory, c: ChannelIndex) -> None:
    m.last[c] = m.stamp[c]
    update_lag(m, c)
    limit = CONSTANTS.unknown * m.joint_limit[0] ** 2
    unknown = (m.joint_P[:, 0, 0] > limit) & (c == _FIRST)
    if unknown.any():
        _initialise(m, unknown)
    slot, delta, near = nearest_clone(m, c, m.joint_owner, m.joint_taken)
    if unknown.all():
        m.used[c] = m.stamp[c]
    elif near:
        _gate(m, c, slot, delta, unknown)


def _initialise(m: FilterMemory, which: Mask) -> None:
    """Take the first reading for the truth."""
    c, age = _FIRST, m.now[0] - m.stamp[_FIRST]
    x, P = m.joint_x, m.joint_P
    x[which, 0] = m.joint_value[0, which] + age * x[which, 1]
    P[which, 0, :] = 0.0
    P[which, :, 0] = 0.0
    P[which, 0, 0] = m.sigma[c] ** 2 + age * age * P[which, 1, 1]
    m.joint_owner[m.joint_owner == c] = -1.0


def _gate(m: FilterMemory, c: ChannelIndex, slot: int, delta: float, done: Mask) -> None:
    k, state = c - _FIRST, c - _FIRST if slot < 0 else 2 + slot
    P, x = m.joint_P, m.joint_x
    h, rate, rate_variance = _predicted(m, k, slot)
    nu = m.joint_value[k] - h - delta * rate
    own = (
        m.sigma[c] ** 2
        + delta * delta * np.maximum(0.0, rate_variance)
        + abs(delta) * (m.drive[ProcessNoise.JOINT] ** 2 if k else 0.0)
    )
    S = P[:, state, state] + own
    squared = nu * nu / S
    granted = _allowance(m, c, rate if k == 0 else h)
    inside = nu * nu <= m.gate[c] * (S + granted)
    yields = ~inside & ~done & _are_consistent(m, c, nu, S + own + granted, inside | done)
    _relax(m, k, state, yields, nu)
    _inflate_surprised(m, c, inside & ~done & (squared > m.gate[c]), nu)
    record_outcome(m, c, float(squared[~done].sum()), int((~done).sum()), believed=bool((inside | yields | done).all()))
    used = (inside | yields) & ~done
    gain = P[:, :, state] / (P[:, state, state] + own)[:, None]
    change = np.where(used[:, None], gain * nu[:, None], 0.0)
    P -= np.where(used[:, None, None], gain[:, :, None] * P[:, state, None, :], 0.0)
    x += change[:, :2]
    m.joint_h += change[:, 2:]


def _allowance(m: FilterMemory, c: ChannelIndex, rate: Array) -> Array:
    """(n_joints,) variance that the gate grants: beside what accelerations can do, joints with a rate (n_joints,) may stop."""
    stop = np.abs(rate) * (time_since_accepted(m, c) if c == _FIRST else 1.0)
    return np.asarray((math.sqrt(gate_allowance(m, c)) + stop / 5.0) ** 2)


def _inflate_surprised(m: FilterMemory, c: ChannelIndex, which: Mask, nu: Array) -> None:
    """Joints that have done what they can and the process model did not expect."""
    k = c - _FIRST
    _inflate_own(m, k, which, nu**2)
    if k == 0:
        m.joint_P[which, 1, 1] += (nu[which] / time_since_accepted(m, c)) ** 2


def _inflate_own(m: FilterMemory, k: int, which: Mask, variance: Array) -> None:
    """An error of that variance of what the k-th channel sees of some joints, now and in its clones."""
    rows = np.concatenate([[k], 2 + np.flatnonzero(m.joint_owner == _FIRST + k)])
    for j in np.flatnonzero(which):
        m.joint_P[np.ix_([j], rows, rows)] += variance[j]


def _predicted(m: FilterMemory, k: int, slot: int) -> tuple[Array, Array, Array]:
    """Return the predicted measurement of channel k at the clone, -1 for now, its rate and the variance of that."""
    if slot >= 0:
        return m.joint_h[:, slot], m.joint_rate[:, slot], m.joint_rate_variance[:, slot]
    if k:
        return m.joint_x[:, 1], np.zeros(m.n_joints), np.zeros(m.n_joints)
    return m.joint_x[:, 0], m.joint_x[:, 1], m.joint_P[:, 1, 1]


def _are_consistent(m: FilterMemory, c: ChannelIndex, nu: Array, S: Array, inside: Mask) -> Mask:
    """(n_joints,) whether readings outside the gate agree with those before them, for long enough."""
    k = c - _FIRST
    since, before = m.joint_since[k], m.joint_refused[k]
    agrees = np.isfinite(since) & ((nu - before) ** 2 <= m.gate[c] * S)
    since[:] = np.where(inside, math.nan, np.where(agrees, since, m.stamp[c]))
    before[:] = np.where(inside, before, nu)
    return np.asarray(agrees & (m.stamp[c] - since >= m.recovery[c] - CONSTANTS.early))


def _relax(m: FilterMemory, k: int, state: int, which: Mask, nu: Array) -> None:
    """The state, and its clones with it, is wrong by an unknown amount."""
    if which.any():
        m.joint_owner[(m.joint_owner >= 0) & (m.joint_owner != _FIRST + k)] = -1.0
        m.joint_since[k, which] = math.nan
    _inflate_own(m, k, which, CONSTANTS.gate_relaxation * nu**2)


def _clone(m: FilterMemory, c: ChannelIndex) -> None:
    slot, k = free_slot(m.joint_owner), c - _FIRST
    if slot < 0:
        return
    h, rate, rate_variance = (values.copy() for values in _predicted(m, k, -1))
    m.joint_owner[slot], m.joint_taken[slot] = c, m.now[0]
    m.joint_h[:, slot], m.joint_rate[:, slot], m.joint_rate_variance[:, slot] = h, rate, rate_variance
    at, P = 2 + slot, m.joint_P
    P[:, at, :] = P[:, k, :]
    P[:, :, at] = P[:, :, k]
    P[:, at, at] = P[:, k, k]
