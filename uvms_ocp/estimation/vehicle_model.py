"""Process model and measurement models of the vehicle in the Kalman filter, as kernels.

The covariance of the errors is kept in its upper triangle; what is lost (not finite) or unknown
falls back to its limits.
"""

from __future__ import annotations

import math

from uvms_ocp.codegen.kernel_layout import Vector, wide, zeros
from uvms_ocp.estimation import filter_memory as filtering, tuning
from uvms_ocp.estimation.filter_memory import (
    MAIN,
    ChannelIndex,
    FilterMemory,
    Part,
    PredictedMeasurement,
    ProcessNoise,
)
from uvms_ocp.robot.channels import LARGEST_OWN
from uvms_ocp.robot.kinematics import STEEP
from uvms_ocp.robot.shapes.gjk import rotated

# Rotations: matrices row by row, quaternions xyzw, vectors from an entry of theirs on.


def rotation(q: Vector, R: Vector) -> None:
    """Write the rotation matrix of the quaternion q (4,) into R (9,)."""
    x = q[0]
    y = q[1]
    z = q[2]
    w = q[3]
    R[0] = 1.0 - 2.0 * (y * y + z * z)
    R[1] = 2.0 * (x * y - w * z)
    R[2] = 2.0 * (x * z + w * y)
    R[3] = 2.0 * (x * y + w * z)
    R[4] = 1.0 - 2.0 * (x * x + z * z)
    R[5] = 2.0 * (y * z - w * x)
    R[6] = 2.0 * (x * z - w * y)
    R[7] = 2.0 * (y * z + w * x)
    R[8] = 1.0 - 2.0 * (x * x + y * y)


def rotate_back(R: Vector, x: Vector, at: int, y: Vector) -> None:
    """Compute y (3,) = R' x, of three entries of x from `at` on."""
    for i in range(3):
        y[i] = R[i] * x[at] + R[3 + i] * x[at + 1] + R[6 + i] * x[at + 2]


def cross(a: Vector, at: int, b: Vector, c: Vector) -> None:
    """Compute c (3,) = a x b, of three entries of a from `at` on."""
    c[0] = a[at + 1] * b[2] - a[at + 2] * b[1]
    c[1] = a[at + 2] * b[0] - a[at] * b[2]
    c[2] = a[at] * b[1] - a[at + 1] * b[0]


def multiply(a: Vector, b: Vector, c: Vector) -> None:
    """Compute c = a b of quaternions (4,); c may be a."""
    x = a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1]
    y = a[3] * b[1] + a[1] * b[3] + a[2] * b[0] - a[0] * b[2]
    z = a[3] * b[2] + a[2] * b[3] + a[0] * b[1] - a[1] * b[0]
    w = a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2]
    c[0] = x
    c[1] = y
    c[2] = z
    c[3] = w


def norm(q: Vector) -> float:
    """Return the norm of q (4,)."""
    return math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])


def normalize(q: Vector) -> None:
    """Give q (4,) norm 1."""
    size = norm(q)
    for i in range(4):
        q[i] /= size


def turn_by(q: Vector, by: Vector) -> None:
    """Turn the quaternion q (4,) by a rotation vector (3,) [rad] in its own frame, and give it norm
    1.
    """
    squared = by[0] * by[0] + by[1] * by[1] + by[2] * by[2]
    angle = math.sqrt(squared)
    e = zeros(4)
    if angle > 1e-4:
        share = math.sin(angle / 2.0) / angle
    else:
        share = 0.5 - squared / 48.0
    for i in range(3):
        e[i] = share * by[i]
    e[3] = math.cos(angle / 2.0)
    multiply(q, e, q)
    normalize(q)


