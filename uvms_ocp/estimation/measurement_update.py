"""Gate and fuse the readings of the vehicle, late ones by stochastic cloning, as kernels.

A late reading is compared with its clone and corrects it, the state of now and all other clones by
their covariances.
"""

from __future__ import annotations

import math

from uvms_ocp.codegen.kernel_layout import Vector, wide, zeros
from uvms_ocp.estimation import filter_memory as filtering, vehicle_model as vehicle
from uvms_ocp.estimation.filter_memory import (
    EARLY,
    MAIN,
    SLOTS,
    ChannelIndex,
    FilterMemory,
    Part,
    rows_of,
)
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
_SURPRISE = (
    0.05  # [s] for which the robot may have accelerated as it can before the process model notices
)


def space_clones(m: FilterMemory, first: int, last: int, slots: int) -> None:
    """Share the slots among the late ones of channels first to last: where all their readings do
    not fit, none has many.
    """
    n_clones = _MOST_CLONES
    total = slots + 1.0
    while n_clones > 2.0:
        total = 0.0
        for c in range(first, last):
            if m.lag[c] > 0.0:
                # Clones at a time if every reading of channel c has one that is near enough.
                apart = max(max(EARLY, _least(c)), max(m.dt, m.period[c]))
                total += min((m.lag[c] + 2.0 * m.dt) / apart + 1.0, n_clones)
        if total <= slots:
            break
        n_clones -= 1.0
    for c in range(first, last):
        if m.lag[c] > 0.0:
            m.apart[c] = max(
                (m.lag[c] + 2.0 * m.dt) / (n_clones - 1.0), max(_least(c), m.period[c])
            )


def _least(c: int) -> float:
    """[s] between two clones at least: motion is smooth enough in between. Joints have no need to
    save.
    """
    if c < filtering.N_VEHICLE:
        return _SPACING * filtering.orders_of(c)
    return 0.0


def is_of_now(m: FilterMemory, c: int) -> bool:
    """Return whether the fresh reading of channel c is newer than the last, and not of the
    future.
    """
    return m.last[c] < m.stamp[c] <= m.now + EARLY


def update_lag(m: FilterMemory, c: int) -> None:
    """Remember how late the fresh reading of channel c is."""
    age = m.now - m.stamp[c]
    if age > 1.5 * m.dt + EARLY and age > m.lag[c]:
        m.lag[c] = min(filtering.LONGEST_LAG, age)


def nearest_clone(m: FilterMemory, c: int, owner: Vector, clone_times: Vector, slots: int) -> int:
    """The clone for the fresh reading of channel c, `NOW` for none, `NONE` where what there is is
    not near enough.

    owner (slots,) and taken (slots,) [s]: channel and time of each clone.
    """
    best = NOW
    nearest = abs(m.stamp[c] - m.now)
    reach = 1.5 * m.dt + EARLY
    for slot in range(slots):
        if owner[slot] == c and abs(m.stamp[c] - clone_times[slot]) < nearest:
            best = slot
            nearest = abs(m.stamp[c] - clone_times[slot])
    if best >= 0:
        reach += m.apart[c]
    if nearest <= reach:
        return best
    return NONE


def is_due(m: FilterMemory, c: int) -> bool:
    """Return whether channel c is late and takes a reading at this tick; if so the next time is
    noted.
    """
    if m.lag[c] <= 0.0 or m.now < m.due[c] - EARLY:
        return False
    apart = m.apart[c]
    period = m.period[c]
    phase = m.last[c] if math.isfinite(m.last[c]) else 0.0
    if apart <= m.dt + EARLY:
        m.due[c] = m.now
    elif period <= m.dt:
        m.due[c] = m.now + apart
    else:
        steps = math.floor((m.now - phase) / period + 1e-6) + math.ceil(apart / period - 1e-6)
        m.due[c] = phase + steps * period
    return True


def free_expired(m: FilterMemory, c: int, owner: Vector, clone_times: Vector, slots: int) -> None:
    """Free clones of channel c whose readings are lost, or that are older than the last one.

    owner (slots,) and taken (slots,) [s]: channel and time of each clone.
    """
    for slot in range(slots):
        lost = m.now - clone_times[slot] > m.lag[c] + 2.0 * m.dt + EARLY
        if owner[slot] == c and (lost or clone_times[slot] <= m.last[c] + EARLY):
            owner[slot] = -1.0


