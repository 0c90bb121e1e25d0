"""Readings of the vehicle's channels in NumPy: what fusion.c does; keep both in step.

A late reading is compared with its clone and corrects it, the state of now and all other clones by their covariances.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from uvms_ocp.arrays import Array, Mask
from uvms_ocp.control.navigation.filter.clones import (
    allowance,
    expire,
    free_slot,
    is_due,
    learn_lag,
    nearest,
    note,
    space_out,
    unseen,
)
from uvms_ocp.control.navigation.filter.memory import (
    CONSTANTS,
    MAIN,
    N_VEHICLE,
    ORDERS,
    ROWS,
    SLOTS,
    Channel,
    Memory,
    Noise,
    Part,
)
from uvms_ocp.control.navigation.filter.sights import Sight, doubt_since, look, second_of
from uvms_ocp.control.navigation.filter.vehicle import active, clear, is_unknown, part, rotation, turned

_OWN = {
    Channel.ATTITUDE: Part.TURN,
    Channel.ANGULAR_VELOCITY: Part.SPIN,
    Channel.POSITION: Part.PLACE,
    Channel.DEPTH: Part.PLACE + 2,
    Channel.LINEAR_VELOCITY: Part.SPEED,
    Channel.SPECIFIC_FORCE: Part.ACCELERATION,
    Channel.ALTIMETER_RANGE: Part.FLOOR,
}
"""The part that a channel alone can put right."""
_CARRIED = {
    Channel.ATTITUDE: Part.GYRO_BIAS,
    Channel.ANGULAR_VELOCITY: Part.GYRO_BIAS,
    Channel.POSITION: Part.DVL_BIAS,
    Channel.DEPTH: Part.DVL_BIAS,
}
"""The bias that may be what a surprise is about. Not of DVLs by themselves: fixes are too rough to find theirs again soon."""
_SETTING = (Channel.ATTITUDE, Channel.POSITION, Channel.DEPTH, Channel.ALTIMETER_RANGE)
"""Channels whose first reading is taken for the truth."""
_TURNING = (Channel.LINEAR_VELOCITY, Channel.SPECIFIC_FORCE, Channel.ALTIMETER_RANGE)
"""Channels that mean nothing where the attitude is unknown."""
_FREE = -1.0


def fuse(m: Memory) -> None:
    """Use what is fresh, then clone what late channels see now."""
    space_out(m, 0, N_VEHICLE, SLOTS)
    for c in Channel:
        if c < N_VEHICLE and m.fresh[c]:
            _take(m, c)
    for c in Channel:
        if c < N_VEHICLE and m.lag[c] > 0.0:
            expire(m, c, m.owner, m.taken)
            if is_due(m, c):
                _clone(m, c)


def _take(m: Memory, c: Channel) -> None:
    if not _is_usable(m, c):
        return
    m.last[c] = m.stamp[c]
    if c == Channel.ALTIMETER_RANGE and math.isnan(m.value[c, 0]):
        m.used[c] = m.stamp[c]  # no echo is an answer too
        return
    learn_lag(m, c)
    if c in _TURNING and is_unknown(m, Part.TURN, 3):
        return
    if c in _SETTING and is_unknown(m, _OWN[c], ROWS[c]):
        _set(m, c)
        return
    slot, delta, near = nearest(m, c, m.owner, m.taken)
    if near:
        _judge(m, c, slot, delta)


def _is_usable(m: Memory, c: Channel) -> bool:
    """Whether the fresh reading is one: of a size that can be, newer than the last, not of the future."""
    if not m.last[c] < m.stamp[c] <= m.now[0] + CONSTANTS.early:
        return False
    value = m.value[c, : ROWS[c]]
    if c == Channel.ALTIMETER_RANGE:
        return bool(math.isnan(value[0]) or 0.0 <= value[0] <= CONSTANTS.largest)
    if not (np.abs(value) <= CONSTANTS.largest).all():
        return False
    return c != Channel.ATTITUDE or bool(abs(float(np.linalg.norm(m.value[c])) - 1.0) <= CONSTANTS.unit)


def _set(m: Memory, c: Channel) -> None:
    """Take the first reading for the truth, unless it is too old to be. Nothing that was cloned before can be right."""
    age, first, sight = m.now[0] - m.stamp[c], _OWN[c], look(m, c)
    variance = float(m.sigma[c] ** 2) + doubt_since(m, c, sight, age)
    if variance > CONSTANTS.unknown * m.limit[first] ** 2:
        return
    m.owner[:] = _FREE
    n, sight = active(m), look(m, c)
    if c == Channel.ALTIMETER_RANGE:
        _set_floor(m, sight, age)
    else:
        moved = age * sight.rate[:3] - age * age / 2 * second_of(m, c)
        for i in range(ROWS[c]):
            clear(m, first + i, n, variance)
        if c == Channel.ATTITUDE:
            m.turn[:] = turned(m.value[c] / np.linalg.norm(m.value[c]), moved)
        else:
            m.x[first - Part.PLACE :][: ROWS[c]] = m.value[c, : ROWS[c]] + moved[: ROWS[c]]
    m.used[c] = m.stamp[c]


def _set_floor(m: Memory, sight: Sight, age: float) -> None:
    cosine = sight.seen[1]
    if cosine <= CONSTANTS.steep:
        return
    c, i, n = Channel.ALTIMETER_RANGE, Part.FLOOR, active(m)
    measured = cosine * m.value[c, 0] + age * sight.rate[0] - age * age / 2 * second_of(m, c)[0]
    m.x[i - Part.PLACE] = part(m, Part.PLACE)[2] + rotation(m)[2] @ m.beam_at - measured
    row = sight.HP[0] + m.P[i, :n]  # of the height of the altimeter
    own = sight.S[0, 0] + 2.0 * sight.HP[0, i] + m.P[i, i]
    m.P[i, :n] = row
    m.P[:n, i] = row
    m.P[i, i] = own + (cosine * m.sigma[c]) ** 2 + doubt_since(m, c, sight, age)
    m.echo[0] = m.stamp[c]


def _judge(m: Memory, c: Channel, slot: int, delta: float) -> None:
    """Believe a reading or not, and use it."""
    sight = _sight_of(m, c, slot)
    if c == Channel.ALTIMETER_RANGE and sight.seen[1] <= CONSTANTS.steep:
        return
    nu, own = _innovation(m, c, sight, delta), _noise(m, c, sight, delta)
    granted, size = allowance(m, c), float(nu @ nu)
    squared, believed = _squared(sight, own, nu), _squared(sight, own + granted, nu) <= m.gate[c]
    if believed:
        m.since[c] = math.nan
        if squared > m.gate[c]:
            _be_surprised(m, c, size)
            sight = _sight_of(m, c, slot)
    elif math.isfinite(squared) and math.isfinite(size) and _is_convincing(m, c, sight, 2.0 * own + granted, nu):
        believed = True
        _yield(m, c, size)
        sight = _sight_of(m, c, slot)
    note(m, c, squared, len(nu), believed=believed)
    if believed:
        if c == Channel.ALTIMETER_RANGE:
            m.echo[0] = m.stamp[c]
        _correct(m, c, sight, nu, own)


def _sight_of(m: Memory, c: Channel, slot: int) -> Sight:
    """What c saw at the time of the clone, -1 for now."""
    if slot < 0:
        return look(m, c)
    n, at = active(m), MAIN + 3 * slot
    HP = m.P[at : at + ROWS[c], :n].copy()
    S = HP[:, at : at + ROWS[c]]
    return Sight(seen=m.seen[slot], rate=m.rate[slot], doubt=float(m.doubt[slot]), HP=HP, S=S)


def _innovation(m: Memory, c: Channel, sight: Sight, delta: float) -> Array:
    """(rows,) measured minus seen, which is carried on by delta [s]."""
    n = ROWS[c]
    if c == Channel.ATTITUDE:
        seen = pin.Quaternion(turned(sight.seen, delta * sight.rate))
        measured = m.value[c] / np.linalg.norm(m.value[c])
        return np.asarray(pin.log3((seen.inverse() * pin.Quaternion(measured)).toRotationMatrix()))
    measured = m.value[c, :n] * (sight.seen[1] if c == Channel.ALTIMETER_RANGE else 1.0)
    return np.asarray(measured - sight.seen[:n] - delta * sight.rate[:n])


def _noise(m: Memory, c: Channel, sight: Sight, delta: float) -> float:
    """Variance of every entry of the reading."""
    sigma = m.sigma[c] * (sight.seen[1] if c == Channel.ALTIMETER_RANGE else 1.0)
    walk = m.drive[Noise.JERK] ** 2 if c == Channel.SPECIFIC_FORCE else 0.0
    return float(sigma * sigma + delta * delta * max(0.0, sight.doubt) + abs(delta) * walk)


def _squared(sight: Sight, more: float, nu: Array) -> float:
    w = np.linalg.solve(sight.factor(more), nu)
    return float(w @ w)


def _is_convincing(m: Memory, c: Channel, sight: Sight, more: float, nu: Array) -> bool:
    """Whether a reading outside the gate agrees with those before it, for long enough; a nearer floor needs no witness."""
    rows = len(nu)
    known = math.isfinite(m.since[c])
    agrees = known and _squared(sight, more, nu - m.refused[c, :rows]) <= m.gate[c]
    if not agrees:
        m.since[c] = m.stamp[c]
    m.refused[c, :rows] = nu
    if c == Channel.ALTIMETER_RANGE and nu[0] < 0.0:
        return True
    return bool(agrees and m.stamp[c] - m.since[c] >= m.recovery[c] - CONSTANTS.early)


def _yield(m: Memory, c: Channel, squared: float) -> None:
    """What the channel alone can put right is wrong, now and in its clones, by an unknown and common amount."""
    m.owner[(m.owner != c)] = _FREE
    m.since[c] = math.nan
    _doubt_own(m, c, CONSTANTS.persuasion * squared)
    if c not in (Channel.POSITION, Channel.DEPTH):
        return
    # It took the time of recovery to go so far: with a speed that nobody knew of, or an acceleration.
    time, own = float(m.recovery[c]), np.arange(_OWN[c], _OWN[c] + ROWS[c])
    speed = min(CONSTANTS.persuasion * squared / time**2, CONSTANTS.exposed**2)
    m.P[own + 3, own + 3] += speed
    m.P[own + 6, own + 6] += speed / time**2


def _be_surprised(m: Memory, c: Channel, squared: float) -> None:
    """The robot has done what it can and the process model did not expect, or what carries the estimate is biased."""
    if c == Channel.LINEAR_VELOCITY:
        return  # which tells of accelerations, to go on with
    _doubt_own(m, c, squared)
    if c in _CARRIED:
        axes = range(_CARRIED[c], _CARRIED[c] + 3)
        m.P[axes, axes] += squared / unseen(m, c) ** (2 * ORDERS[c] - 2)


def _doubt_own(m: Memory, c: Channel, variance: float) -> None:
    """An error of that variance of what the channel alone can put right, now and in its clones."""
    n, rows, R = active(m), ROWS[c], rotation(m)
    G = np.zeros((n, rows))
    G[_OWN[c] : _OWN[c] + rows] = np.eye(rows)
    moved = R.T if c in (Channel.LINEAR_VELOCITY, Channel.SPECIFIC_FORCE) else np.eye(rows)
    for slot in np.flatnonzero(m.owner == c):
        G[MAIN + 3 * slot : MAIN + 3 * slot + rows] = -moved if c == Channel.ALTIMETER_RANGE else moved
    m.P[:n, :n] += variance * G @ G.T


def _correct(m: Memory, c: Channel, sight: Sight, nu: Array, own: float) -> None:
    """The Kalman update. Echoes move the floor alone: they are no means to tell where the vehicle is."""
    n, L = active(m), sight.factor(own)
    W, w = np.linalg.solve(L, sight.HP), np.linalg.solve(L, nu)
    loss, dx = W.T @ W, W.T @ w
    if c == Channel.ALTIMETER_RANGE:
        moved = _moved_by_echoes(m, n)
        loss, dx = np.where(moved[:, None] | moved, loss, 0.0), np.where(moved, dx, 0.0)
    m.P[:n, :n] -= loss
    m.turn[:] = turned(m.turn, dx[:3])
    m.x += dx[3:MAIN]
    for slot in np.flatnonzero(m.owner >= 0):
        change = dx[MAIN + 3 * slot : MAIN + 3 * slot + 3]
        if m.owner[slot] == Channel.ATTITUDE:
            m.seen[slot] = turned(m.seen[slot], change)
        else:
            rows = ROWS[int(m.owner[slot])]
            m.seen[slot, :rows] += change[:rows]


def _moved_by_echoes(m: Memory, n: int) -> Mask:
    moved = np.zeros(n, dtype=bool)
    moved[Part.FLOOR] = True
    for slot in np.flatnonzero(m.owner == Channel.ALTIMETER_RANGE):
        moved[MAIN + 3 * slot] = True
    return moved


def _clone(m: Memory, c: Channel) -> None:
    """Keep what channel c sees now, with its covariances, until its reading arrives."""
    unknown = c in _SETTING and is_unknown(m, _OWN[c], ROWS[c])
    slot = free_slot(m.owner)
    if slot < 0 or unknown or (c in _TURNING and is_unknown(m, Part.TURN, 3)):
        return
    sight, at, rows = look(m, c), MAIN + 3 * slot, ROWS[c]
    m.owner[slot], m.taken[slot] = c, m.now[0]
    m.seen[slot], m.rate[slot], m.doubt[slot] = sight.seen, sight.rate, sight.doubt
    n, before = active(m), sight.HP.shape[1]
    m.P[at : at + 3, :n] = 0.0
    m.P[:n, at : at + 3] = 0.0
    m.P[at : at + rows, :before] = sight.HP
    m.P[:before, at : at + rows] = sight.HP.T
    m.P[at : at + rows, at : at + rows] = sight.S
