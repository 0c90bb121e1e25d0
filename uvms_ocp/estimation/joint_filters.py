"""Filter each joint by a Kalman filter of its own, as kernels."""

from __future__ import annotations

import math

from uvms_ocp.codegen.kernel_layout import zeros
from uvms_ocp.estimation import (
    filter_memory as filtering,
    measurement_update as update,
    tuning,
    vehicle_model,
)
from uvms_ocp.estimation.filter_memory import JOINT_SLOTS, JOINT_STATES, FilterMemory
from uvms_ocp.estimation.joint_travel import goes_along

_FIRST = int(filtering.ChannelIndex.JOINT_POSITIONS)
_CLEAR_WAY = 40.0  # way within a tick, in deviations of the encoder, that is no noise for sure


def predict_joints(filter: FilterMemory) -> None:
    """Predict the states and covariances of all joints at the end of the tick."""
    dt = filter.dt
    drive = filter.drive[filtering.ProcessNoise.JOINT] * filter.drive[filtering.ProcessNoise.JOINT]
    h = min(tuning.LONGEST_STEP, dt)
    n = _active(filter)
    for j in range(filter.n_joints):
        x = filter.joint_x[j]
        if filter.has_command:
            change = filter.response[6 + j] - filter.commanded_rates[j]
            x[1] += change
            filter.joint_P[j][1][1] += vehicle_model.response_variance(filter, change)
            filter.commanded_rates[j] = filter.response[6 + j]
        if not dt > 0.0:
            continue
        x[0] += h * x[1]
        for k in range(n):
            filter.joint_P[j][0][k] += h * filter.joint_P[j][1][k]
        for k in range(n):
            filter.joint_P[j][k][0] += h * filter.joint_P[j][k][1]
        filter.joint_P[j][0][0] += drive * (dt * dt * dt / 3.0)
        filter.joint_P[j][1][1] += drive * dt
        filter.joint_P[j][0][1] += drive * (dt * dt / 2.0)
        filter.joint_P[j][1][0] += drive * (dt * dt / 2.0)
        for i in range(2):
            _bound(filter, j, i)


def _active(filter: FilterMemory) -> int:
    """Count the rows of the covariances up to the last clone in use."""
    slot = JOINT_SLOTS - 1
    while slot >= 0 and filter.joint_owner[slot] < 0.0:
        slot -= 1
    return 3 + slot


def _bound(filter: FilterMemory, j: int, i: int) -> None:
    """Bound the variance of state i of joint j by `joint_limit`, which a state that is lost or
    unknown falls back to.
    """
    largest_variance = filter.joint_limit[i] * filter.joint_limit[i]
    lost = not math.isfinite(filter.joint_x[j][i])
    P = filter.joint_P[j][i][i]
    if not lost and vehicle_model.is_determined(P, largest_variance):
        return
    if i == 1 and not lost and P > 0.0 and math.isfinite(P):
        share = math.sqrt(largest_variance / P)
        for k in range(JOINT_STATES):
            filter.joint_P[j][1][k] *= share
        for k in range(JOINT_STATES):
            filter.joint_P[j][k][1] *= share
        filter.joint_P[j][1][1] = largest_variance
    else:
        _clear(filter, j, i, largest_variance)
    if lost or i == 1:
        filter.joint_x[j][i] = 0.0


def _clear(filter: FilterMemory, j: int, i: int, variance: float) -> None:
    """Set the variance of state i of joint j, uncorrelated with all others."""
    for k in range(JOINT_STATES):
        filter.joint_P[j][i][k] = 0.0
        filter.joint_P[j][k][i] = 0.0
    filter.joint_P[j][i][i] = variance


