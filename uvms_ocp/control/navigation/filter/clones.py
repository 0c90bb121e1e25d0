"""When readings are taken that arrive late, and which clone stands for one: what clones.c does; keep both in step."""

from __future__ import annotations

import math

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.control.navigation.filter.memory import CONSTANTS, N_VEHICLE, ORDERS, Channel, Memory

_NOW = -1


def space_out(m: Memory, first: int, last: int, slots: int) -> None:
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


def _wanted(m: Memory, c: int) -> float:
    """Clones at a time if every reading of channel c has one that is near enough."""
    apart = max(m.period[c], m.dt[0], _least(c), CONSTANTS.early)
    return float((m.lag[c] + 2.0 * m.dt[0]) / apart + 1.0)


def learn_lag(m: Memory, c: int) -> None:
    """Remember how late the fresh reading of channel c is."""
    age = m.now[0] - m.stamp[c]
    if age > 1.5 * m.dt[0] + CONSTANTS.early and age > m.lag[c]:
        m.lag[c] = min(age, CONSTANTS.longest_lag)


def nearest(m: Memory, c: int, owner: Array, taken: Array) -> tuple[int, float, bool]:
    """The clone for the fresh reading of channel c, -1 for now; by how much the reading is newer [s]; if near enough.

    owner (slots,) [-] and taken (slots,) [s]: channel and time of each clone.
    """
    best, delta, reach = _NOW, m.stamp[c] - m.now[0], 1.5 * m.dt[0] + CONSTANTS.early
    for slot in np.flatnonzero(owner == c):
        if abs(m.stamp[c] - taken[slot]) < abs(delta):
            best, delta = int(slot), m.stamp[c] - taken[slot]
    if best != _NOW:
        reach += m.apart[c]
    return best, float(delta), bool(abs(delta) <= reach)


def is_due(m: Memory, c: int) -> bool:
    """Whether channel c is late and takes a reading at this tick; if so the next time is noted."""
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


def expire(m: Memory, c: int, owner: Array, taken: Array) -> None:
    """Free clones of channel c whose readings are lost, or that are older than the last one.

    owner (slots,) [-] and taken (slots,) [s]: channel and time of each clone.
    """
    old = (m.now[0] - taken > m.lag[c] + 2.0 * m.dt[0] + CONSTANTS.early) | (taken <= m.last[c] + CONSTANTS.early)
    owner[(owner == c) & old] = -1.0


def free_slot(owner: Array) -> int:
    """The first free one, -1 for none; owner (slots,) [-]."""
    free = np.flatnonzero(owner < 0)
    return int(free[0]) if len(free) else -1


def allowance(m: Memory, c: Channel) -> float:
    """Variance that the gate grants channel c for accelerations that the process model does not expect.

    Of what the robot can have done since the last reading that was believed; the gate is five standard deviations wide.
    """
    moved = m.agility[c] * unseen(m, c) ** ORDERS[c] / max(1, ORDERS[c])
    return float(moved * moved / 25.0)


def unseen(m: Memory, c: Channel) -> float:
    """Time [s] in which the robot can have done something else since the last reading of channel c that was believed."""
    return float(min(m.stamp[c] - m.used[c], CONSTANTS.longest_lag) + CONSTANTS.surprise)


def note(m: Memory, c: Channel, squared: float, degrees: int, *, believed: bool) -> None:
    """What became of the fresh reading of channel c: `squared` [-] and its degrees of freedom."""
    m.outcome[c] = m.stamp[c], squared, degrees, float(believed)
    if believed:
        m.used[c] = m.stamp[c]