def free_slot(owner: Vector, slots: int) -> int:
    """The first free one, `NOW` for none; owner (slots,)."""
    for slot in range(slots):
        if owner[slot] < 0.0:
            return slot
    return NOW


def time_since_accepted(m: FilterMemory, c: int) -> float:
    """Time [s] in which the robot can have done something else since the last reading of channel c
    that was believed.

    Of depths, since the last of a fix, too: both tell the height.
    """
    if c == ChannelIndex.DEPTH:
        used = max(m.used[c], m.used[ChannelIndex.POSITION])
    else:
        used = m.used[c]
    return min(filtering.LONGEST_LAG, max(m.stamp[c] - used, 0.0)) + _SURPRISE


def planned_allowance(m: FilterMemory, c: int) -> float:
    """Variance that the gate grants channel c for accelerations that the process model does not
    expect.

    Of what the robot can have planned since the last reading that was believed; the gate is five
    standard deviations wide. A velocity that nothing but the channel tells of is that of two
    readings ago.
    """
    moved = _moved(c, m.agility[c], time_since_accepted(m, c))
    if _is_place(c) and _is_velocity_unseen(m, c):
        moved += m.agility[c] * time_since_accepted(m, c) * 2.0 * m.period[c]
    return moved * moved / 25.0


def jolt_allowance(m: FilterMemory, c: int) -> float:
    """Variance that the gate grants channel c for a jolt that nobody planned: what it can move within
    one period, or what is left of a motion that surprised.

    A jump that is larger is refused for as long as it lasts.
    """
    grown = _OUTGROWN * m.surprise[c] * math.exp(-(m.stamp[c] - m.used[c]) / _FADING)
    moved = max(grown, _moved(c, m.jolt[c], min(max(m.dt, m.period[c]), filtering.JOLT_TIME)))
    if m.jolt[c] > 0.0:
        return moved * moved / 25.0
    return 0.0


def _moved(c: int, acceleration: float, time: float) -> float:
    """Return the change of what channel c reads under a constant acceleration for a time [s]."""
    for _ in range(filtering.orders_of(c)):
        acceleration *= time
    return acceleration / max(filtering.orders_of(c), 1)


def _is_velocity_unseen(m: FilterMemory, c: int) -> bool:
    """Return whether no DVL has been used for so long that channel c alone tells of the
    velocity.
    """
    return m.stamp[c] - m.used[ChannelIndex.LINEAR_VELOCITY] > m.recovery[c] / 2.0


def _is_place(c: int) -> bool:
    return c == ChannelIndex.POSITION or c == ChannelIndex.DEPTH


def record_outcome(m: FilterMemory, c: int, squared: float, degrees: int, believed: bool) -> None:
    """Record the outcome for the fresh reading of channel c: `squared` and its degrees of
    freedom.
    """
    outcome = m.outcome[c]
    outcome[0] = m.stamp[c]
    outcome[1] = squared
    outcome[2] = degrees
    outcome[3] = believed
    if believed:
        m.used[c] = m.stamp[c]


# Readings of the vehicle's channels.


def fuse(m: FilterMemory) -> None:
    """Use what is fresh, then clone what late channels see now."""
    space_clones(m, 0, filtering.N_VEHICLE, SLOTS)
    velocity = int(ChannelIndex.LINEAR_VELOCITY)
    if m.now - m.used[velocity] > m.lag[velocity] + m.recovery[velocity]:
        m.jerk_share = 1.0  # nothing shows it any more
    if m.fresh[velocity] != 0.0 and m.outcome[velocity][1] > m.gate[velocity]:
        # The reading before has made an acceleration, which this one may end: no fix is to blame a
        # bias for it.
        _ingest(m, velocity)
    for c in range(filtering.N_VEHICLE):
        if m.fresh[c] != 0.0:
            _ingest(m, c)
    for c in range(filtering.N_VEHICLE):
        if m.lag[c] > 0.0:
            free_expired(m, c, m.owner, m.taken, SLOTS)
            if is_due(m, c):
                _clone(m, c)


