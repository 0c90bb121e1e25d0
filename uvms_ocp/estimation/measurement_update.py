"""Gate and fuse the readings of the vehicle, late ones by stochastic cloning, as kernels.

A late reading is compared with its clone and corrects it, the state of now and all other clones by
their covariances.
"""

from __future__ import annotations

import math

from uvms_ocp.codegen.kernel_layout import Vector, wide, zeros
from uvms_ocp.estimation import (
    filter_memory as filtering,
    tuning,
    vehicle_model as vehicle,
)
from uvms_ocp.estimation.filter_memory import (
    MAIN,
    N_CHANNELS,
    N_JOINT_CHANNELS,
    SLOTS,
    ChannelIndex,
    FilterMemory,
    Part,
)
from uvms_ocp.estimation.tuning import EARLY
from uvms_ocp.robot.kinematics import STEEP

# in place of a clone
NOW = -1
NONE = -2
_MOST_CLONES = 24.0  # of one channel; where more are needed they stand further apart
# [s] between two clones at least, for each time that an acceleration is integrated in what they see
_SPACING = 0.01
# by which a motion that surprised may surprise more, and [s] for how long
_OUTGROWN = 4.0
_FADING = 0.05
# gain of the share of the jerk, and largest squared innovation that counts
_ADAPTATION = 0.1
_MOST_ADAPTED = 20.0
_SHAKEN = 3.0  # [s] after a DVL that surprised for which fixes tell nothing of its bias
_SURPRISE = (
    0.05  # [s] for which the robot may have accelerated as it can before the process model notices
)
_LONGEST_UNSEEN = 0.07
"""[s] by which a gyro's lateness widens gates at most: 50 ms and a tick of 20 ms. One that comes to be
later is faulty, and no reason to believe attitudes that jump.
"""


def space_clones(filter: FilterMemory, first: int, last: int, slots: int) -> None:
    """Share the slots among the late ones of channels first to last: where all their readings do
    not fit, none has many.
    """
    n_clones = _MOST_CLONES
    total = slots + 1.0
    while n_clones > 2.0:
        total = 0.0
        for channel in range(first, last):
            if filter.lag[channel] > 0.0:
                # Clones at a time if every reading of a channel has one that is near enough.
                apart = max(
                    max(EARLY, _least(filter, channel)), max(filter.dt, filter.period[channel])
                )
                total += min((filter.lag[channel] + 2.0 * filter.dt) / apart + 1.0, n_clones)
        if total <= slots:
            break
        n_clones -= 1.0
    for channel in range(first, last):
        if filter.lag[channel] > 0.0:
            filter.apart[channel] = max(
                (filter.lag[channel] + 2.0 * filter.dt) / (n_clones - 1.0),
                max(_least(filter, channel), filter.period[channel]),
            )


def _least(filter: FilterMemory, channel: int) -> float:
    """Return the shortest time [s] between two clones of a channel: motion is smooth enough in
    between. Joints have no need to save.
    """
    if channel >= N_JOINT_CHANNELS:
        return _SPACING * filter.orders[channel]
    return 0.0


def is_of_now(filter: FilterMemory, channel: int) -> bool:
    """Return whether the fresh reading of a channel is newer than the last, and not of the
    future.
    """
    return filter.last[channel] < filter.stamp[channel] <= filter.now + EARLY


def update_lag(filter: FilterMemory, channel: int) -> None:
    """Remember how late the fresh reading of a channel is."""
    age = filter.now - filter.stamp[channel]
    if age > 1.5 * filter.dt + EARLY and age > filter.lag[channel]:
        filter.lag[channel] = min(tuning.LONGEST_LAG, age)


def nearest_clone(
    filter: FilterMemory, channel: int, owner: Vector, clone_times: Vector, slots: int
) -> int:
    """Return the clone for the fresh reading of a channel, `NOW` where it needs none, `NONE` where
    no clone is near enough.

    owner (slots,), clone_times (slots,) [s]: channel and time of each clone.
    """
    best = NOW
    nearest = abs(filter.stamp[channel] - filter.now)
    reach = 1.5 * filter.dt + EARLY
    for slot in range(slots):
        if owner[slot] == channel and abs(filter.stamp[channel] - clone_times[slot]) < nearest:
            best = slot
            nearest = abs(filter.stamp[channel] - clone_times[slot])
    if best >= 0:
        reach += filter.apart[channel]
    if nearest <= reach:
        return best
    return NONE