def turn_maps(angle: Vector, E: Vector, J: Vector) -> None:
    """Compute E = exp(-angle) and J, the right Jacobian of exp at the angle (3,) [rad]; (9,)
    each.
    """
    squared = angle[0] * angle[0] + angle[1] * angle[1] + angle[2] * angle[2]
    size = math.sqrt(squared)
    K = zeros(9)
    sine = 1.0 - squared / 6.0 + squared * squared / 120.0
    cosine = 0.5 - squared / 24.0 + squared * squared / 720.0
    third = 1.0 / 6.0 - squared / 120.0 + squared * squared / 5040.0
    if size >= 1e-2:
        sine = math.sin(size) / size
        cosine = (1.0 - math.cos(size)) / squared
        third = (size - math.sin(size)) / (squared * size)
    K[1] = -angle[2]
    K[2] = angle[1]
    K[3] = angle[2]
    K[5] = -angle[0]
    K[6] = -angle[1]
    K[7] = angle[0]
    for i in range(3):
        for j in range(3):
            K2 = angle[i] * angle[j] - (squared if i == j else 0.0)
            identity = 1.0 if i == j else 0.0
            E[3 * i + j] = identity - sine * K[3 * i + j] + cosine * K2
            J[3 * i + j] = identity - cosine * K[3 * i + j] + third * K2


# The covariance: its entries, and what is done to one of them.


def active(filter: FilterMemory) -> int:
    """Return the number of rows of the covariance that are in use."""
    slot = filtering.SLOTS - 1
    while slot >= 0 and filter.owner[slot] < 0.0:
        slot -= 1
    return MAIN + 3 * (slot + 1)


def clear(filter: FilterMemory, i: int, n: int, variance: float) -> None:
    """Remove all correlations of entry i with the first n entries, and set its variance [square of
    its unit].
    """
    for j in range(i):
        filter.P[j][i] = 0.0
    for j in range(i, n):
        filter.P[i][j] = 0.0
    filter.P[i][i] = variance


def _limit_to(filter: FilterMemory, i: int, n: int, variance: float) -> None:
    """Reduce the variance of entry i and keep its correlations: clones whose readings are on their
    way still depend on it.
    """
    share = math.sqrt(variance / filter.P[i][i])
    for j in range(i):
        filter.P[j][i] *= share
    for j in range(i, n):
        filter.P[i][j] *= share
    filter.P[i][i] = variance


def is_unknown(filter: FilterMemory, first: int, n: int) -> bool:
    """Return whether any of n entries of the error state is unknown, from the first on."""
    unknown = False
    for i in range(first, first + n):
        unknown = unknown or filter.P[i][i] > tuning.UNKNOWN * filter.limit[i] * filter.limit[i]
    return unknown


def mean_variance(filter: FilterMemory, first: int) -> float:
    """Return the mean variance of three entries of the error state."""
    return (
        filter.P[first][first] + filter.P[first + 1][first + 1] + filter.P[first + 2][first + 2]
    ) / 3.0


def is_determined(variance: float, largest: float) -> bool:
    """Check whether a variance is between zero and the largest [square of a unit, both]; rounding may
    have made it negative.
    """
    return 0.0 <= variance <= largest


def response_variance(filter: FilterMemory, change: float) -> float:
    """Return the variance of a velocity after a tick in which the commanded one made a change [m/s,
    rad/s]: the faster the change, the less closely it is followed.

    The error has the time constant of the response and a standard deviation in proportion to the
    commanded acceleration, so that it is a share of a step, however that is divided into ticks.
    """
    drive = filter.drive[ProcessNoise.REPLY] * change
    if filter.dt > 0.0:
        return drive * drive / filter.dt
    return 0.0


# The process model: constant jerk, in the W of positions and the B of rotations.


