"""Kalman filters of the joints, one for each, as kernels.

The state of a joint is its position and its rate, driven by an acceleration that is white noise. In
its covariance there follow clones: predicted measurements of late channels at the times of readings
that have not arrived yet.
"""

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

_POSITIONS = int(filtering.ChannelIndex.JOINT_POSITIONS)
_RATES = int(filtering.ChannelIndex.JOINT_VELOCITIES)
_CLEAR_TRAVEL = 40.0  # travel in a tick, in deviations of the encoder, that is no noise for sure


def predict_joints(filter: FilterMemory) -> None:
    """Predict the states and covariances of all joints at the end of the tick."""
    n = _active(filter)
    for j in range(filter.n_joints):
        if filter.has_command:
            _follow_command(filter, j)
        if filter.dt > 0.0:
            _predict(filter, j, n)
            _bound(filter, j, 0)
            _bound(filter, j, 1)


def fuse_joints(filter: FilterMemory) -> None:
    """Fuse the fresh readings, then clone the present state for late channels."""
    update.space_clones(filter, _POSITIONS, filtering.N_JOINT_CHANNELS, JOINT_SLOTS)
    if _are_simultaneous(filter):
        for j in range(filter.n_joints):
            if _is_thrown(filter, j):
                _inflate_thrown(filter, j)
    for channel in range(_POSITIONS, filtering.N_JOINT_CHANNELS):
        if filter.fresh[channel] != 0.0:
            _ingest(filter, channel)
    for channel in range(_POSITIONS, filtering.N_JOINT_CHANNELS):
        if filter.lag[channel] > 0.0:
            update.free_expired(
                filter, channel, filter.joint_owner, filter.joint_taken, JOINT_SLOTS
            )
            if update.is_due(filter, channel):
                _clone(filter, channel)


def _active(filter: FilterMemory) -> int:
    """Return the number of rows of the covariances up to the last clone in use."""
    slot = JOINT_SLOTS - 1
    while slot >= 0 and filter.joint_owner[slot] < 0.0:
        slot -= 1
    return 3 + slot


def _follow_command(filter: FilterMemory, j: int) -> None:
    """Change the rate of joint j by as much as the commanded one has changed, with the variance of
    the response to it.
    """
    commanded_rate = filter.response[6 + j]
    change = commanded_rate - filter.commanded_rates[j]
    filter.joint_x[j][1] += change
    filter.joint_P[j][1][1] += vehicle_model.response_variance(filter, change)
    filter.commanded_rates[j] = commanded_rate


def _predict(filter: FilterMemory, j: int, n: int) -> None:
    """Predict state and covariance of joint j, whose first n rows are in use, by a constant rate:
    ``F P F' + Q``.
    """
    dt = filter.dt
    h = min(tuning.LONGEST_STEP, dt)
    density = filter.drive[filtering.ProcessNoise.JOINT]
    squared_density = density * density
    filter.joint_x[j][0] += h * filter.joint_x[j][1]
    for k in range(n):
        filter.joint_P[j][0][k] += h * filter.joint_P[j][1][k]
    for k in range(n):
        filter.joint_P[j][k][0] += h * filter.joint_P[j][k][1]
    filter.joint_P[j][0][0] += squared_density * (dt * dt * dt / 3.0)
    filter.joint_P[j][1][1] += squared_density * dt
    filter.joint_P[j][0][1] += squared_density * (dt * dt / 2.0)
    filter.joint_P[j][1][0] += squared_density * (dt * dt / 2.0)


def _bound(filter: FilterMemory, j: int, i: int) -> None:
    """Bound the variance of state i of joint j by the square of its `joint_limit`.

    A state that is not finite becomes 0 and uncorrelated. A position beyond the limit loses its
    correlations; a rate becomes 0 and keeps them, as clones still depend on it.
    """
    largest_variance = filter.joint_limit[i] * filter.joint_limit[i]
    variance = filter.joint_P[j][i][i]
    is_lost = not math.isfinite(filter.joint_x[j][i])
    if not is_lost and vehicle_model.is_determined(variance, largest_variance):
        return
    is_rate = i == 1
    is_regular = variance > 0.0 and math.isfinite(variance)
    if is_rate and is_regular and not is_lost:
        share = math.sqrt(largest_variance / variance)
        for k in range(JOINT_STATES):
            filter.joint_P[j][1][k] *= share
        for k in range(JOINT_STATES):
            filter.joint_P[j][k][1] *= share
        filter.joint_P[j][1][1] = largest_variance
    else:
        _clear(filter, j, i, largest_variance)
    if is_lost or is_rate:
        filter.joint_x[j][i] = 0.0