def is_due(filter: FilterMemory, channel: int) -> bool:
    """Return whether a channel is late and takes a reading at this tick; if so the next time is
    noted.
    """
    if filter.lag[channel] <= 0.0 or filter.now < filter.due[channel] - EARLY:
        return False
    apart = filter.apart[channel]
    period = filter.period[channel]
    phase = filter.last[channel] if math.isfinite(filter.last[channel]) else 0.0
    if apart <= filter.dt + EARLY:
        filter.due[channel] = filter.now
    elif period <= filter.dt:
        filter.due[channel] = filter.now + apart
    else:
        steps = math.floor((filter.now - phase) / period + 1e-6) + math.ceil(apart / period - 1e-6)
        filter.due[channel] = phase + steps * period
    return True


def free_expired(
    filter: FilterMemory, channel: int, owner: Vector, clone_times: Vector, slots: int
) -> None:
    """Free clones of a channel whose readings are lost, or that are older than the last one.

    owner (slots,), clone_times (slots,) [s]: channel and time of each clone.
    """
    for slot in range(slots):
        lost = filter.now - clone_times[slot] > filter.lag[channel] + 2.0 * filter.dt + EARLY
        if owner[slot] == channel and (lost or clone_times[slot] <= filter.last[channel] + EARLY):
            owner[slot] = -1.0


def free_slot(owner: Vector, slots: int) -> int:
    """Return the first free slot, `NOW` for none; owner (slots,): channel of each clone."""
    for slot in range(slots):
        if owner[slot] < 0.0:
            return slot
    return NOW


def time_since_accepted(filter: FilterMemory, channel: int) -> float:
    """Return the time [s] in which the robot can have done something else since the last reading of
    a channel that was believed.

    Of depths, since the last of a fix, too: both tell the height. Of a user's own channel since the
    last of a fix or a DVL, which tell what it reads.
    """
    used = filter.used[channel]
    if channel == ChannelIndex.DEPTH or channel >= N_CHANNELS:
        used = max(used, filter.used[ChannelIndex.POSITION])
    if channel >= N_CHANNELS:
        used = max(used, filter.used[ChannelIndex.LINEAR_VELOCITY])
    return min(tuning.LONGEST_LAG, max(filter.stamp[channel] - used, 0.0)) + _SURPRISE


def planned_allowance(filter: FilterMemory, channel: int) -> float:
    """Return the variance that the gate grants a channel for accelerations that the process model
    does not expect.

    Of what the robot can have planned since the last reading that was believed; the gate is five
    standard deviations wide. A velocity that nothing but the channel tells of is that of two
    readings ago.
    """
    moved = _moved(filter, channel, filter.agility[channel], time_since_accepted(filter, channel))
    if _is_place(channel) and _is_velocity_unseen(filter, channel):
        moved += (
            filter.agility[channel]
            * time_since_accepted(filter, channel)
            * 2.0
            * filter.period[channel]
        )
    return moved * moved / 25.0


def jolt_allowance(filter: FilterMemory, channel: int) -> float:
    """Return the variance that the gate grants a channel for a jolt that nobody planned: what it
    can move within one period, by weight and one thruster within one tick, or what is left of a motion
    that surprised.

    A jump that is larger is refused for as long as it lasts.
    """
    grown = (
        _OUTGROWN
        * filter.surprise[channel]
        * math.exp(-(filter.stamp[channel] - filter.used[channel]) / _FADING)
    )
    time = min(max(filter.dt, filter.period[channel]), tuning.JOLT_TIME)
    time += _unseen_turning_time(filter, channel)
    moved = max(grown, _moved(filter, channel, filter.jolt[channel], time))
    tick = filtering.pushed_time(filter.dt) + _unseen_turning_time(filter, channel)
    moved = max(moved, _moved(filter, channel, filter.push[channel], tick))
    if filter.jolt[channel] > 0.0:
        return moved * moved / 25.0
    return 0.0


def _unseen_turning_time(filter: FilterMemory, channel: int) -> float:
    """Return the time [s] in which the vehicle can have begun to turn before a late gyro shows it."""
    if channel == ChannelIndex.ATTITUDE or channel == ChannelIndex.ANGULAR_VELOCITY:
        return min(filter.lag[ChannelIndex.ANGULAR_VELOCITY], _LONGEST_UNSEEN)
    return 0.0