def predict(filter: FilterMemory) -> None:
    """Predict state and covariance at the end of the tick."""
    if filter.has_command:
        _follow(filter)
    dt = filter.dt
    angle = zeros(3)
    E = zeros(9)
    J = zeros(9)
    hJ = zeros(9)
    hhJ = zeros(9)
    if not dt > 0.0:
        return
    h = min(tuning.LONGEST_STEP, dt)
    n = active(filter)
    for i in range(3):
        angle[i] = h * filter.x[Part.SPIN + i] + h * h / 2.0 * filter.x[Part.SPIN_UP + i]
    turn_maps(angle, E, J)
    for i in range(1, MAIN):
        for j in range(i):
            filter.P[i][j] = filter.P[j][i]
    for i in range(9):
        hJ[i] = h * J[i]
        hhJ[i] = h * h / 2.0 * J[i]
    _move_rows(filter, n, h, E, hJ, hhJ)
    _move_columns(filter, h, E, hJ, hhJ)
    _diffuse(filter, dt, J)
    _forget_unknown(filter, n)
    turn_by(filter.turn, angle)
    for i in range(3):
        filter.x[Part.PLACE + i] += (
            h * filter.x[Part.SPEED + i] + h * h / 2.0 * filter.x[Part.ACCELERATION + i]
        )
        filter.x[Part.SPEED + i] += h * filter.x[Part.ACCELERATION + i]
        filter.x[Part.SPIN + i] += h * filter.x[Part.SPIN_UP + i]


def _follow(filter: FilterMemory) -> None:
    """Change the estimated velocity by as much as the commanded one has changed."""
    R = zeros(9)
    commanded = zeros(3)
    rotation(filter.turn, R)
    rotated(R, filter.response, commanded)
    for i in range(3):
        if filter.guided:
            _change(filter, Part.SPEED + i, commanded[i] - filter.commanded_W[i])
        _change(filter, Part.SPIN + i, filter.response[3 + i] - filter.commanded_spin[i])
        filter.commanded_W[i] = commanded[i]
        filter.commanded_spin[i] = filter.response[3 + i]


def _change(filter: FilterMemory, i: int, change: float) -> None:
    """Add a commanded change to entry i of the state, with the variance of the response to it."""
    filter.x[i] += change
    filter.P[i][i] += response_variance(filter, change)


@wide
def _move_rows(filter: FilterMemory, n: int, h: float, E: Vector, hJ: Vector, hhJ: Vector) -> None:
    """Compute the rows of F P, columns 0 to n, in which turns have E and h J and h^2 J / 2."""
    half = h * h / 2.0
    t = zeros(3)
    for j in range(n):
        for i in range(3):
            t[i] = 0.0
            for k in range(3):
                t[i] += (
                    E[3 * i + k] * filter.P[Part.TURN + k][j]
                    + hJ[3 * i + k] * filter.P[Part.SPIN + k][j]
                    + hhJ[3 * i + k] * filter.P[Part.SPIN_UP + k][j]
                )
        for i in range(3):
            filter.P[Part.TURN + i][j] = t[i]
    for i in range(3):
        for j in range(n):
            filter.P[Part.PLACE + i][j] += (
                h * filter.P[Part.SPEED + i][j] + half * filter.P[Part.ACCELERATION + i][j]
            )
            filter.P[Part.SPEED + i][j] += h * filter.P[Part.ACCELERATION + i][j]
            filter.P[Part.SPIN + i][j] += h * filter.P[Part.SPIN_UP + i][j]


def _move_columns(filter: FilterMemory, h: float, E: Vector, hJ: Vector, hhJ: Vector) -> None:
    """Move the columns of the vehicle's own block of the covariance by the model."""
    half = h * h / 2.0
    t = zeros(3)
    for j in range(MAIN):
        row = filter.P[j]
        for i in range(3):
            t[i] = 0.0
            for k in range(3):
                t[i] += (
                    E[3 * i + k] * row[Part.TURN + k]
                    + hJ[3 * i + k] * row[Part.SPIN + k]
                    + hhJ[3 * i + k] * row[Part.SPIN_UP + k]
                )
        for i in range(3):
            row[Part.TURN + i] = t[i]
            row[Part.PLACE + i] += h * row[Part.SPEED + i] + half * row[Part.ACCELERATION + i]
            row[Part.SPEED + i] += h * row[Part.ACCELERATION + i]
            row[Part.SPIN + i] += h * row[Part.SPIN_UP + i]


