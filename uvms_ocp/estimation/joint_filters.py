"""Kalman filters of the joints, one each, as kernels."""

from __future__ import annotations

import math

from uvms_ocp.codegen.kernel_layout import zeros
from uvms_ocp.estimation import (
    filter_memory as filtering,
    measurement_update as update,
    vehicle_model,
)
from uvms_ocp.estimation.filter_memory import JOINT_SLOTS, JOINT_STATES, FilterMemory

_FIRST = int(filtering.ChannelIndex.JOINT_POSITIONS)


def predict_joints(m: FilterMemory) -> None:
    """Advance by the time of the tick."""
    dt = m.dt
    drive = m.drive[filtering.ProcessNoise.JOINT] * m.drive[filtering.ProcessNoise.JOINT]
    h = min(filtering.LONGEST_STEP, dt)
    n = _active(m)
    for j in range(m.n_joints):
        x = m.joint_x[j]
        if m.has_command:
            change = m.commanded[6 + j] - m.commanded_rates[j]
            x[1] += change
            m.joint_P[j][1][1] += vehicle_model.response_variance(m, change)
            m.commanded_rates[j] = m.commanded[6 + j]
        if not dt > 0.0:
            continue
        x[0] += h * x[1]
        for k in range(n):
            m.joint_P[j][0][k] += h * m.joint_P[j][1][k]
        for k in range(n):
            m.joint_P[j][k][0] += h * m.joint_P[j][k][1]
        m.joint_P[j][0][0] += drive * (dt * dt * dt / 3.0)
        m.joint_P[j][1][1] += drive * dt
        m.joint_P[j][0][1] += drive * (dt * dt / 2.0)
        m.joint_P[j][1][0] += drive * (dt * dt / 2.0)
        for i in range(2):
            _bound(m, j, i)


def _active(m: FilterMemory) -> int:
    """Return the rows of the covariances that are in use, and one more."""
    slot = JOINT_SLOTS - 1
    while slot >= 0 and m.joint_owner[slot] < 0.0:
        slot -= 1
    return 3 + slot


def _bound(m: FilterMemory, j: int, i: int) -> None:
    """Bound variances by `joint_limit`: what is lost or unknown falls back to it."""
    largest_variance = m.joint_limit[i] * m.joint_limit[i]
    lost = not math.isfinite(m.joint_x[j][i])
    P = m.joint_P[j][i][i]
    if not lost and vehicle_model.is_determined(P, largest_variance):
        return
    if i == 1 and not lost and P > 0.0 and math.isfinite(P):
        share = math.sqrt(largest_variance / P)
        for k in range(JOINT_STATES):
            m.joint_P[j][1][k] *= share
        for k in range(JOINT_STATES):
            m.joint_P[j][k][1] *= share
        m.joint_P[j][1][1] = largest_variance
    else:
        _clear(m, j, i, largest_variance)
    if lost or i == 1:
        m.joint_x[j][i] = 0.0


def _clear(m: FilterMemory, j: int, i: int, variance: float) -> None:
    for k in range(JOINT_STATES):
        m.joint_P[j][i][k] = 0.0
        m.joint_P[j][k][i] = 0.0
    m.joint_P[j][i][i] = variance


def fuse_joints(m: FilterMemory) -> None:
    """Use what is fresh, then clone what late channels see now."""
    update.space_clones(m, _FIRST, filtering.N_CHANNELS, JOINT_SLOTS)
    for c in range(_FIRST, filtering.N_CHANNELS):
        if m.fresh[c] != 0.0:
            _ingest(m, c)
    for c in range(_FIRST, filtering.N_CHANNELS):
        if m.lag[c] > 0.0:
            update.free_expired(m, c, m.joint_owner, m.joint_taken, JOINT_SLOTS)
            if update.is_due(m, c):
                _clone(m, c)