def _moved(filter: FilterMemory, channel: int, acceleration: float, time: float) -> float:
    """Return the change of what a channel reads under a constant acceleration for a time [s]."""
    for _ in range(filter.orders[channel]):
        acceleration *= time
    return acceleration / max(filter.orders[channel], 1)


def _is_velocity_unseen(filter: FilterMemory, channel: int) -> bool:
    """Return whether no DVL has been used for so long that a channel alone tells of the
    velocity.
    """
    return (
        filter.stamp[channel] - filter.used[ChannelIndex.LINEAR_VELOCITY]
        > filter.recovery[channel] / 2.0
    )


def _is_place(channel: int) -> bool:
    return channel == ChannelIndex.POSITION or channel == ChannelIndex.DEPTH


def record_outcome(
    filter: FilterMemory, channel: int, squared: float, degrees: int, believed: bool
) -> None:
    """Record the outcome for the fresh reading of a channel: `squared` and its degrees of
    freedom.
    """
    outcome = filter.outcome[channel]
    outcome[0] = filter.stamp[channel]
    outcome[1] = squared
    outcome[2] = degrees
    outcome[3] = believed
    if believed:
        filter.used[channel] = filter.stamp[channel]


# Readings of the vehicle's channels.


def fuse(filter: FilterMemory) -> None:
    """Fuse the fresh readings, then clone the present state for late channels."""
    space_clones(filter, N_JOINT_CHANNELS, len(filter.fresh), SLOTS)
    velocity = int(ChannelIndex.LINEAR_VELOCITY)
    if filter.now - filter.used[velocity] > filter.lag[velocity] + filter.recovery[velocity]:
        filter.jerk_share = 1.0  # nothing shows it any more
    if filter.fresh[velocity] != 0.0 and filter.outcome[velocity][1] > filter.gate[velocity]:
        # The reading before has made an acceleration, which this one may end: no fix is to blame a
        # bias for it.
        _ingest(filter, velocity)
    for channel in range(N_JOINT_CHANNELS, len(filter.fresh)):
        if filter.fresh[channel] != 0.0:
            _ingest(filter, channel)
    for channel in range(N_JOINT_CHANNELS, len(filter.fresh)):
        if filter.lag[channel] > 0.0:
            free_expired(filter, channel, filter.owner, filter.taken, SLOTS)
            if is_due(filter, channel):
                _clone(filter, channel)


def _corrected_by(channel: int) -> int:
    """Return the part that a channel alone can put right."""
    if channel == ChannelIndex.ATTITUDE:
        return Part.TURN
    if channel == ChannelIndex.ANGULAR_VELOCITY:
        return Part.SPIN
    if channel == ChannelIndex.LINEAR_VELOCITY:
        return Part.SPEED
    if channel == ChannelIndex.SPECIFIC_FORCE:
        return Part.ACCELERATION
    if channel == ChannelIndex.ALTIMETER_RANGE:
        return Part.FLOOR
    if channel == ChannelIndex.POSITION:
        return Part.PLACE
    return Part.PLACE + 2


def _is_blind(filter: FilterMemory, channel: int) -> bool:
    """Return whether a channel means nothing as the attitude is unknown, or a coordinate that a channel
    of a user's own depends on.
    """
    if channel >= N_CHANNELS:
        for i in range(3):
            if filter.of_place[channel][i] != 0 and vehicle.is_unknown(filter, Part.PLACE + i, 1):
                return True
    return channel >= ChannelIndex.LINEAR_VELOCITY and vehicle.is_unknown(filter, Part.TURN, 3)


def _is_uninitialised(filter: FilterMemory, channel: int) -> bool:
    """Return whether a channel's next reading is the first."""
    # Channels whose first reading is taken for the truth.
    absolute = (
        channel == ChannelIndex.ATTITUDE
        or channel == ChannelIndex.POSITION
        or channel == ChannelIndex.DEPTH
    )
    return (absolute or channel == ChannelIndex.ALTIMETER_RANGE) and vehicle.is_unknown(
        filter, _corrected_by(channel), filter.rows[channel]
    )