def _clear(filter: FilterMemory, j: int, i: int, variance: float) -> None:
    """Remove all correlations of state i of joint j, and set its variance."""
    for k in range(JOINT_STATES):
        filter.joint_P[j][i][k] = 0.0
        filter.joint_P[j][k][i] = 0.0
    filter.joint_P[j][i][i] = variance


def _are_simultaneous(filter: FilterMemory) -> bool:
    """Return whether fresh positions and fresh rates were both taken at this tick."""
    are_fresh = filter.fresh[_POSITIONS] != 0.0 and filter.fresh[_RATES] != 0.0
    are_on_time = filter.lag[_POSITIONS] <= 0.0 and filter.lag[_RATES] <= 0.0
    stamp = filter.stamp[_POSITIONS]
    return (
        are_fresh
        and are_on_time
        and abs(stamp - filter.stamp[_RATES]) <= tuning.EARLY
        and update.is_of_now(filter, _POSITIONS)
        and filter.now - stamp <= 0.5 * filter.dt
    )


def _is_thrown(filter: FilterMemory, j: int) -> bool:
    """Return whether a joint was thrown: its rate jumped, and its position went along with it."""
    position_innovation = filter.joint_value[0][j] - filter.joint_x[j][0]
    rate_innovation = filter.joint_value[1][j] - filter.joint_x[j][1]
    explained_travel = rate_innovation * max(filter.dt, filter.period[_POSITIONS])
    is_clear = abs(explained_travel) > _CLEAR_TRAVEL * filter.sigma[_POSITIONS]
    rate_variance = filter.joint_P[j][1][1] + filter.sigma[_RATES] * filter.sigma[_RATES]
    is_surprise = rate_innovation * rate_innovation > filter.gate[_RATES] * rate_variance
    return is_clear and is_surprise and goes_along(position_innovation, explained_travel)


def _inflate_thrown(filter: FilterMemory, j: int) -> None:
    """Add the squared innovations of a thrown joint to the variances of its position and rate, so
    that gates accept both readings.
    """
    position_innovation = filter.joint_value[0][j] - filter.joint_x[j][0]
    rate_innovation = filter.joint_value[1][j] - filter.joint_x[j][1]
    filter.joint_P[j][0][0] += position_innovation * position_innovation
    filter.joint_P[j][1][1] += rate_innovation * rate_innovation


def _ingest(filter: FilterMemory, channel: int) -> None:
    """Take in the fresh readings of a channel: a joint whose position is unknown is set to its
    reading, others go through the gate.
    """
    if not update.is_of_now(filter, channel):
        return
    for j in range(filter.n_joints):
        is_number = abs(filter.joint_value[channel - _POSITIONS][j]) <= tuning.LARGEST
        if not is_number:
            return
    filter.last[channel] = filter.stamp[channel]
    update.update_lag(filter, channel)
    n_initialised = 0
    largest_known = tuning.UNKNOWN * filter.joint_limit[0] * filter.joint_limit[0]
    for j in range(filter.n_joints):
        is_unknown = channel == _POSITIONS and filter.joint_P[j][0][0] > largest_known
        filter.joint_unknown[j] = is_unknown
        if is_unknown:
            _initialise(filter, j)
            n_initialised += 1
    if n_initialised > 0:
        _free_clones(filter, channel)
    if n_initialised == filter.n_joints:
        filter.used[channel] = filter.stamp[channel]
        return
    slot = update.nearest_clone(
        filter, channel, filter.joint_owner, filter.joint_taken, JOINT_SLOTS
    )
    if slot == update.NONE:
        return
    predicted_for = filter.now if slot < 0 else filter.joint_taken[slot]
    _gate(filter, channel, slot, filter.stamp[channel] - predicted_for)


def _initialise(filter: FilterMemory, j: int) -> None:
    """Set the position of joint j to its first reading, moved on by its rate since then."""
    age = filter.now - filter.stamp[_POSITIONS]
    sigma = filter.sigma[_POSITIONS]
    filter.joint_x[j][0] = filter.joint_value[0][j] + age * filter.joint_x[j][1]
    _clear(filter, j, 0, sigma * sigma + age * age * filter.joint_P[j][1][1])


def _free_clones(filter: FilterMemory, channel: int) -> None:
    """Free all clones of a channel."""
    for slot in range(JOINT_SLOTS):
        if filter.joint_owner[slot] == channel:
            filter.joint_owner[slot] = -1.0