def _corrected_by(c: int) -> int:
    """Return the part that a channel alone can put right."""
    if c == ChannelIndex.ATTITUDE:
        return Part.TURN
    if c == ChannelIndex.ANGULAR_VELOCITY:
        return Part.SPIN
    if c == ChannelIndex.LINEAR_VELOCITY:
        return Part.SPEED
    if c == ChannelIndex.SPECIFIC_FORCE:
        return Part.ACCELERATION
    if c == ChannelIndex.ALTIMETER_RANGE:
        return Part.FLOOR
    if c == ChannelIndex.POSITION:
        return Part.PLACE
    return Part.PLACE + 2


def _is_blind(m: FilterMemory, c: int) -> bool:
    """Return whether a channel means nothing as the attitude is unknown."""
    return c >= ChannelIndex.LINEAR_VELOCITY and vehicle.is_unknown(m, Part.TURN, 3)


def _is_uninitialised(m: FilterMemory, c: int) -> bool:
    """Return whether a channel's next reading is the first."""
    # Channels whose first reading is taken for the truth.
    absolute = c == ChannelIndex.ATTITUDE or c == ChannelIndex.POSITION or c == ChannelIndex.DEPTH
    return (absolute or c == ChannelIndex.ALTIMETER_RANGE) and vehicle.is_unknown(
        m, _corrected_by(c), rows_of(c)
    )


def _ingest(m: FilterMemory, c: int) -> None:
    if not _is_usable(m, c):
        return
    m.last[c] = m.stamp[c]
    if c == ChannelIndex.ALTIMETER_RANGE and math.isnan(m.value[c][0]):
        m.used[c] = m.stamp[c]  # no echo is an answer too
        return
    update_lag(m, c)
    if _is_blind(m, c):
        return
    if _is_uninitialised(m, c):
        _initialise(m, c)
        return
    slot = nearest_clone(m, c, m.owner, m.taken, SLOTS)
    if slot != NONE:
        _gate(m, c, slot, m.stamp[c] - (m.now if slot < 0 else m.taken[slot]))


def _is_usable(m: FilterMemory, c: int) -> bool:
    """Return whether the fresh reading is one: of a size that can be, newer than the last, not of
    the future.
    """
    value = m.value[c]
    if not is_of_now(m, c):
        return False
    if c == ChannelIndex.ALTIMETER_RANGE:
        return math.isnan(value[0]) or 0.0 <= value[0] <= filtering.LARGEST
    for i in range(rows_of(c)):
        if not abs(value[i]) <= filtering.LARGEST:
            return False
    return c != ChannelIndex.ATTITUDE or abs(vehicle.norm(value) - 1.0) <= 1e-3


def _initialise(m: FilterMemory, c: int) -> None:
    """Take the first reading for the truth, unless it is too old to be. Nothing that was cloned
    before can be right.
    """
    s = m.predicted
    first = _corrected_by(c)
    age = m.now - m.stamp[c]
    value = m.value[c]
    moved = zeros(3)
    noise = m.sigma[c] * m.sigma[c]
    vehicle.predict_measurement(m, c, vehicle.active(m))
    if (
        noise + vehicle.process_variance(m, c, age)
        > filtering.UNKNOWN * m.limit[first] * m.limit[first]
    ):
        return
    for slot in range(SLOTS):
        m.owner[slot] = -1.0
    n = vehicle.active(m)
    vehicle.predict_measurement(m, c, n)
    m.used[c] = m.stamp[c]
    if c == ChannelIndex.ALTIMETER_RANGE:
        _set_floor(m, age, n)
        return
    late = vehicle.process_variance(m, c, age)
    for i in range(3):
        moved[i] = age * s.rate[i] - age * age / 2.0 * vehicle.second_derivative(m, c, i)
    for i in range(rows_of(c)):
        vehicle.clear(m, first + i, n, noise + late)
    if c == ChannelIndex.ATTITUDE:
        size = vehicle.norm(value)
        for i in range(4):
            m.turn[i] = value[i] / size
        vehicle.turn_by(m.turn, moved)
        return
    for i in range(rows_of(c)):
        m.x[first + i] = value[i] + moved[i]