def fuse_joints(filter: FilterMemory) -> None:
    """Fuse the fresh readings, then clone the present state for late channels."""
    update.space_clones(filter, _FIRST, filtering.N_JOINT_CHANNELS, JOINT_SLOTS)
    if _are_of_one_time(filter):
        for j in range(filter.n_joints):
            if _is_thrown(filter, j):
                _expect_thrown(filter, j)
    for channel in range(_FIRST, filtering.N_JOINT_CHANNELS):
        if filter.fresh[channel] != 0.0:
            _ingest(filter, channel)
    for channel in range(_FIRST, filtering.N_JOINT_CHANNELS):
        if filter.lag[channel] > 0.0:
            update.free_expired(
                filter, channel, filter.joint_owner, filter.joint_taken, JOINT_SLOTS
            )
            if update.is_due(filter, channel):
                _clone(filter, channel)


def _are_of_one_time(filter: FilterMemory) -> bool:
    """Return whether fresh positions and fresh rates were both taken at this tick."""
    rates = _FIRST + 1
    return (
        filter.fresh[_FIRST] != 0.0
        and filter.fresh[rates] != 0.0
        and filter.lag[_FIRST] <= 0.0
        and filter.lag[rates] <= 0.0
        and abs(filter.stamp[_FIRST] - filter.stamp[rates]) <= tuning.EARLY
        and update.is_of_now(filter, _FIRST)
        and filter.now - filter.stamp[_FIRST] <= 0.5 * filter.dt
    )


def _is_thrown(filter: FilterMemory, j: int) -> bool:
    """Return whether a joint was thrown: its rate jumped, and its position went along with it."""
    rate_off = filter.joint_value[1][j] - filter.joint_x[j][1]
    way = rate_off * max(filter.dt, filter.period[_FIRST])
    off = filter.joint_value[0][j] - filter.joint_x[j][0]
    is_clear = abs(way) > _CLEAR_WAY * filter.sigma[_FIRST]
    variance = filter.joint_P[j][1][1] + filter.sigma[_FIRST + 1] * filter.sigma[_FIRST + 1]
    surprises = rate_off * rate_off > filter.gate[_FIRST + 1] * variance
    return is_clear and surprises and goes_along(off, way)


def _expect_thrown(filter: FilterMemory, j: int) -> None:
    """Inflate the variances of position and rate of a thrown joint by the squares of what their
    readings differ from the prediction.
    """
    off = filter.joint_value[0][j] - filter.joint_x[j][0]
    rate_off = filter.joint_value[1][j] - filter.joint_x[j][1]
    filter.joint_P[j][0][0] += off * off
    filter.joint_P[j][1][1] += rate_off * rate_off


def _ingest(filter: FilterMemory, channel: int) -> None:
    """Fuse the reading of a channel: joints that are unknown take it over, others are gated."""
    value = filter.joint_value[channel - _FIRST]
    count = 0
    limit = tuning.UNKNOWN * filter.joint_limit[0] * filter.joint_limit[0]
    if not update.is_of_now(filter, channel):
        return
    for j in range(filter.n_joints):
        if not abs(value[j]) <= tuning.LARGEST:
            return
    filter.last[channel] = filter.stamp[channel]
    update.update_lag(filter, channel)
    for j in range(filter.n_joints):
        filter.joint_unknown[j] = channel == _FIRST and filter.joint_P[j][0][0] > limit
        if filter.joint_unknown[j] != 0.0:
            # Take over the first reading.
            age = filter.now - filter.stamp[_FIRST]
            sigma = filter.sigma[_FIRST]
            filter.joint_x[j][0] = filter.joint_value[0][j] + age * filter.joint_x[j][1]
            _clear(filter, j, 0, sigma * sigma + age * age * filter.joint_P[j][1][1])
            count += 1
    for slot in range(JOINT_SLOTS if count > 0 else 0):
        if filter.joint_owner[slot] == channel:
            filter.joint_owner[slot] = -1.0
    slot = update.nearest_clone(
        filter, channel, filter.joint_owner, filter.joint_taken, JOINT_SLOTS
    )
    if count == filter.n_joints:
        filter.used[channel] = filter.stamp[channel]
    elif slot != update.NONE:
        _gate(
            filter,
            channel,
            slot,
            filter.stamp[channel] - (filter.now if slot < 0 else filter.joint_taken[slot]),
        )