def _gate(filter: FilterMemory, channel: int, slot: int, delta: float) -> None:
    """Gate the readings of the joints by their innovations, and correct the joints whose readings
    are accepted.

    slot: clone that they are compared with, -1 for the state of now. delta [s]: from its time to
    that of the readings.
    """
    k = channel - _POSITIONS
    row = k if slot < 0 else 2 + slot
    n = _active(filter)
    # Of a rate that is moved on by delta, an acceleration that is white noise adds to the noise.
    walk = 0.0
    if k != 0:
        density = filter.drive[filtering.ProcessNoise.JOINT]
        walk = density * density
    are_accepted = True
    degrees = 0
    total = 0.0
    surprise = 0.0
    for j in range(filter.n_joints):
        if filter.joint_unknown[j] != 0.0:
            filter.joint_since[k][j] = math.nan
            continue
        h = _predicted_measurement(filter, j, k, slot)
        h_rate = _measurement_rate(filter, j, k, slot)
        h_rate_variance = _measurement_rate_variance(filter, j, k, slot)
        R = (
            filter.sigma[channel] * filter.sigma[channel]
            + delta * delta * max(h_rate_variance, 0.0)
            + abs(delta) * walk
        )
        nu = filter.joint_value[k][j] - h - delta * h_rate
        S = filter.joint_P[j][row][row] + R
        granted = _granted_variance(filter, channel, h if k != 0 else h_rate)
        is_accepted = nu * nu <= filter.gate[channel] * (S + granted)
        total += nu * nu / S
        degrees += 1
        if is_accepted:
            filter.joint_since[k][j] = math.nan
            if nu * nu / S > filter.gate[channel]:
                surprise = max(surprise, abs(nu))
                _inflate_surprised(filter, j, channel, nu * nu)
        elif _is_consistent(filter, channel, j, nu, S + R + granted):
            is_accepted = True
            _relax(filter, j, channel, nu * nu)
        if is_accepted:
            _correct(filter, j, row, nu, R, n)
        are_accepted = are_accepted and is_accepted
    if are_accepted:
        filter.surprise[channel] = surprise
    update.record_outcome(filter, channel, total, degrees, are_accepted)


def _predicted_measurement(filter: FilterMemory, j: int, k: int, slot: int) -> float:
    """Return the predicted position (k = 0) or rate (k = 1) of joint j at a clone, -1 for now."""
    if slot < 0:
        return filter.joint_x[j][k]
    return filter.joint_h[j][slot]


def _measurement_rate(filter: FilterMemory, j: int, k: int, slot: int) -> float:
    """Return the derivative [per s] of `_predicted_measurement`; that of a rate is 0."""
    if slot >= 0:
        return filter.joint_rate[j][slot]
    if k == 0:
        return filter.joint_x[j][1]
    return 0.0


def _measurement_rate_variance(filter: FilterMemory, j: int, k: int, slot: int) -> float:
    """Return the variance of `_measurement_rate`."""
    if slot >= 0:
        return filter.joint_rate_variance[j][slot]
    if k == 0:
        return filter.joint_P[j][1][1]
    return 0.0


def _granted_variance(filter: FilterMemory, channel: int, rate: float) -> float:
    """Return the variance that the gate grants a joint that moves at a rate: for accelerations that
    are planned, for a stop, and for a jolt.
    """
    time = 1.0
    if channel == _POSITIONS:
        time = update.time_since_accepted(filter, channel)
    # The gate is five standard deviations wide.
    stop = abs(rate) * time / 5.0
    deviation = math.sqrt(update.planned_allowance(filter, channel)) + stop
    return max(deviation * deviation, update.jolt_allowance(filter, channel))


def _is_consistent(filter: FilterMemory, channel: int, j: int, nu: float, variance: float) -> bool:
    """Return whether a reading outside the gate agrees with those before it, for long enough.

    nu: its innovation. variance: of the change of innovations from one reading to the next.
    """
    since = filter.joint_since[channel - _POSITIONS]
    refused = filter.joint_refused[channel - _POSITIONS]
    change = nu - refused[j]
    agrees = math.isfinite(since[j]) and change * change <= filter.gate[channel] * variance
    if not agrees:
        since[j] = filter.stamp[channel]
    refused[j] = nu
    return agrees and filter.stamp[channel] - since[j] >= filter.recovery[channel] - tuning.EARLY