def _ingest(filter: FilterMemory, channel: int) -> None:
    if not _is_usable(filter, channel):
        return
    filter.last[channel] = filter.stamp[channel]
    if channel == ChannelIndex.ALTIMETER_RANGE and math.isnan(filter.value[channel][0]):
        filter.used[channel] = filter.stamp[channel]  # no echo is an answer too
        return
    update_lag(filter, channel)
    if _is_blind(filter, channel):
        return
    if _is_uninitialised(filter, channel):
        _initialise(filter, channel)
        return
    slot = nearest_clone(filter, channel, filter.owner, filter.taken, SLOTS)
    if slot != NONE:
        _gate(
            filter,
            channel,
            slot,
            filter.stamp[channel] - (filter.now if slot < 0 else filter.taken[slot]),
        )


def _is_usable(filter: FilterMemory, channel: int) -> bool:
    """Return whether the fresh reading is one: of a size that can be, newer than the last, not of
    the future.
    """
    value = filter.value[channel]
    if not is_of_now(filter, channel):
        return False
    if channel == ChannelIndex.ALTIMETER_RANGE:
        return math.isnan(value[0]) or 0.0 <= value[0] <= tuning.LARGEST
    for i in range(filter.rows[channel]):
        if not abs(value[i]) <= tuning.LARGEST:
            return False
    return channel != ChannelIndex.ATTITUDE or abs(vehicle.norm(value) - 1.0) <= 1e-3


def _initialise(filter: FilterMemory, channel: int) -> None:
    """Take the first reading for the truth, unless it is too old to be. Nothing that was cloned
    before can be right.
    """
    predicted = filter.predicted
    first = _corrected_by(channel)
    age = filter.now - filter.stamp[channel]
    value = filter.value[channel]
    moved = zeros(3)
    noise = filter.sigma[channel] * filter.sigma[channel]
    vehicle.predict_measurement(filter, channel, vehicle.active(filter))
    if (
        noise + vehicle.process_variance(filter, channel, age)
        > tuning.UNKNOWN * filter.limit[first] * filter.limit[first]
    ):
        return
    for slot in range(SLOTS):
        filter.owner[slot] = -1.0
    n = vehicle.active(filter)
    vehicle.predict_measurement(filter, channel, n)
    filter.used[channel] = filter.stamp[channel]
    if channel == ChannelIndex.ALTIMETER_RANGE:
        _set_floor(filter, age, n)
        return
    late = vehicle.process_variance(filter, channel, age)
    for i in range(3):
        moved[i] = age * predicted.rate[i] - age * age / 2.0 * vehicle.second_derivative(
            filter, channel, i
        )
    for i in range(filter.rows[channel]):
        vehicle.clear(filter, first + i, n, noise + late)
    if channel == ChannelIndex.ATTITUDE:
        size = vehicle.norm(value)
        for i in range(4):
            filter.turn[i] = value[i] / size
        vehicle.turn_by(filter.turn, moved)
        return
    for i in range(filter.rows[channel]):
        filter.x[first + i] = value[i] + moved[i]


def _set_floor(filter: FilterMemory, age: float, n: int) -> None:
    channel = int(ChannelIndex.ALTIMETER_RANGE)
    at = int(Part.FLOOR)
    predicted = filter.predicted
    R = zeros(9)
    row = filter.predicted.HP[0]
    cosine = predicted.h[1]
    arm = 0.0
    if cosine <= STEEP:
        return
    noise = cosine * filter.sigma[channel]
    vehicle.rotation(filter.turn, R)
    for i in range(3):
        arm += R[6 + i] * filter.beam_at[i]
    late = vehicle.process_variance(filter, channel, age)
    moved = age * predicted.rate[0] - age * age / 2.0 * vehicle.second_derivative(
        filter, channel, 0
    )
    filter.x[at] = filter.x[Part.PLACE + 2] + arm - (cosine * filter.value[channel][0] + moved)
    floor_variance = predicted.S[0][0] + 2.0 * row[at] + filter.P[at][at]
    for j in range(n):  # of the height of the altimeter
        row[j] += filter.P[j][at] if j < at else filter.P[at][j]
    for j in range(at):
        filter.P[j][at] = row[j]
    for j in range(at, n):
        filter.P[at][j] = row[j]
    filter.P[at][at] = floor_variance + noise * noise + late
    filter.echo = filter.stamp[channel]