def _diffuse(filter: FilterMemory, dt: float, J: Vector) -> None:
    """Add what the driving noise does in a tick, which J turns with the vehicle."""
    dt2 = dt * dt
    jerk = filter.jerk_share * filter.drive[ProcessNoise.JERK]
    spin = filter.drive[ProcessNoise.ANGULAR_JERK]
    # Covariance (3, 3), row by row, of a value and its two derivatives, driven by white noise in the
    # third one for a tick.
    third = zeros(9)
    third[0] = dt2 * dt2 * dt / 20.0
    third[1] = dt2 * dt2 / 8.0
    third[2] = dt2 * dt / 6.0
    third[4] = dt2 * dt / 3.0
    third[5] = dt2 / 2.0
    third[8] = dt
    jerk *= jerk
    spin *= spin
    for i in range(3):
        for a in range(3):
            for b in range(a, 3):
                filter.P[Part.PLACE + 3 * a + i][Part.PLACE + 3 * b + i] += jerk * third[3 * a + b]
        for j in range(3):
            JJ = J[3 * i] * J[3 * j] + J[3 * i + 1] * J[3 * j + 1] + J[3 * i + 2] * J[3 * j + 2]
            if j >= i:
                filter.P[Part.TURN + i][Part.TURN + j] += spin * third[0] * JJ
            filter.P[Part.TURN + i][Part.SPIN + j] += spin * third[1] * J[3 * i + j]
            filter.P[Part.TURN + i][Part.SPIN_UP + j] += spin * third[2] * J[3 * i + j]
        filter.P[Part.SPIN + i][Part.SPIN + i] += spin * third[4]
        filter.P[Part.SPIN + i][Part.SPIN_UP + i] += spin * third[5]
        filter.P[Part.SPIN_UP + i][Part.SPIN_UP + i] += spin * third[8]
        for k in range(3):
            drift = filter.drive[ProcessNoise.GYRO + k]
            at = Part.GYRO_BIAS + 3 * k + i
            filter.P[at][at] += dt * drift * drift
    filter.P[Part.FLOOR][Part.FLOOR] += dt * _relief(filter)


def _relief(filter: FilterMemory) -> float:
    """Return the variance [m2/s] of the floor that passes below the altimeter."""
    R = zeros(9)
    arm = zeros(3)
    velocity = zeros(3)
    rough, settling = filter.drive[ProcessNoise.ROUGHNESS], filter.drive[ProcessNoise.SETTLING]
    rotation(filter.turn, R)
    cross(filter.x, Part.SPIN, filter.beam_at, arm)
    rotated(R, arm, velocity)
    for i in range(2):
        velocity[i] += filter.x[Part.SPEED + i]
    return settling * settling + rough * rough * (
        velocity[0] * velocity[0] + velocity[1] * velocity[1]
    )


def _forget_unknown(filter: FilterMemory, n: int) -> None:
    """Bound variances by `limit`, and reset entries that are not finite; parts that a reading can
    set lose their correlations.
    """
    for i in range(MAIN):
        largest_variance = filter.limit[i] * filter.limit[i]
        lost = not math.isfinite(norm(filter.turn) if i < Part.PLACE else filter.x[i])
        if not lost and is_determined(filter.P[i][i], largest_variance):
            continue
        if (
            not lost
            and Part.SPEED <= i < Part.FLOOR
            and filter.P[i][i] > 0.0
            and math.isfinite(filter.P[i][i])
        ):
            _limit_to(filter, i, n, largest_variance)
        else:
            clear(filter, i, n, largest_variance)
        if i >= Part.PLACE and (lost or Part.SPEED <= i < Part.GYRO_BIAS):
            filter.x[i] = 0.0
    if not math.isfinite(norm(filter.turn)):
        for i in range(4):
            filter.turn[i] = 1.0 if i == 3 else 0.0


def inflate_velocity_variance(filter: FilterMemory, rests: bool) -> None:
    """Inflate the variance of the linear velocity to that of any motion that vehicles make.

    The velocity is taken to have been wrong for `EXPOSED_FOR`, and the position that was integrated
    from it with it: were the position right, the next fix would be explained by the velocity of the
    last tick alone. rests: the velocity was right until its readings ended; velocity and
    acceleration are zero from now on, as extrapolation without readings leads ever farther astray.
    """
    variance = tuning.EXPOSED * tuning.EXPOSED
    way = tuning.EXPOSED_FOR
    for k in range(len(filter.owner)):
        filter.owner[k] = -1.0
    for i in range(3):
        place = Part.PLACE + i
        speed = Part.SPEED + i
        acceleration = Part.ACCELERATION + i
        filter.P[speed][speed] += variance
        if rests:
            filter.P[acceleration][acceleration] += variance
            filter.x[speed] = filter.x[acceleration] = 0.0
        else:
            filter.P[place][speed] += way * variance
            filter.P[place][place] += way * way * variance