def _inflate_surprised(filter: FilterMemory, j: int, channel: int, squared: float) -> None:
    """Add the squared innovation to the variances of a joint that has moved as the process model did
    not expect.

    A jolt has made the rate wrong since the last accepted reading, so that the errors of position
    and rate are correlated. A position that is more than twice as far off as planned accelerations
    explain shows one, but only where positions come without delay and rates are not measured: less
    may come from an unknown delay.
    """
    time = update.time_since_accepted(filter, channel)
    since_accepted = max(filter.stamp[channel] - filter.used[channel], filter.dt)
    since_rates = filter.stamp[channel] - filter.used[_RATES]
    is_on_time = filter.lag[channel] <= 0.0
    is_without_rates = since_rates > filter.recovery[channel] / 2.0
    twice_planned_travel = 2.0 * filter.agility[channel] * time * since_accepted
    is_jolt = (
        channel == _POSITIONS
        and is_on_time
        and is_without_rates
        and math.sqrt(squared) > twice_planned_travel
    )
    _inflate_own(filter, j, channel, squared)
    if is_jolt:
        filter.joint_P[j][1][1] += squared / (since_accepted * since_accepted)
        filter.joint_P[j][0][1] += squared / since_accepted
        filter.joint_P[j][1][0] += squared / since_accepted
    elif channel == _POSITIONS:
        filter.joint_P[j][1][1] += squared / (time * time)


def _relax(filter: FilterMemory, j: int, channel: int, squared: float) -> None:
    """Add a multiple of the squared innovation to the variance of the state that a channel measures,
    which its readings contradict, and free the clones of the other channel.
    """
    for slot in range(JOINT_SLOTS):
        if filter.joint_owner[slot] != channel:
            filter.joint_owner[slot] = -1.0
    _inflate_own(filter, j, channel, tuning.GATE_RELAXATION * squared)
    filter.joint_since[channel - _POSITIONS][j] = math.nan


def _inflate_own(filter: FilterMemory, j: int, channel: int, variance: float) -> None:
    """Add a variance to the state of a joint that a channel measures, and, fully correlated, to the
    clones of that channel.
    """
    for a in range(JOINT_STATES):
        for b in range(JOINT_STATES):
            if _is_measured_by(filter, channel, a) and _is_measured_by(filter, channel, b):
                filter.joint_P[j][a][b] += variance


def _is_measured_by(filter: FilterMemory, channel: int, row: int) -> bool:
    """Return whether a row of the covariance is the state that a channel measures, or a clone of it."""
    if row >= 2:
        return filter.joint_owner[row - 2] == channel
    return row == channel - _POSITIONS


def _correct(filter: FilterMemory, j: int, row: int, nu: float, R: float, n: int) -> None:
    """Correct joint j and its clones by the Kalman update ``x + K nu``, ``P - K H P``.

    row: of the covariance that is measured, so that ``H P`` is that row. nu: innovation. R: variance
    of its noise. n: number of rows in use.
    """
    S = filter.joint_P[j][row][row] + R
    K = zeros(JOINT_STATES)
    HP = zeros(JOINT_STATES)
    for a in range(n):
        HP[a] = filter.joint_P[j][row][a]
        K[a] = filter.joint_P[j][a][row] / S
    for a in range(n):
        for b in range(n):
            filter.joint_P[j][a][b] -= K[a] * HP[b]
    for a in range(2):
        filter.joint_x[j][a] += K[a] * nu
    for slot in range(n - 2):
        filter.joint_h[j][slot] += K[2 + slot] * nu


def _clone(filter: FilterMemory, channel: int) -> None:
    """Clone the state that a channel measures into a free slot, for a reading that comes late."""
    slot = update.free_slot(filter.joint_owner, JOINT_SLOTS)
    if slot < 0:
        return
    k = channel - _POSITIONS
    row = 2 + slot
    filter.joint_owner[slot] = channel
    filter.joint_taken[slot] = filter.now
    for j in range(filter.n_joints):
        filter.joint_h[j][slot] = _predicted_measurement(filter, j, k, -1)
        filter.joint_rate[j][slot] = _measurement_rate(filter, j, k, -1)
        filter.joint_rate_variance[j][slot] = _measurement_rate_variance(filter, j, k, -1)
        filter.joint_P[j][row][:] = filter.joint_P[j][k]
        for a in range(JOINT_STATES):
            filter.joint_P[j][a][row] = filter.joint_P[j][a][k]
        filter.joint_P[j][row][row] = filter.joint_P[j][k][k]