def _set_floor(m: FilterMemory, age: float, n: int) -> None:
    c = int(ChannelIndex.ALTIMETER_RANGE)
    at = int(Part.FLOOR)
    s = m.predicted
    R = zeros(9)
    row = m.predicted.HP[0]
    cosine = s.h[1]
    arm = 0.0
    if cosine <= STEEP:
        return
    noise = cosine * m.sigma[c]
    vehicle.rotation(m.turn, R)
    for i in range(3):
        arm += R[6 + i] * m.beam_at[i]
    late = vehicle.process_variance(m, c, age)
    moved = age * s.rate[0] - age * age / 2.0 * vehicle.second_derivative(m, c, 0)
    m.x[at] = m.x[Part.PLACE + 2] + arm - (cosine * m.value[c][0] + moved)
    floor_variance = s.S[0][0] + 2.0 * row[at] + m.P[at][at]
    for j in range(n):  # of the height of the altimeter
        row[j] += m.P[j][at] if j < at else m.P[at][j]
    for j in range(at):
        m.P[j][at] = row[j]
    for j in range(at, n):
        m.P[at][j] = row[j]
    m.P[at][at] = floor_variance + noise * noise + late
    m.echo = m.stamp[c]


def _gate(m: FilterMemory, c: int, slot: int, delta: float) -> None:
    """Believe a reading or not, and use it."""
    nu = zeros(3)
    rows = rows_of(c)
    s = m.predicted
    vehicle.recall_measurement(m, c, slot, vehicle.active(m))
    if c == ChannelIndex.ALTIMETER_RANGE and s.h[1] <= STEEP:
        return
    _innovation(m, c, delta, nu)
    noise = _noise(m, c, delta)
    granted = max(planned_allowance(m, c), jolt_allowance(m, c))
    squared = _squared_innovation(m, noise, rows, nu)
    size = nu[0] * nu[0] + nu[1] * nu[1] + nu[2] * nu[2]
    believed = _squared_innovation(m, noise + granted, rows, nu) <= m.gate[c]
    # The estimate may be wrong where the channel contradicts it, but not the height, which fixes
    # tell too.
    not_by_fixes = (
        c != ChannelIndex.DEPTH or m.stamp[c] - m.used[ChannelIndex.POSITION] > m.recovery[c]
    )
    if believed:
        m.since[c] = math.nan
        if squared > m.gate[c]:
            m.surprise[c] = math.sqrt(size)
            _inflate_surprised(m, c, size)
            vehicle.recall_measurement(m, c, slot, vehicle.active(m))
        else:
            m.surprise[c] = 0.0
    elif (
        not_by_fixes
        and math.isfinite(squared)
        and math.isfinite(size)
        and _is_consistent(m, c, 2.0 * noise + granted, nu)
    ):
        believed = True
        _relax(m, c, size)
        vehicle.recall_measurement(m, c, slot, vehicle.active(m))
    record_outcome(m, c, squared, rows, believed)
    if c == ChannelIndex.LINEAR_VELOCITY:
        # Innovation-based adaptive estimation ([Mehra1972]): squared innovations per degree of
        # freedom have a mean of one where the process noise is right, and a vehicle that follows
        # its commands jerks less than vehicles can.
        change = _ADAPTATION * (min(squared / rows, _MOST_ADAPTED) - 1.0)
        m.jerk_share = min(max(m.jerk_share * math.exp(change), m.least_jerk_share), 1.0)
    if believed:
        if c == ChannelIndex.ALTIMETER_RANGE:
            m.echo = m.stamp[c]
        _correct(m, c, nu, noise)


def _innovation(m: FilterMemory, c: int, delta: float, nu: Vector) -> None:
    """Measured minus predicted, which is carried on by delta [s], (rows,)."""
    s = m.predicted
    value = m.value[c]
    if c != ChannelIndex.ATTITUDE:
        scale = s.h[1] if c == ChannelIndex.ALTIMETER_RANGE else 1.0
        for i in range(rows_of(c)):
            nu[i] = value[i] * scale - s.h[i] - delta * s.rate[i]
        return
    by = zeros(3)
    back = zeros(4)
    error = zeros(4)
    back[:4] = s.h[:4]
    for i in range(3):
        by[i] = delta * s.rate[i]
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


def _noise(m: FilterMemory, c: int, delta: float) -> float:
    """Variance of every entry of the reading."""
    sigma = m.sigma[c] * (m.predicted.h[1] if c == ChannelIndex.ALTIMETER_RANGE else 1.0)
    walk = 0.0
    if c == ChannelIndex.SPECIFIC_FORCE:
        walk = m.drive[filtering.ProcessNoise.JERK] * m.drive[filtering.ProcessNoise.JERK]
    return sigma * sigma + delta * delta * max(m.predicted.rate_variance, 0.0) + abs(delta) * walk