# What each channel of the vehicle sees of the estimate.


def predict_measurement(filter: FilterMemory, channel: int, n: int) -> None:
    """Predict the measurement of a channel now, with its covariances with the first n errors."""
    predicted = filter.predicted
    rows = filter.rows[channel]
    _model(filter, predicted, channel)
    for i in range(rows):
        for j in range(n):
            predicted.HP[i][j] = 0.0
        for k in range(MAIN):
            h = predicted.H[i][k]
            if h != 0.0:
                for j in range(k):
                    predicted.HP[i][j] += h * filter.P[j][k]
                for j in range(k, n):
                    predicted.HP[i][j] += h * filter.P[k][j]
    for i in range(rows):
        for j in range(rows):
            predicted.S[i][j] = 0.0
            for k in range(MAIN):
                predicted.S[i][j] += predicted.HP[i][k] * predicted.H[j][k]


def _model(filter: FilterMemory, predicted: PredictedMeasurement, channel: int) -> None:
    for i in range(3):
        predicted.rate[i] = 0.0
        for k in range(MAIN):
            predicted.H[i][k] = 0.0
    for i in range(4):
        predicted.h[i] = filter.turn[i] if channel == ChannelIndex.ATTITUDE else 0.0
    if channel == ChannelIndex.ATTITUDE:
        _see(filter, predicted, Part.TURN, Part.SPIN)
    elif channel == ChannelIndex.ANGULAR_VELOCITY:
        for i in range(3):
            predicted.h[i] = filter.x[Part.SPIN + i] + filter.x[Part.GYRO_BIAS + i]
            predicted.H[i][Part.GYRO_BIAS + i] = 1.0
        _see(filter, predicted, Part.SPIN, Part.SPIN_UP)
    elif channel == ChannelIndex.POSITION:
        for i in range(3):
            predicted.h[i] = filter.x[Part.PLACE + i]
        _see(filter, predicted, Part.PLACE, Part.SPEED)
    elif channel == ChannelIndex.DEPTH:
        predicted.h[0] = filter.x[Part.PLACE + 2]
        predicted.rate[0] = filter.x[Part.SPEED + 2]
        predicted.H[0][Part.PLACE + 2] = 1.0
        predicted.rate_variance = filter.P[Part.SPEED + 2][Part.SPEED + 2]
    elif channel == ChannelIndex.ALTIMETER_RANGE:
        _see_floor(filter, predicted)
    elif channel >= filtering.N_CHANNELS:
        _see_by_own_function(filter, predicted, channel)
    else:
        _see_in_body(filter, predicted, channel == ChannelIndex.SPECIFIC_FORCE)


def _see(filter: FilterMemory, predicted: PredictedMeasurement, part: int, rate: int) -> None:
    """Predict the measurement of a part of the state, whose rate is another part."""
    predicted.rate_variance = mean_variance(filter, rate)
    for i in range(3):
        predicted.rate[i] = filter.x[rate + i]
        predicted.H[i][part + i] = 1.0