def _gate(filter: FilterMemory, channel: int, slot: int, delta: float) -> None:
    """Gate a reading, and fuse it where it is consistent."""
    nu = zeros(3)
    rows = filter.rows[channel]
    predicted = filter.predicted
    vehicle.recall_measurement(filter, channel, slot, vehicle.active(filter))
    if channel == ChannelIndex.ALTIMETER_RANGE and predicted.h[1] <= STEEP:
        return
    _innovation(filter, channel, delta, nu)
    noise = _noise(filter, channel, delta)
    granted = max(planned_allowance(filter, channel), jolt_allowance(filter, channel))
    squared = _squared_innovation(filter, noise, rows, nu)
    size = nu[0] * nu[0] + nu[1] * nu[1] + nu[2] * nu[2]
    believed = _squared_innovation(filter, noise + granted, rows, nu) <= filter.gate[channel]
    # The estimate may be wrong where the channel contradicts it, but not the height, which fixes
    # tell too, nor what a user's own channel reads, which all others tell.
    not_by_others = channel < N_CHANNELS and (
        channel != ChannelIndex.DEPTH
        or filter.stamp[channel] - filter.used[ChannelIndex.POSITION] > filter.recovery[channel]
    )
    if believed:
        filter.since[channel] = math.nan
        if squared > filter.gate[channel]:
            filter.surprise[channel] = math.sqrt(size)
            if channel == ChannelIndex.LINEAR_VELOCITY:
                filter.shaken = filter.stamp[channel]
            _inflate_surprised(filter, channel, size, nu)
            vehicle.recall_measurement(filter, channel, slot, vehicle.active(filter))
        else:
            filter.surprise[channel] = 0.0
    elif (
        not_by_others
        and math.isfinite(squared)
        and math.isfinite(size)
        and _is_consistent(filter, channel, 2.0 * noise + granted, nu)
    ):
        believed = True
        _relax(filter, channel, size)
        vehicle.recall_measurement(filter, channel, slot, vehicle.active(filter))
    record_outcome(filter, channel, squared, rows, believed)
    if channel == ChannelIndex.LINEAR_VELOCITY:
        # Innovation-based adaptive estimation ([Mehra1972]): squared innovations per degree of
        # freedom have a mean of one where the process noise is right, and a vehicle that follows
        # its commands jerks less than vehicles can.
        change = _ADAPTATION * (min(squared / rows, _MOST_ADAPTED) - 1.0)
        filter.jerk_share = min(
            max(filter.jerk_share * math.exp(change), filter.least_jerk_share), 1.0
        )
    if believed:
        if channel == ChannelIndex.ALTIMETER_RANGE:
            filter.echo = filter.stamp[channel]
        _correct(filter, channel, nu, noise)


def _innovation(filter: FilterMemory, channel: int, delta: float, nu: Vector) -> None:
    """Compute the innovation (rows,): measured minus predicted measurement, which is carried on by
    delta [s].
    """
    predicted = filter.predicted
    value = filter.value[channel]
    if channel != ChannelIndex.ATTITUDE:
        scale = predicted.h[1] if channel == ChannelIndex.ALTIMETER_RANGE else 1.0
        for i in range(filter.rows[channel]):
            nu[i] = value[i] * scale - predicted.h[i] - delta * predicted.rate[i]
        return
    by = zeros(3)
    back = zeros(4)
    error = zeros(4)
    back[:4] = predicted.h[:4]
    for i in range(3):
        by[i] = delta * predicted.rate[i]
    vehicle.turn_by(back, by)
    for i in range(3):
        back[i] = -back[i]
    vehicle.multiply(back, value, error)
    scale = (-1.0 if error[3] < 0.0 else 1.0) / vehicle.norm(value)
    for i in range(4):
        error[i] *= scale
    sine = math.sqrt(error[0] * error[0] + error[1] * error[1] + error[2] * error[2])
    if sine > 1e-6:
        share = 2.0 * math.atan2(sine, error[3]) / sine
    else:
        share = 2.0
    for i in range(3):
        nu[i] = share * error[i]


def _noise(filter: FilterMemory, channel: int, delta: float) -> float:
    """Return the variance of the noise of each entry of a reading, with what joints add to it."""
    sigma = filter.sigma[channel] * (
        filter.predicted.h[1] if channel == ChannelIndex.ALTIMETER_RANGE else 1.0
    )
    walk = 0.0
    if channel == ChannelIndex.SPECIFIC_FORCE:
        walk = filter.drive[filtering.ProcessNoise.JERK] * filter.drive[filtering.ProcessNoise.JERK]
    return (
        sigma * sigma
        + delta * delta * max(filter.predicted.rate_variance, 0.0)
        + abs(delta) * walk
        + filter.joint_variance[channel]
    )