def _ingest(m: FilterMemory, c: int) -> None:
    value = m.joint_value[c - _FIRST]
    count = 0
    limit = filtering.UNKNOWN * m.joint_limit[0] * m.joint_limit[0]
    if not update.is_of_now(m, c):
        return
    for j in range(m.n_joints):
        if not abs(value[j]) <= filtering.LARGEST:
            return
    m.last[c] = m.stamp[c]
    update.update_lag(m, c)
    for j in range(m.n_joints):
        m.joint_unknown[j] = c == _FIRST and m.joint_P[j][0][0] > limit
        if m.joint_unknown[j] != 0.0:
            # Take the first reading for the truth.
            age = m.now - m.stamp[_FIRST]
            sigma = m.sigma[_FIRST]
            m.joint_x[j][0] = m.joint_value[0][j] + age * m.joint_x[j][1]
            _clear(m, j, 0, sigma * sigma + age * age * m.joint_P[j][1][1])
            count += 1
    for slot in range(JOINT_SLOTS if count > 0 else 0):
        if m.joint_owner[slot] == c:
            m.joint_owner[slot] = -1.0
    slot = update.nearest_clone(m, c, m.joint_owner, m.joint_taken, JOINT_SLOTS)
    if count == m.n_joints:
        m.used[c] = m.stamp[c]
    elif slot != update.NONE:
        _gate(m, c, slot, m.stamp[c] - (m.now if slot < 0 else m.joint_taken[slot]))


def _predicted(m: FilterMemory, j: int, k: int, slot: int) -> float:
    """Return the predicted measurement of channel k at the clone, -1 for now."""
    if slot < 0:
        return m.joint_x[j][k]
    return m.joint_h[j][slot]


def _rate(m: FilterMemory, j: int, k: int, slot: int) -> float:
    """Return how fast that changes [per s]."""
    present_rate = 0.0 if k != 0 else m.joint_x[j][1]
    if slot < 0:
        return present_rate
    return m.joint_rate[j][slot]


def _rate_variance(m: FilterMemory, j: int, k: int, slot: int) -> float:
    present_variance = 0.0 if k != 0 else m.joint_P[j][1][1]
    if slot < 0:
        return present_variance
    return m.joint_rate_variance[j][slot]


def _gate(m: FilterMemory, c: int, slot: int, delta: float) -> None:
    """Believe the readings of the joints or not, and use them."""
    k = c - _FIRST
    n = _active(m)
    accepted = True
    degrees = 0
    total = 0.0
    walk = 0.0
    surprise = 0.0
    state = k if slot < 0 else 2 + slot
    if k != 0:
        walk = m.drive[filtering.ProcessNoise.JOINT] * m.drive[filtering.ProcessNoise.JOINT]
    for j in range(m.n_joints):
        if m.joint_unknown[j] != 0.0:
            m.joint_since[k][j] = math.nan
            continue
        variance = _rate_variance(m, j, k, slot)
        h = _predicted(m, j, k, slot)
        rate = _rate(m, j, k, slot)
        R = m.sigma[c] * m.sigma[c] + delta * delta * max(variance, 0.0) + abs(delta) * walk
        nu = m.joint_value[k][j] - h - delta * rate
        S = m.joint_P[j][state][state] + R
        # Beside what accelerations can do, a joint with a rate may stop.
        stop = abs(h if k != 0 else rate) * (
            update.time_since_accepted(m, c) if c == _FIRST else 1.0
        )
        root = math.sqrt(update.planned_allowance(m, c)) + stop / 5.0
        granted = max(root * root, update.jolt_allowance(m, c))
        believed = nu * nu <= m.gate[c] * (S + granted)
        total += nu * nu / S
        degrees += 1
        if believed:
            m.joint_since[k][j] = math.nan
            if nu * nu / S > m.gate[c]:
                surprise = max(surprise, abs(nu))
                _inflate_surprised(m, j, c, nu * nu)
        elif _is_consistent(m, c, j, nu, S + R + granted):
            believed = True
            _relax(m, j, c, nu * nu)
        if believed:
            _correct(m, j, state, nu, R, n)
        accepted = accepted and believed
    m.surprise[c] = surprise if accepted else m.surprise[c]
    update.record_outcome(m, c, total, degrees, accepted)