def _see_in_body(filter: FilterMemory, predicted: PredictedMeasurement, force: bool) -> None:
    """Predict the measurement of the velocity in B, or of the specific force."""
    if force:
        velocity_part = int(Part.ACCELERATION)
        bias = int(Part.FORCE_BIAS)
    else:
        velocity_part = int(Part.SPEED)
        bias = int(Part.DVL_BIAS)
    R = zeros(9)
    v = zeros(3)
    in_B = zeros(3)
    rate = zeros(3)
    turning = zeros(3)
    rotation(filter.turn, R)
    for i in range(3):
        v[i] = filter.x[velocity_part + i] - (filter.gravity[i] if force else 0.0)
    rotate_back(R, v, 0, in_B)
    rotate_back(R, filter.x, Part.ACCELERATION, rate)
    cross(filter.x, Part.SPIN, in_B, turning)
    predicted.H[0][Part.TURN + 1] = -in_B[2]
    predicted.H[0][Part.TURN + 2] = in_B[1]
    predicted.H[1][Part.TURN] = in_B[2]
    predicted.H[1][Part.TURN + 2] = -in_B[0]
    predicted.H[2][Part.TURN] = -in_B[1]
    predicted.H[2][Part.TURN + 1] = in_B[0]
    for i in range(3):
        for j in range(3):
            predicted.H[i][velocity_part + j] = R[3 * j + i]
        predicted.H[i][bias + i] = 1.0
        predicted.h[i] = in_B[i] + filter.x[bias + i]
        predicted.rate[i] = (0.0 if force else rate[i]) - turning[i]
    size = in_B[0] * in_B[0] + in_B[1] * in_B[1] + in_B[2] * in_B[2]
    if force:
        predicted.rate_variance = mean_variance(filter, Part.SPIN) * size
    else:
        predicted.rate_variance = mean_variance(filter, Part.ACCELERATION)


def _see_floor(filter: FilterMemory, predicted: PredictedMeasurement) -> None:
    """Predict the altitude of the altimeter above the floor, and the cosine of the tilt of its
    beam.
    """
    R = zeros(9)
    down = zeros(3)
    arm = zeros(3)
    tilt = zeros(3)
    cosine = 0.0
    altitude = filter.x[Part.PLACE + 2] - filter.x[Part.FLOOR]
    rotation(filter.turn, R)
    for i in range(3):
        down[i] = R[6 + i]
        cosine += down[i] * filter.beam_up[i]
        altitude += down[i] * filter.beam_at[i]
    cross(filter.beam_at, 0, down, arm)
    cross(filter.beam_up, 0, down, tilt)
    for i in range(3):
        predicted.H[0][Part.TURN + i] = arm[i] - (
            altitude / cosine * tilt[i] if abs(cosine) > STEEP else 0.0
        )
    predicted.H[0][Part.PLACE + 2] = 1.0
    predicted.H[0][Part.FLOOR] = -1.0
    predicted.h[0] = altitude
    predicted.h[1] = cosine
    predicted.rate[0] = filter.x[Part.SPEED + 2]
    predicted.rate_variance = filter.P[Part.SPEED + 2][Part.SPEED + 2]


def _see_by_own_function(
    filter: FilterMemory, predicted: PredictedMeasurement, channel: int
) -> None:
    """Predict the measurement of a channel of a user's own, the variance that joints add to it, and
    how fast it can come to change.
    """
    first = LARGEST_OWN * (channel - filtering.N_CHANNELS)
    linear = filter.agility[ChannelIndex.POSITION]
    angular = filter.agility[ChannelIndex.ATTITUDE]
    of_joints = filter.agility[ChannelIndex.JOINT_POSITIONS]
    for j in range(filter.n_joints):
        filter.joint_state[j] = filter.joint_x[j][0]
        filter.joint_state[filter.n_joints + j] = filter.joint_x[j][1]
    filter.measure(
        filter.turn,
        filter.x,
        filter.joint_state,
        filter.own_h,
        filter.own_H,
        filter.own_rate,
        filter.own_joint_H,
    )
    predicted.rate_variance = 0.0
    filter.joint_variance[channel] = 0.0
    filter.agility[channel] = 0.0
    is_place = filter.orders[channel] > 1
    for i in range(filter.rows[channel]):
        row = first + i
        H = predicted.H[i]
        rate_variance = 0.0
        joint_variance = 0.0
        agility = 0.0
        predicted.h[i] = filter.own_h[row]
        predicted.rate[i] = filter.own_rate[row]
        for k in range(MAIN):
            H[k] = filter.own_H[MAIN * row + k]
        for k in range(3):
            turn = H[Part.TURN + k] * H[Part.TURN + k]
            place = H[Part.PLACE + k] * H[Part.PLACE + k]
            speed = H[Part.SPEED + k] * H[Part.SPEED + k]
            spin = H[Part.SPIN + k] * H[Part.SPIN + k]
            rate_variance += turn * filter.P[Part.SPIN + k][Part.SPIN + k]
            rate_variance += place * filter.P[Part.SPEED + k][Part.SPEED + k]
            rate_variance += speed * filter.P[Part.ACCELERATION + k][Part.ACCELERATION + k]
            rate_variance += spin * filter.P[Part.SPIN_UP + k][Part.SPIN_UP + k]
            if is_place:
                agility += place * linear * linear + turn * angular * angular
            else:
                agility += speed * linear * linear + spin * angular * angular
        for j in range(filter.n_joints):
            by_joint = filter.own_joint_H[filter.n_joints * row + j]
            joint_variance += by_joint * by_joint * filter.joint_P[j][0][0]
            rate_variance += by_joint * by_joint * filter.joint_P[j][1][1]
            agility += by_joint * by_joint * of_joints * of_joints
        predicted.rate_variance = max(predicted.rate_variance, rate_variance)
        filter.joint_variance[channel] = max(filter.joint_variance[channel], joint_variance)
        filter.agility[channel] = max(filter.agility[channel], math.sqrt(agility))