def _squared_innovation(filter: FilterMemory, more: float, n: int, nu: Vector) -> float:
    x = zeros(3)
    total = 0.0
    x[:n] = nu[:n]
    vehicle.factorise(filter.predicted, more, n)
    vehicle.divide(filter.predicted, n, x)
    for i in range(n):
        total += x[i] * x[i]
    return total


def _is_consistent(filter: FilterMemory, channel: int, more: float, nu: Vector) -> bool:
    """Return whether a reading outside the gate agrees with those before it, for long enough; a
    nearer floor needs no witness.
    """
    change = zeros(3)
    refused = filter.refused[channel]
    rows = filter.rows[channel]
    for i in range(rows):
        change[i] = nu[i] - refused[i]
    agrees = (
        math.isfinite(filter.since[channel])
        and _squared_innovation(filter, more, rows, change) <= filter.gate[channel]
    )
    if not agrees:
        filter.since[channel] = filter.stamp[channel]
    refused[:rows] = nu[:rows]
    if channel == ChannelIndex.ALTIMETER_RANGE and nu[0] < 0.0:
        return True
    return (
        agrees and filter.stamp[channel] - filter.since[channel] >= filter.recovery[channel] - EARLY
    )


def _relax(filter: FilterMemory, channel: int, squared: float) -> None:
    """Inflate the variance of the part that this channel alone observes, now and in its clones, by
    a common error.
    """
    for slot in range(SLOTS):
        if filter.owner[slot] != channel:
            filter.owner[slot] = -1.0
    filter.since[channel] = math.nan
    _inflate_own(filter, channel, tuning.GATE_RELAXATION * squared, 0.0, 0.0)
    if not _is_place(channel):
        return
    # It took the time of recovery to go so far: with a speed that nobody knew of, or an
    # acceleration.
    time = filter.recovery[channel]
    speed = min(tuning.EXPOSED * tuning.EXPOSED, tuning.GATE_RELAXATION * squared / (time * time))
    for i in range(_corrected_by(channel), _corrected_by(channel) + filter.rows[channel]):
        filter.P[i + 3][i + 3] += speed
        filter.P[i + 6][i + 6] += speed / (time * time)


def _inflate_surprised(filter: FilterMemory, channel: int, squared: float, nu: Vector) -> None:
    """Inflate the variances where the robot has moved as the process model did not expect, or what
    carries the estimate is biased.

    nu: the innovation, whose square is given too. The bias of DVLs is not in doubt by their own
    readings: fixes are too rough to find it again soon. Nor is it where these have surprised of
    late: what fixes contradict then is a velocity that was none.
    """
    if filter.orders[channel] > 1:
        time = time_since_accepted(filter, channel)
    else:
        time = 1.0
    if channel <= ChannelIndex.ANGULAR_VELOCITY:
        bias = int(Part.GYRO_BIAS)
    else:
        bias = int(Part.DVL_BIAS)
    if channel == ChannelIndex.LINEAR_VELOCITY:
        return  # which tells of accelerations, to go on with
    if channel >= N_CHANNELS:
        return  # what it reads, others tell too
    unseen = _unseen_turning_time(filter, channel)
    is_pushed = _is_pushed(filter, channel, squared, nu)
    growth = 0.0
    if _is_place(channel) and _is_velocity_unseen(filter, channel):
        growth = 1.0 / time
    if is_pushed:
        _inflate_own(filter, channel, squared, 0.0, filter.dt)
    else:
        _inflate_own(filter, channel, squared, growth, 0.0)
    if channel == ChannelIndex.ATTITUDE and unseen > 0.0:
        # A late gyro has not told of this turn yet: that is no bias of it.
        begun = unseen + filter.dt
        for i in range(int(Part.SPIN), int(Part.SPIN) + 3):
            filter.P[i][i] += squared / (begun * begun)
    elif _is_place(channel) and filter.stamp[channel] - filter.shaken <= _SHAKEN:
        if growth == 0.0:  # otherwise the velocity is in what the channel alone puts right
            for i in range(_corrected_by(channel), _corrected_by(channel) + filter.rows[channel]):
                filter.P[i + 3][i + 3] += squared / (time * time)
    elif channel <= ChannelIndex.DEPTH and not is_pushed:
        for i in range(bias, bias + 3):
            filter.P[i][i] += squared / (time * time)