def _squared_innovation(m: FilterMemory, more: float, n: int, nu: Vector) -> float:
    x = zeros(3)
    total = 0.0
    x[:n] = nu[:n]
    vehicle.factorise(m.predicted, more, n)
    vehicle.divide(m.predicted, n, x)
    for i in range(n):
        total += x[i] * x[i]
    return total


def _is_consistent(m: FilterMemory, c: int, more: float, nu: Vector) -> bool:
    """Return whether a reading outside the gate agrees with those before it, for long enough; a
    nearer floor needs no witness.
    """
    change = zeros(3)
    refused = m.refused[c]
    rows = rows_of(c)
    for i in range(rows):
        change[i] = nu[i] - refused[i]
    agrees = math.isfinite(m.since[c]) and _squared_innovation(m, more, rows, change) <= m.gate[c]
    if not agrees:
        m.since[c] = m.stamp[c]
    refused[:rows] = nu[:rows]
    if c == ChannelIndex.ALTIMETER_RANGE and nu[0] < 0.0:
        return True
    return agrees and m.stamp[c] - m.since[c] >= m.recovery[c] - EARLY


def _relax(m: FilterMemory, c: int, squared: float) -> None:
    """Inflate the variance of the part that this channel alone observes, now and in its clones, by
    a common error.
    """
    for slot in range(SLOTS):
        if m.owner[slot] != c:
            m.owner[slot] = -1.0
    m.since[c] = math.nan
    _inflate_own(m, c, filtering.GATE_RELAXATION * squared, 0.0)
    if not _is_place(c):
        return
    # It took the time of recovery to go so far: with a speed that nobody knew of, or an
    # acceleration.
    time = m.recovery[c]
    speed = min(
        filtering.EXPOSED * filtering.EXPOSED, filtering.GATE_RELAXATION * squared / (time * time)
    )
    for i in range(_corrected_by(c), _corrected_by(c) + rows_of(c)):
        m.P[i + 3][i + 3] += speed
        m.P[i + 6][i + 6] += speed / (time * time)


def _inflate_surprised(m: FilterMemory, c: int, squared: float) -> None:
    """The robot has done what it can and the process model did not expect, or what carries the
    estimate is biased.

    The bias of DVLs is not in doubt by their own readings: fixes are too rough to find it again
    soon.
    """
    if filtering.orders_of(c) > 1:
        time = time_since_accepted(m, c)
    else:
        time = 1.0
    if c <= ChannelIndex.ANGULAR_VELOCITY:
        bias = int(Part.GYRO_BIAS)
    else:
        bias = int(Part.DVL_BIAS)
    if c == ChannelIndex.LINEAR_VELOCITY:
        return  # which tells of accelerations, to go on with
    _inflate_own(m, c, squared, 1.0 / time if _is_place(c) and _is_velocity_unseen(m, c) else 0.0)
    if c <= ChannelIndex.DEPTH:
        for i in range(bias, bias + 3):
            m.P[i][i] += squared / (time * time)


def _inflate_own(m: FilterMemory, c: int, variance: float, rate: float) -> None:
    """An error of that variance of what the channel alone can put right, now and in its clones.

    rate [1/s]: by which it has grown, where nothing but the channel tells of the velocity.
    """
    rows = rows_of(c)
    n = vehicle.active(m)
    first = _corrected_by(c)
    R = zeros(9)
    s = m.predicted
    if (
        c == ChannelIndex.ANGULAR_VELOCITY
        and m.used[ChannelIndex.ATTITUDE] - m.used[c] > m.recovery[c] / 2.0
    ):
        first = int(Part.GYRO_BIAS)  # the angular velocity follows from attitudes by now
    in_body = c == ChannelIndex.LINEAR_VELOCITY or c == ChannelIndex.SPECIFIC_FORCE
    vehicle.rotation(m.turn, R)
    for i in range(3):
        for j in range(n):
            s.HP[i][j] = 0.0
    for i in range(rows):
        s.HP[i][first + i] = 1.0
        if rate > 0.0:
            s.HP[i][first + 3 + i] = rate
    for slot in range(SLOTS):
        if m.owner[slot] == c:
            for i in range(rows):
                for j in range(rows):
                    if i != j:
                        correlation = 0.0
                    else:
                        correlation = -1.0 if c == ChannelIndex.ALTIMETER_RANGE else 1.0
                    s.HP[j][MAIN + 3 * slot + i] = R[3 * j + i] if in_body else correlation
    u = s.HP[0]
    v = s.HP[1]
    w = s.HP[2]
    for i in range(n):
        for j in range(i, n):
            m.P[i][j] += variance * (u[i] * u[j] + v[i] * v[j] + w[i] * w[j])