def recall_measurement(filter: FilterMemory, channel: int, slot: int, n: int) -> None:
    """Predict the measurement of a channel at the time of a clone, -1 for now."""
    if slot < 0:
        predict_measurement(filter, channel, n)
        return
    predicted = filter.predicted
    at = MAIN + 3 * slot
    predicted.h[:] = filter.h[slot]
    predicted.rate[:] = filter.rate[slot]
    predicted.rate_variance = filter.rate_variance[slot]
    for i in range(filter.rows[channel]):
        for j in range(at + i):
            predicted.HP[i][j] = filter.P[j][at + i]
        for j in range(at + i, n):
            predicted.HP[i][j] = filter.P[at + i][j]
        for j in range(filter.rows[channel]):
            predicted.S[i][j] = filter.P[min(at + i, at + j)][max(at + i, at + j)]


def factorise(predicted: PredictedMeasurement, more: float, n: int) -> None:
    """Find the lower Cholesky factor of S with `more` [square of its unit] added to its diagonal;
    pivots that rounding makes smaller than `more` are set to it.
    """
    for j in range(n):
        for i in range(j, n):
            total = predicted.S[i][j] + (more if i == j else 0.0)
            for k in range(j):
                total -= predicted.L[i][k] * predicted.L[j][k]
            if i == j:
                predicted.L[i][j] = math.sqrt(more if total < more else total)
            else:
                predicted.L[i][j] = total / predicted.L[j][j]


def divide(predicted: PredictedMeasurement, n: int, x: Vector) -> None:
    """Divide x (n,) by the lower factor, in place."""
    for i in range(n):
        for k in range(i):
            x[i] -= predicted.L[i][k] * x[k]
        x[i] /= predicted.L[i][i]


def second_derivative(filter: FilterMemory, channel: int, i: int) -> float:
    """Return entry i of the second derivative of the part of the state that a channel sets."""
    if channel == ChannelIndex.ATTITUDE:
        return filter.x[Part.SPIN_UP + i]
    return filter.x[Part.ACCELERATION + (i if filter.rows[channel] == 3 else 2)]


def process_variance(filter: FilterMemory, channel: int, age: float) -> float:
    """Return the variance of the change of a measurement since a reading of an age [s]."""
    turns = channel == ChannelIndex.ATTITUDE
    squared = age * age
    drive = filter.drive[ProcessNoise.ANGULAR_JERK if turns else ProcessNoise.JERK]
    second = mean_variance(filter, Part.SPIN_UP if turns else Part.ACCELERATION)
    rate = squared * filter.predicted.rate_variance
    return rate + squared * squared / 4.0 * second + drive * drive * squared * squared * age / 20.0