def _is_consistent(m: FilterMemory, c: int, j: int, nu: float, S: float) -> bool:
    """Return whether a reading outside the gate agrees with those before it, for long enough."""
    since = m.joint_since[c - _FIRST]
    refused = m.joint_refused[c - _FIRST]
    change = nu - refused[j]
    agrees = math.isfinite(since[j]) and change * change <= m.gate[c] * S
    if not agrees:
        since[j] = m.stamp[c]
    refused[j] = nu
    return agrees and m.stamp[c] - since[j] >= m.recovery[c] - filtering.EARLY


def _inflate_surprised(m: FilterMemory, j: int, c: int, squared: float) -> None:
    """A joint has done what it can and the process model did not expect.

    What is more than twice an acceleration that is planned came at once, where positions are in
    time and alone tell of it: it was faster ever since the last reading that was believed. Less may
    be a delay that nobody knows of.
    """
    time = update.time_since_accepted(m, c)
    since = max(m.stamp[c] - m.used[c], m.dt)
    alone = (
        m.lag[c] <= 0.0
        and m.stamp[c] - m.used[filtering.ChannelIndex.JOINT_VELOCITIES] > m.recovery[c] / 2.0
    )
    jolted = c == _FIRST and alone and math.sqrt(squared) > 2.0 * m.agility[c] * time * since
    _inflate_own(m, j, c, squared)
    if c == _FIRST:
        m.joint_P[j][1][1] += squared / (since * since if jolted else time * time)
    if jolted:
        m.joint_P[j][0][1] += squared / since
        m.joint_P[j][1][0] += squared / since


def _relax(m: FilterMemory, j: int, c: int, squared: float) -> None:
    """The state, and its clones with it, is wrong by an unknown amount."""
    for slot in range(JOINT_SLOTS):
        if m.joint_owner[slot] != c:
            m.joint_owner[slot] = -1.0
    _inflate_own(m, j, c, filtering.GATE_RELAXATION * squared)
    m.joint_since[c - _FIRST][j] = math.nan


def _inflate_own(m: FilterMemory, j: int, c: int, variance: float) -> None:
    """An error of that variance of what the channel sees of a joint, now and in its clones."""
    for a in range(JOINT_STATES):
        for b in range(JOINT_STATES):
            if _is_of(m, c, a) and _is_of(m, c, b):
                m.joint_P[j][a][b] += variance


def _is_of(m: FilterMemory, c: int, state: int) -> bool:
    """Return whether a channel sees a state, or saw the clone that it is."""
    if state >= 2:
        return m.joint_owner[state - 2] == c
    return state == c - _FIRST


def _correct(m: FilterMemory, j: int, state: int, nu: float, R: float, n: int) -> None:
    """The Kalman update."""
    S = m.joint_P[j][state][state] + R
    gain = zeros(JOINT_STATES)
    row = zeros(JOINT_STATES)
    for a in range(n):
        row[a] = m.joint_P[j][state][a]
        gain[a] = m.joint_P[j][a][state] / S
    for a in range(n):
        for b in range(n):
            m.joint_P[j][a][b] -= gain[a] * row[b]
    for a in range(2):
        m.joint_x[j][a] += gain[a] * nu
    for slot in range(n - 2):
        m.joint_h[j][slot] += gain[2 + slot] * nu


def _clone(m: FilterMemory, c: int) -> None:
    slot = update.free_slot(m.joint_owner, JOINT_SLOTS)
    k = c - _FIRST
    if slot < 0:
        return
    at = 2 + slot
    m.joint_owner[slot] = c
    m.joint_taken[slot] = m.now
    for j in range(m.n_joints):
        m.joint_h[j][slot] = _predicted(m, j, k, -1)
        m.joint_rate[j][slot] = _rate(m, j, k, -1)
        m.joint_rate_variance[j][slot] = _rate_variance(m, j, k, -1)
        m.joint_P[j][at][:] = m.joint_P[j][k]
        for a in range(JOINT_STATES):
            m.joint_P[j][a][at] = m.joint_P[j][a][k]
        m.joint_P[j][at][at] = m.joint_P[j][k][k]