def _is_pushed(filter: FilterMemory, channel: int, squared: float, nu: Vector) -> bool:
    """Return whether weight and one thruster, from one way to the other, turn the vehicle by as much as
    attitude or gyro surprise, nu (3,) [rad, rad/s], within one slow tick.

    A channel that surprises alone may be wrong: attitude and gyro both show a vehicle that speeds up.
    A gyro that is late tells of a turn before the attitude's.
    """
    gyro = int(ChannelIndex.ANGULAR_VELOCITY)
    if filter.lag[gyro] > 0.0:
        return False
    moved = 2.0 * _moved(filter, channel, filter.push[channel], filtering.pushed_time(filter.dt))
    in_one_tick = filter.stamp[channel] - filter.used[channel] <= 1.5 * filter.dt + EARLY
    if not (in_one_tick and channel <= gyro and 0.0 < squared <= moved * moved):
        return False
    if channel == gyro:
        attitude = int(ChannelIndex.ATTITUDE)
        is_recent = filter.now - filter.used[attitude] <= 1.5 * filter.dt + EARLY
        return is_recent and filter.surprise[attitude] > 0.0
    along = 0.0
    for i in range(3):
        expected = filter.x[Part.SPIN + i] + filter.x[Part.GYRO_BIAS + i]
        along += nu[i] * (filter.value[gyro][i] - expected)
    is_fresh = filter.fresh[gyro] != 0.0 and filter.now - filter.stamp[gyro] <= filter.dt + EARLY
    # Half of what an angular acceleration that has turned it so far has made of the rate.
    return is_fresh and along >= squared / filter.dt


def _inflate_own(
    filter: FilterMemory, channel: int, variance: float, rate: float, tick: float
) -> None:
    """Add a common error of a variance to what the channel alone can put right, now and in its
    clones.

    rate [1/s]: by which it has grown, where nothing but the channel tells of the velocity. tick [s]: in
    which an angular acceleration has made it, 0 for none.
    """
    rows = filter.rows[channel]
    n = vehicle.active(filter)
    first = _corrected_by(channel)
    R = zeros(9)
    predicted = filter.predicted
    if (
        channel == ChannelIndex.ANGULAR_VELOCITY
        and filter.used[ChannelIndex.ATTITUDE] - filter.used[channel]
        > filter.recovery[channel] / 2.0
    ):
        first = int(Part.GYRO_BIAS)  # the angular velocity follows from attitudes by now
    in_body = channel == ChannelIndex.LINEAR_VELOCITY or channel == ChannelIndex.SPECIFIC_FORCE
    vehicle.rotation(filter.turn, R)
    for i in range(3):
        for j in range(n):
            predicted.HP[i][j] = 0.0
    for i in range(rows):
        predicted.HP[i][first + i] = 1.0
        if rate > 0.0:
            predicted.HP[i][first + 3 + i] = rate
        if tick > 0.0 and first == Part.TURN:
            predicted.HP[i][Part.SPIN + i] = 2.0 / tick
            predicted.HP[i][Part.SPIN_UP + i] = 2.0 / (tick * tick)
        elif tick > 0.0 and first == Part.SPIN:
            predicted.HP[i][Part.SPIN_UP + i] = 1.0 / tick
    for slot in range(SLOTS):
        if filter.owner[slot] == channel:
            for i in range(rows):
                for j in range(rows):
                    if i != j:
                        correlation = 0.0
                    else:
                        correlation = -1.0 if channel == ChannelIndex.ALTIMETER_RANGE else 1.0
                    predicted.HP[j][MAIN + 3 * slot + i] = R[3 * j + i] if in_body else correlation
    u = predicted.HP[0]
    v = predicted.HP[1]
    w = predicted.HP[2]
    for i in range(n):
        for j in range(i, n):
            filter.P[i][j] += variance * (u[i] * u[j] + v[i] * v[j] + w[i] * w[j])