def _predicted(filter: FilterMemory, j: int, k: int, slot: int) -> float:
    """Return the predicted measurement of channel k at the clone, -1 for now."""
    if slot < 0:
        return filter.joint_x[j][k]
    return filter.joint_h[j][slot]


def _rate(filter: FilterMemory, j: int, k: int, slot: int) -> float:
    """Return the rate of the predicted measurement [per s]."""
    present_rate = 0.0 if k != 0 else filter.joint_x[j][1]
    if slot < 0:
        return present_rate
    return filter.joint_rate[j][slot]


def _rate_variance(filter: FilterMemory, j: int, k: int, slot: int) -> float:
    """Return the variance of `_rate`."""
    present_variance = 0.0 if k != 0 else filter.joint_P[j][1][1]
    if slot < 0:
        return present_variance
    return filter.joint_rate_variance[j][slot]


def _gate(filter: FilterMemory, channel: int, slot: int, delta: float) -> None:
    """Gate the readings of the joints, and fuse those that are consistent."""
    k = channel - _FIRST
    n = _active(filter)
    accepted = True
    degrees = 0
    total = 0.0
    walk = 0.0
    surprise = 0.0
    state = k if slot < 0 else 2 + slot
    if k != 0:
        walk = (
            filter.drive[filtering.ProcessNoise.JOINT] * filter.drive[filtering.ProcessNoise.JOINT]
        )
    for j in range(filter.n_joints):
        if filter.joint_unknown[j] != 0.0:
            filter.joint_since[k][j] = math.nan
            continue
        variance = _rate_variance(filter, j, k, slot)
        h = _predicted(filter, j, k, slot)
        rate = _rate(filter, j, k, slot)
        R = (
            filter.sigma[channel] * filter.sigma[channel]
            + delta * delta * max(variance, 0.0)
            + abs(delta) * walk
        )
        nu = filter.joint_value[k][j] - h - delta * rate
        S = filter.joint_P[j][state][state] + R
        # Besides the planned accelerations, a joint that moves may stop.
        stop = abs(h if k != 0 else rate) * (
            update.time_since_accepted(filter, channel) if channel == _FIRST else 1.0
        )
        root = math.sqrt(update.planned_allowance(filter, channel)) + stop / 5.0
        granted = max(root * root, update.jolt_allowance(filter, channel))
        believed = nu * nu <= filter.gate[channel] * (S + granted)
        total += nu * nu / S
        degrees += 1
        if believed:
            filter.joint_since[k][j] = math.nan
            if nu * nu / S > filter.gate[channel]:
                surprise = max(surprise, abs(nu))
                _inflate_surprised(filter, j, channel, nu * nu)
        elif _is_consistent(filter, channel, j, nu, S + R + granted):
            believed = True
            _relax(filter, j, channel, nu * nu)
        if believed:
            _correct(filter, j, state, nu, R, n)
        accepted = accepted and believed
    filter.surprise[channel] = surprise if accepted else filter.surprise[channel]
    update.record_outcome(filter, channel, total, degrees, accepted)


def _is_consistent(filter: FilterMemory, channel: int, j: int, nu: float, S: float) -> bool:
    """Return whether a reading outside the gate agrees with those before it, for long enough."""
    since = filter.joint_since[channel - _FIRST]
    refused = filter.joint_refused[channel - _FIRST]
    change = nu - refused[j]
    agrees = math.isfinite(since[j]) and change * change <= filter.gate[channel] * S
    if not agrees:
        since[j] = filter.stamp[channel]
    refused[j] = nu
    return agrees and filter.stamp[channel] - since[j] >= filter.recovery[channel] - tuning.EARLY


