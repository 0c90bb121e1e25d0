"""Gate and fuse the readings of the vehicle, late ones by stochastic cloning: the NumPy twin of fusion.c and clones.c."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from uvms_ocp.estimation.filter_memory import (
    CONSTANTS,
    MAIN,
    N_VEHICLE,
    ORDERS,
    ROWS,
    SLOTS,
    ChannelIndex,
    FilterMemory,
    Part,
    ProcessNoise,
)
from uvms_ocp.estimation.vehicle_model import (
    PredictedMeasurement,
    active,
    clear,
    is_unknown,
    part,
    predict_measurement,
    process_variance,
    rotation,
    second_derivative,
    turned,
)
from uvms_ocp.types import Array, Mask

# When readings are taken that arrive late, and which clone stands for one: what clones.c does; keep both in step.

_NOW = -1


def space_clones(m: FilterMemory, first: int, last: int, slots: int) -> None:
    """Share the slots among the late ones of channels first to last: where all their readings do not fit, none has many."""
    channels = [c for c in range(first, last) if m.lag[c] > 0.0]
    most = CONSTANTS.most_clones
    while most > 2.0 and sum(min(most, _wanted(m, c)) for c in channels) > slots:
        most -= 1.0
    for c in channels:
        m.apart[c] = max(m.period[c], _least(c), (m.lag[c] + 2.0 * m.dt[0]) / (most - 1.0))


def _least(c: int) -> float:
    """[s] between two clones at least: motion is smooth enough in between. Joints have no need to save."""
    return CONSTANTS.spacing * ORDERS[c] if c < N_VEHICLE else 0.0


def _wanted(m: FilterMemory, c: int) -> float:
    """Clones at a time if every reading of channel c has one that is near enough."""
    apart = max(m.period[c], m.dt[0], _least(c), CONSTANTS.early)
    return float((m.lag[c] + 2.0 * m.dt[0]) / apart + 1.0)


def update_lag(m: FilterMemory, c: int) -> None:
    """Remember how late the fresh reading of channel c is."""
    age = m.now[0] - m.stamp[c]
    if age > 1.5 * m.dt[0] + CONSTANTS.early and age > m.lag[c]:
        m.lag[c] = min(age, CONSTANTS.longest_lag)


def nearest_clone(m: FilterMemory, c: int, owner: Array, taken: Array) -> tuple[int, float, bool]:
    """The clone for the fresh reading of channel c, -1 for now; by how much the reading is newer [s]; if near enough.

    owner (slots,) and taken (slots,) [s]: channel and time of each clone.
    """
    best, delta, reach = _NOW, m.stamp[c] - m.now[0], 1.5 * m.dt[0] + CONSTANTS.early
    for slot in np.flatnonzero(owner == c):
        if abs(m.stamp[c] - taken[slot]) < abs(delta):
            best, delta = int(slot), m.stamp[c] - taken[slot]
    if best != _NOW:
        reach += m.apart[c]
    return best, float(delta), bool(abs(delta) <= reach)


def is_due(m: FilterMemory, c: int) -> bool:
    """Return whether channel c is late and takes a reading at this tick; if so the next time is noted."""
    if m.lag[c] <= 0.0 or m.now[0] < m.due[c] - CONSTANTS.early:
        return False
    spacing, period = m.apart[c], m.period[c]
    if spacing <= m.dt[0] + CONSTANTS.early:
        m.due[c] = m.now[0]
    elif period <= m.dt[0]:
        m.due[c] = m.now[0] + spacing
    else:
        phase = m.last[c] if math.isfinite(m.last[c]) else 0.0
        steps = math.floor((m.now[0] - phase) / period + 1e-6) + math.ceil(spacing / period - 1e-6)
        m.due[c] = phase + steps * period
    return True


def free_expired(m: FilterMemory, c: int, owner: Array, taken: Array) -> None:
    """Free clones of channel c whose readings are lost, or that are older than the last one.

    owner (slots,) and taken (slots,) [s]: channel and time of each clone.
    """
    old = (m.now[0] - taken > m.lag[c] + 2.0 * m.dt[0] + CONSTANTS.early) | (taken <= m.last[c] + CONSTANTS.early)
    owner[(owner == c) & old] = -1.0


def free_slot(owner: Array) -> int:
    """The first free one, -1 for none; owner (slots,)."""
    free = np.flatnonzero(owner < 0)
    return int(free[0]) if len(free) else -1


def gate_allowance(m: FilterMemory, c: ChannelIndex) -> float:
    """Variance that the gate grants channel c for accelerations that the process model does not expect.

    Of what the robot can have done since the last reading that was believed; the gate is five standard deviations wide.
    """
    moved = m.agility[c] * time_since_accepted(m, c) ** ORDERS[c] / max(1, ORDERS[c])
    return float(moved * moved / 25.0)


def time_since_accepted(m: FilterMemory, c: ChannelIndex) -> float:
    """Time [s] in which the robot can have done something else since the last reading of channel c that was believed."""
    return float(min(m.stamp[c] - m.used[c], CONSTANTS.longest_lag) + CONSTANTS.surprise)


def record_outcome(m: FilterMemory, c: ChannelIndex, squared: float, degrees: int, *, believed: bool) -> None:
    """Record the outcome for the fresh reading of channel c: `squared` and its degrees of freedom."""
    m.outcome[c] = m.stamp[c], squared, degrees, float(believed)
    if believed:
        m.used[c] = m.stamp[c]


# Readings of the vehicle's channels in NumPy: what fusion.c does; keep both in step.
#
# A late reading is compared with its clone and corrects it, the state of now and all other clones by their covariances.

_CORRECTED_BY = {
    ChannelIndex.ATTITUDE: Part.TURN,
    ChannelIndex.ANGULAR_VELOCITY: Part.SPIN,
    ChannelIndex.POSITION: Part.PLACE,
    ChannelIndex.DEPTH: Part.PLACE + 2,
    ChannelIndex.LINEAR_VELOCITY: Part.SPEED,
    ChannelIndex.SPECIFIC_FORCE: Part.ACCELERATION,
    ChannelIndex.ALTIMETER_RANGE: Part.FLOOR,
}
"""The part that a channel alone can put right."""
_BIAS_OF = {
    ChannelIndex.ATTITUDE: Part.GYRO_BIAS,
    ChannelIndex.ANGULAR_VELOCITY: Part.GYRO_BIAS,
    ChannelIndex.POSITION: Part.DVL_BIAS,
    ChannelIndex.DEPTH: Part.DVL_BIAS,
}
"""The bias that may be what a surprise is about. Not of DVLs by themselves: fixes are too rough to find theirs again soon."""
_INITIALISING = (ChannelIndex.ATTITUDE, ChannelIndex.POSITION, ChannelIndex.DEPTH, ChannelIndex.ALTIMETER_RANGE)
"""Channels whose first reading is taken for the truth."""
_NEEDS_ATTITUDE = (ChannelIndex.LINEAR_VELOCITY, ChannelIndex.SPECIFIC_FORCE, ChannelIndex.ALTIMETER_RANGE)
"""Channels that mean nothing where the attitude is unknown."""
_FREE = -1.0


def fuse(m: FilterMemory) -> None:
    """Use what is fresh, then clone what late channels see now."""
    space_clones(m, 0, N_VEHICLE, SLOTS)
    for c in ChannelIndex:
        if c < N_VEHICLE and m.fresh[c]:
            _ingest(m, c)
    for c in ChannelIndex:
        if c < N_VEHICLE and m.lag[c] > 0.0:
            free_expired(m, c, m.owner, m.taken)
            if is_due(m, c):
                _clone(m, c)


def _ingest(m: FilterMemory, c: ChannelIndex) -> None:
    if not _is_usable(m, c):
        return
    m.last[c] = m.stamp[c]
    if c == ChannelIndex.ALTIMETER_RANGE and math.isnan(m.value[c, 0]):
        m.used[c] = m.stamp[c]  # no echo is an answer too
        return
    update_lag(m, c)
    if c in _NEEDS_ATTITUDE and is_unknown(m, Part.TURN, 3):
        return
    if c in _INITIALISING and is_unknown(m, _CORRECTED_BY[c], ROWS[c]):
        _initialise(m, c)
        return
    slot, delta, near = nearest_clone(m, c, m.owner, m.taken)
    if near:
        _gate(m, c, slot, delta)


def _is_usable(m: FilterMemory, c: ChannelIndex) -> bool:
    """Return whether the fresh reading is one: of a size that can be, newer than the last, not of the future."""
    if not m.last[c] < m.stamp[c] <= m.now[0] + CONSTANTS.early:
        return False
    value = m.value[c, : ROWS[c]]
    if c == ChannelIndex.ALTIMETER_RANGE:
        return bool(math.isnan(value[0]) or 0.0 <= value[0] <= CONSTANTS.largest)
    if not (np.abs(value) <= CONSTANTS.largest).all():
        return False
    return c != ChannelIndex.ATTITUDE or bool(abs(float(np.linalg.norm(m.value[c])) - 1.0) <= CONSTANTS.unit)


def _initialise(m: FilterMemory, c: ChannelIndex) -> None:
    """Take the first reading for the truth, unless it is too old to be. Nothing that was cloned before can be right."""
    age, first, sight = m.now[0] - m.stamp[c], _CORRECTED_BY[c], predict_measurement(m, c)
    variance = float(m.sigma[c] ** 2) + process_variance(m, c, sight, age)
    if variance > CONSTANTS.unknown * m.limit[first] ** 2:
        return
    m.owner[:] = _FREE
    n, sight = active(m), predict_measurement(m, c)
    if c == ChannelIndex.ALTIMETER_RANGE:
        _set_floor(m, sight, age)
    else:
        moved = age * sight.rate[:3] - age * age / 2 * second_derivative(m, c)
        for i in range(ROWS[c]):
            clear(m, first + i, n, variance)
        if c == ChannelIndex.ATTITUDE:
            m.turn[:] = turned(m.value[c] / np.linalg.norm(m.value[c]), moved)
        else:
            m.x[first - Part.PLACE :][: ROWS[c]] = m.value[c, : ROWS[c]] + moved[: ROWS[c]]
    m.used[c] = m.stamp[c]


def _set_floor(m: FilterMemory, sight: PredictedMeasurement, age: float) -> None:
    cosine = sight.h[1]
    if cosine <= CONSTANTS.steep:
        return
    c, i, n = ChannelIndex.ALTIMETER_RANGE, Part.FLOOR, active(m)
    measured = cosine * m.value[c, 0] + age * sight.rate[0] - age * age / 2 * second_derivative(m, c)[0]
    m.x[i - Part.PLACE] = part(m, Part.PLACE)[2] + rotation(m)[2] @ m.beam_at - measured
    row = sight.HP[0] + m.P[i, :n]  # of the height of the altimeter
    own = sight.S[0, 0] + 2.0 * sight.HP[0, i] + m.P[i, i]
    m.P[i, :n] = row
    m.P[:n, i] = row
    m.P[i, i] = own + (cosine * m.sigma[c]) ** 2 + process_variance(m, c, sight, age)
    m.echo[0] = m.stamp[c]


def _gate(m: FilterMemory, c: ChannelIndex, slot: int, delta: float) -> None:
    """Believe a reading or not, and use it."""
    sight = _sight_of(m, c, slot)
    if c == ChannelIndex.ALTIMETER_RANGE and sight.h[1] <= CONSTANTS.steep:
        return
    nu, own = _innovation(m, c, sight, delta), _noise(m, c, sight, delta)
    granted, size = gate_allowance(m, c), float(nu @ nu)
    squared, believed = _squared_innovation(sight, own, nu), _squared_innovation(sight, own + granted, nu) <= m.gate[c]
    if believed:
        m.since[c] = math.nan
        if squared > m.gate[c]:
            _inflate_surprised(m, c, size)
            sight = _sight_of(m, c, slot)
    elif math.isfinite(squared) and math.isfinite(size) and _is_consistent(m, c, sight, 2.0 * own + granted, nu):
        believed = True
        _relax(m, c, size)
        sight = _sight_of(m, c, slot)
    record_outcome(m, c, squared, len(nu), believed=believed)
    if believed:
        if c == ChannelIndex.ALTIMETER_RANGE:
            m.echo[0] = m.stamp[c]
        _correct(m, c, sight, nu, own)


def _sight_of(m: FilterMemory, c: ChannelIndex, slot: int) -> PredictedMeasurement:
    """Return the predicted measurement of c at the time of the clone, -1 for now."""
    if slot < 0:
        return predict_measurement(m, c)
    n, at = active(m), MAIN + 3 * slot
    HP = m.P[at : at + ROWS[c], :n].copy()
    S = HP[:, at : at + ROWS[c]]
    return PredictedMeasurement(h=m.h[slot], rate=m.rate[slot], rate_variance=float(m.rate_variance[slot]), HP=HP, S=S)


def _innovation(m: FilterMemory, c: ChannelIndex, sight: PredictedMeasurement, delta: float) -> Array:
    """(rows,) measured minus seen, which is carried on by delta [s]."""
    n = ROWS[c]
    if c == ChannelIndex.ATTITUDE:
        h = pin.Quaternion(turned(sight.h, delta * sight.rate))
        measured = m.value[c] / np.linalg.norm(m.value[c])
        return np.asarray(pin.log3((h.inverse() * pin.Quaternion(measured)).toRotationMatrix()))
    measured = m.value[c, :n] * (sight.h[1] if c == ChannelIndex.ALTIMETER_RANGE else 1.0)
    return np.asarray(measured - sight.h[:n] - delta * sight.rate[:n])


def _noise(m: FilterMemory, c: ChannelIndex, sight: PredictedMeasurement, delta: float) -> float:
    """Variance of every entry of the reading."""
    sigma = m.sigma[c] * (sight.h[1] if c == ChannelIndex.ALTIMETER_RANGE else 1.0)
    walk = m.drive[ProcessNoise.JERK] ** 2 if c == ChannelIndex.SPECIFIC_FORCE else 0.0
    return float(sigma * sigma + delta * delta * max(0.0, sight.rate_variance) + abs(delta) * walk)


def _squared_innovation(sight: PredictedMeasurement, more: float, nu: Array) -> float:
    w = np.linalg.solve(sight.factor(more), nu)
    return float(w @ w)


def _is_consistent(m: FilterMemory, c: ChannelIndex, sight: PredictedMeasurement, more: float, nu: Array) -> bool:
    """Return whether a reading outside the gate agrees with those before it, for long enough; a nearer floor needs no witness."""
    rows = len(nu)
    known = math.isfinite(m.since[c])
    agrees = known and _squared_innovation(sight, more, nu - m.refused[c, :rows]) <= m.gate[c]
    if not agrees:
        m.since[c] = m.stamp[c]
    m.refused[c, :rows] = nu
    if c == ChannelIndex.ALTIMETER_RANGE and nu[0] < 0.0:
        return True
    return bool(agrees and m.stamp[c] - m.since[c] >= m.recovery[c] - CONSTANTS.early)


def _relax(m: FilterMemory, c: ChannelIndex, squared: float) -> None:
    """Inflate the variance of the part that this channel alone observes, now and in its clones, by a common error."""
    m.owner[(m.owner != c)] = _FREE
    m.since[c] = math.nan
    _inflate_own(m, c, CONSTANTS.gate_relaxation * squared)
    if c not in (ChannelIndex.POSITION, ChannelIndex.DEPTH):
        return
    # It took the time of recovery to go so far: with a speed that nobody knew of, or an acceleration.
    time, own = float(m.recovery[c]), np.arange(_CORRECTED_BY[c], _CORRECTED_BY[c] + ROWS[c])
    speed = min(CONSTANTS.gate_relaxation * squared / time**2, CONSTANTS.exposed**2)
    m.P[own + 3, own + 3] += speed
    m.P[own + 6, own + 6] += speed / time**2


def _inflate_surprised(m: FilterMemory, c: ChannelIndex, squared: float) -> None:
    """The robot has done what it can and the process model did not expect, or what carries the estimate is biased."""
    if c == ChannelIndex.LINEAR_VELOCITY:
        return  # which tells of accelerations, to go on with
    _inflate_own(m, c, squared)
    if c in _BIAS_OF:
        axes = range(_BIAS_OF[c], _BIAS_OF[c] + 3)
        m.P[axes, axes] += squared / time_since_accepted(m, c) ** (2 * ORDERS[c] - 2)


def _inflate_own(m: FilterMemory, c: ChannelIndex, variance: float) -> None:
    """An error of that variance of what the channel alone can put right, now and in its clones."""
    n, rows, R = active(m), ROWS[c], rotation(m)
    G = np.zeros((n, rows))
    G[_CORRECTED_BY[c] : _CORRECTED_BY[c] + rows] = np.eye(rows)
    moved = R.T if c in (ChannelIndex.LINEAR_VELOCITY, ChannelIndex.SPECIFIC_FORCE) else np.eye(rows)
    for slot in np.flatnonzero(m.owner == c):
        G[MAIN + 3 * slot : MAIN + 3 * slot + rows] = -moved if c == ChannelIndex.ALTIMETER_RANGE else moved
    m.P[:n, :n] += variance * G @ G.T


def _correct(m: FilterMemory, c: ChannelIndex, sight: PredictedMeasurement, nu: Array, own: float) -> None:
    """The Kalman update. Echoes move the floor alone: they are no means to tell where the vehicle is."""
    n, L = active(m), sight.factor(own)
    W, w = np.linalg.solve(L, sight.HP), np.linalg.solve(L, nu)
    loss, dx = W.T @ W, W.T @ w
    if c == ChannelIndex.ALTIMETER_RANGE:
        moved = _moved_by_echoes(m, n)
        loss, dx = np.where(moved[:, None] | moved, loss, 0.0), np.where(moved, dx, 0.0)
    m.P[:n, :n] -= loss
    m.turn[:] = turned(m.turn, dx[:3])
    m.x += dx[3:MAIN]
    for slot in np.flatnonzero(m.owner >= 0):
        change = dx[MAIN + 3 * slot : MAIN + 3 * slot + 3]
        if m.owner[slot] == ChannelIndex.ATTITUDE:
            m.h[slot] = turned(m.h[slot], change)
        else:
            rows = ROWS[int(m.owner[slot])]
            m.h[slot, :rows] += change[:rows]


def _moved_by_echoes(m: FilterMemory, n: int) -> Mask:
    moved = np.zeros(n, dtype=bool)
    moved[Part.FLOOR] = True
    for slot in np.flatnonzero(m.owner == ChannelIndex.ALTIMETER_RANGE):
        moved[MAIN + 3 * slot] = True
    return moved


def _clone(m: FilterMemory, c: ChannelIndex) -> None:
    """Keep what channel c sees now, with its covariances, until its reading arrives."""
    unknown = c in _INITIALISING and is_unknown(m, _CORRECTED_BY[c], ROWS[c])
    slot = free_slot(m.owner)
    if slot < 0 or unknown or (c in _NEEDS_ATTITUDE and is_unknown(m, Part.TURN, 3)):
        return
    sight, at, rows = predict_measurement(m, c), MAIN + 3 * slot, ROWS[c]
    m.owner[slot], m.taken[slot] = c, m.now[0]
    m.h[slot], m.rate[slot], m.rate_variance[slot] = sight.h, sight.rate, sight.rate_variance
    n, before = active(m), sight.HP.shape[1]
    m.P[at : at + 3, :n] = 0.0
    m.P[:n, at : at + 3] = 0.0
    m.P[at : at + rows, :before] = sight.HP
    m.P[:before, at : at + rows] = sight.HP.T
    m.P[at : at + rows, at : at + rows] = sight.S