def _correct(filter: FilterMemory, channel: int, nu: Vector, noise: float) -> None:
    """Correct the state by the Kalman update. Echoes move the floor alone, and its clones: they do
    not tell where the vehicle is.
    """
    predicted = filter.predicted
    rows = filter.rows[channel]
    n = vehicle.active(filter)
    dx = filter.change
    u = predicted.HP[0]
    v = predicted.HP[1]
    w = predicted.HP[2]
    vehicle.factorise(predicted, noise, rows)
    vehicle.divide(predicted, rows, nu)
    for j in range(n):
        u[j] /= predicted.L[0][0]
    if rows == 1:
        for j in range(n):
            dx[j] = u[j] * nu[0]
        _lose_one(filter, u, n, channel == ChannelIndex.ALTIMETER_RANGE)
    else:
        if rows == 2:  # the third number is one that tells nothing
            nu[2] = 0.0
            for j in range(n):
                w[j] = 0.0
            predicted.L[2][0] = 0.0
            predicted.L[2][1] = 0.0
            predicted.L[2][2] = 1.0
        for j in range(n):
            v[j] = (v[j] - predicted.L[1][0] * u[j]) / predicted.L[1][1]
            w[j] = (w[j] - predicted.L[2][0] * u[j] - predicted.L[2][1] * v[j]) / predicted.L[2][2]
            dx[j] = u[j] * nu[0] + v[j] * nu[1] + w[j] * nu[2]
        _lose(filter, u, v, w, n)
    _apply(filter, dx)


@wide
def _lose(filter: FilterMemory, u: Vector, v: Vector, w: Vector, n: int) -> None:
    """Subtract the variance that a reading of three numbers takes away."""
    for i in range(n):
        row = filter.P[i]
        a = u[i]
        b = v[i]
        d = w[i]
        for j in range(i, n):
            row[j] -= a * u[j] + b * v[j] + d * w[j]


def _lose_one(filter: FilterMemory, u: Vector, n: int, floor: bool) -> None:
    """Subtract the variance that a reading of one number takes away; floor: of the floor and its
    clones alone.
    """
    for i in range(n):
        moved = not floor or _is_of_floor(filter, i)
        if not moved:
            filter.change[i] = 0.0
        for j in range(i, n):
            if moved or _is_of_floor(filter, j):
                filter.P[i][j] -= u[i] * u[j]


def _is_of_floor(filter: FilterMemory, i: int) -> bool:
    """Return whether an entry of the error state is the floor, or a clone of what sees it."""
    if i < MAIN:
        return i == Part.FLOOR
    return (i - MAIN) % 3 == 0 and filter.owner[(i - MAIN) // 3] == ChannelIndex.ALTIMETER_RANGE


def _apply(filter: FilterMemory, dx: Vector) -> None:
    vehicle.turn_by(filter.turn, dx)
    for i in range(int(Part.PLACE), MAIN):
        filter.x[i] += dx[i]
    for slot in range(SLOTS):
        channel = int(filter.owner[slot])
        h = filter.h[slot]
        change = zeros(3)
        if channel >= 0:
            for i in range(3):
                change[i] = dx[MAIN + 3 * slot + i]
            if channel == ChannelIndex.ATTITUDE:
                vehicle.turn_by(h, change)
            else:
                for i in range(filter.rows[channel]):
                    h[i] += change[i]


def _clone(filter: FilterMemory, channel: int) -> None:
    """Keep what a channel sees now, with its covariances, until its reading arrives."""
    predicted = filter.predicted
    slot = free_slot(filter.owner, SLOTS)
    before = vehicle.active(filter)
    rows = filter.rows[channel]
    if slot < 0 or _is_blind(filter, channel) or _is_uninitialised(filter, channel):
        return
    at = MAIN + 3 * slot
    vehicle.predict_measurement(filter, channel, before)
    filter.owner[slot] = channel
    filter.taken[slot] = filter.now
    filter.rate_variance[slot] = predicted.rate_variance
    filter.h[slot][:] = predicted.h
    filter.rate[slot][:] = predicted.rate
    n = vehicle.active(filter)
    for i in range(3):
        vehicle.clear(filter, at + i, n, 0.0)
        for j in range(before if i < rows else 0):
            if j < at:
                filter.P[j][at + i] = predicted.HP[i][j]
            else:
                filter.P[at + i][j] = predicted.HP[i][j]
    for i in range(rows):
        for j in range(i, rows):
            filter.P[at + i][at + j] = predicted.S[i][j]