def _correct(m: FilterMemory, c: int, nu: Vector, noise: float) -> None:
    """The Kalman update. Echoes move the floor alone, and its clones: they are no means to tell
    where the vehicle is.
    """
    s = m.predicted
    rows = rows_of(c)
    n = vehicle.active(m)
    dx = m.change
    u = s.HP[0]
    v = s.HP[1]
    w = s.HP[2]
    vehicle.factorise(s, noise, rows)
    vehicle.divide(s, rows, nu)
    for j in range(n):
        u[j] /= s.L[0][0]
    if rows == 1:
        for j in range(n):
            dx[j] = u[j] * nu[0]
        _lose_one(m, u, n, c == ChannelIndex.ALTIMETER_RANGE)
    else:
        for j in range(n):
            v[j] = (v[j] - s.L[1][0] * u[j]) / s.L[1][1]
            w[j] = (w[j] - s.L[2][0] * u[j] - s.L[2][1] * v[j]) / s.L[2][2]
            dx[j] = u[j] * nu[0] + v[j] * nu[1] + w[j] * nu[2]
        _lose(m, u, v, w, n)
    _apply(m, dx)


@wide
def _lose(m: FilterMemory, u: Vector, v: Vector, w: Vector, n: int) -> None:
    """The loss of variance of a reading of three numbers."""
    for i in range(n):
        row = m.P[i]
        a = u[i]
        b = v[i]
        d = w[i]
        for j in range(i, n):
            row[j] -= a * u[j] + b * v[j] + d * w[j]


def _lose_one(m: FilterMemory, u: Vector, n: int, floor: bool) -> None:
    """The loss of variance of a reading of one number; floor: on the floor and its clones alone."""
    for i in range(n):
        moved = not floor or _is_of_floor(m, i)
        if not moved:
            m.change[i] = 0.0
        for j in range(i, n):
            if moved or _is_of_floor(m, j):
                m.P[i][j] -= u[i] * u[j]


def _is_of_floor(m: FilterMemory, i: int) -> bool:
    """Return whether an entry of the error state is the floor, or a clone of what sees it."""
    if i < MAIN:
        return i == Part.FLOOR
    return (i - MAIN) % 3 == 0 and m.owner[(i - MAIN) // 3] == ChannelIndex.ALTIMETER_RANGE


def _apply(m: FilterMemory, dx: Vector) -> None:
    vehicle.turn_by(m.turn, dx)
    for i in range(int(Part.PLACE), MAIN):
        m.x[i] += dx[i]
    for slot in range(SLOTS):
        c = int(m.owner[slot])
        h = m.h[slot]
        change = zeros(3)
        if c >= 0:
            for i in range(3):
                change[i] = dx[MAIN + 3 * slot + i]
            if c == ChannelIndex.ATTITUDE:
                vehicle.turn_by(h, change)
            else:
                for i in range(rows_of(c)):
                    h[i] += change[i]


def _clone(m: FilterMemory, c: int) -> None:
    """Keep what channel c sees now, with its covariances, until its reading arrives."""
    s = m.predicted
    slot = free_slot(m.owner, SLOTS)
    before = vehicle.active(m)
    rows = rows_of(c)
    if slot < 0 or _is_blind(m, c) or _is_uninitialised(m, c):
        return
    at = MAIN + 3 * slot
    vehicle.predict_measurement(m, c, before)
    m.owner[slot] = c
    m.taken[slot] = m.now
    m.rate_variance[slot] = s.rate_variance
    m.h[slot][:] = s.h
    m.rate[slot][:] = s.rate
    n = vehicle.active(m)
    for i in range(3):
        vehicle.clear(m, at + i, n, 0.0)
        for j in range(before if i < rows else 0):
            if j < at:
                m.P[j][at + i] = s.HP[i][j]
            else:
                m.P[at + i][j] = s.HP[i][j]
    for i in range(rows):
        for j in range(i, rows):
            m.P[at + i][at + j] = s.S[i][j]