def _inflate_surprised(filter: FilterMemory, j: int, channel: int, squared: float) -> None:
    """Inflate the variances of a joint that has moved as the process model did not expect.

    More than twice the way of a planned acceleration means a jolt right after the last reading that
    was believed, so that the rate was wrong since then. That is told only where positions come
    without delay and no rates are measured; less may come from an unknown delay.
    """
    time = update.time_since_accepted(filter, channel)
    since = max(filter.stamp[channel] - filter.used[channel], filter.dt)
    alone = (
        filter.lag[channel] <= 0.0
        and filter.stamp[channel] - filter.used[filtering.ChannelIndex.JOINT_VELOCITIES]
        > filter.recovery[channel] / 2.0
    )
    jolted = (
        channel == _FIRST
        and alone
        and math.sqrt(squared) > 2.0 * filter.agility[channel] * time * since
    )
    _inflate_own(filter, j, channel, squared)
    if channel == _FIRST:
        filter.joint_P[j][1][1] += squared / (since * since if jolted else time * time)
    if jolted:
        filter.joint_P[j][0][1] += squared / since
        filter.joint_P[j][1][0] += squared / since


def _relax(filter: FilterMemory, j: int, channel: int, squared: float) -> None:
    """Inflate the variances of the state and its clones, which are wrong by an unknown amount."""
    for slot in range(JOINT_SLOTS):
        if filter.joint_owner[slot] != channel:
            filter.joint_owner[slot] = -1.0
    _inflate_own(filter, j, channel, tuning.GATE_RELAXATION * squared)
    filter.joint_since[channel - _FIRST][j] = math.nan


def _inflate_own(filter: FilterMemory, j: int, channel: int, variance: float) -> None:
    """Add a variance to the state of a joint that a channel measures, and, fully correlated, to the
    clones of that channel.
    """
    for a in range(JOINT_STATES):
        for b in range(JOINT_STATES):
            if _is_of(filter, channel, a) and _is_of(filter, channel, b):
                filter.joint_P[j][a][b] += variance


def _is_of(filter: FilterMemory, channel: int, state: int) -> bool:
    """Return whether a state is the one that a channel measures, or a clone of that channel."""
    if state >= 2:
        return filter.joint_owner[state - 2] == channel
    return state == channel - _FIRST


def _correct(filter: FilterMemory, j: int, state: int, nu: float, R: float, n: int) -> None:
    """Correct the state of a joint by the Kalman update."""
    S = filter.joint_P[j][state][state] + R
    gain = zeros(JOINT_STATES)
    row = zeros(JOINT_STATES)
    for a in range(n):
        row[a] = filter.joint_P[j][state][a]
        gain[a] = filter.joint_P[j][a][state] / S
    for a in range(n):
        for b in range(n):
            filter.joint_P[j][a][b] -= gain[a] * row[b]
    for a in range(2):
        filter.joint_x[j][a] += gain[a] * nu
    for slot in range(n - 2):
        filter.joint_h[j][slot] += gain[2 + slot] * nu


def _clone(filter: FilterMemory, channel: int) -> None:
    """Clone the state that a channel measures into a free slot, for a reading that comes late."""
    slot = update.free_slot(filter.joint_owner, JOINT_SLOTS)
    k = channel - _FIRST
    if slot < 0:
        return
    at = 2 + slot
    filter.joint_owner[slot] = channel
    filter.joint_taken[slot] = filter.now
    for j in range(filter.n_joints):
        filter.joint_h[j][slot] = _predicted(filter, j, k, -1)
        filter.joint_rate[j][slot] = _rate(filter, j, k, -1)
        filter.joint_rate_variance[j][slot] = _rate_variance(filter, j, k, -1)
        filter.joint_P[j][at][:] = filter.joint_P[j][k]
        for a in range(JOINT_STATES):
            filter.joint_P[j][a][at] = filter.joint_P[j][a][k]
        filter.joint_P[j][at][at] = filter.joint_P[j][k][k]
