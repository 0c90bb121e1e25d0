"""Process model and measurement models of the vehicle in its error-state Kalman filter, as kernels.

Entries of the state are in the order of `Part`. Only the upper triangle of the covariance P counts.
A state that is not finite, or whose variance is beyond its limit, is reset to unknown.
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
from uvms_ocp.robot.shapes.gjk import rotate

# Rotations: matrices (9,) row after row, quaternions (4,) in the order xyzw.


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
    """Compute y (3,) = R' x[at : at + 3]."""
    for i in range(3):
        y[i] = R[i] * x[at] + R[3 + i] * x[at + 1] + R[6 + i] * x[at + 2]


def cross(a: Vector, at: int, b: Vector, c: Vector) -> None:
    """Compute c (3,), the cross product of a[at : at + 3] and b (3,)."""
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
    """Turn the quaternion q (4,) by a rotation vector (3,) [rad] in its own frame: ``q exp(by / 2)``,
    of norm 1.
    """
    squared = by[0] * by[0] + by[1] * by[1] + by[2] * by[2]
    angle = math.sqrt(squared)
    turn = zeros(4)
    if angle > 1e-4:
        half_sinc = math.sin(angle / 2.0) / angle
    else:
        half_sinc = 0.5 - squared / 48.0
    for i in range(3):
        turn[i] = half_sinc * by[i]
    turn[3] = math.cos(angle / 2.0)
    multiply(q, turn, q)
    normalize(q)


def turn_maps(angle: Vector, E: Vector, J: Vector) -> None:
    """Compute the rotation matrix E of the rotation vector -angle and the right Jacobian J of exp at
    the rotation vector angle (3,) [rad], by Rodrigues' formula; both (9,).

    With the skew matrix K of the angle and its size a: ``E = 1 - sin(a) / a K + (1 - cos(a)) / a^2
    K^2`` and ``J = 1 - (1 - cos(a)) / a^2 K + (a - sin(a)) / a^3 K^2``.
    """
    squared = angle[0] * angle[0] + angle[1] * angle[1] + angle[2] * angle[2]
    size = math.sqrt(squared)
    K = zeros(9)
    # Coefficients of order 1, 2 and 3 in the size, by their series where they would be 0 / 0.
    first = 1.0 - squared / 6.0 + squared * squared / 120.0
    second = 0.5 - squared / 24.0 + squared * squared / 720.0
    third = 1.0 / 6.0 - squared / 120.0 + squared * squared / 5040.0
    if size >= 1e-2:
        first = math.sin(size) / size
        second = (1.0 - math.cos(size)) / squared
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
            E[3 * i + j] = identity - first * K[3 * i + j] + second * K2
            J[3 * i + j] = identity - second * K[3 * i + j] + third * K2


# Entries of the covariance.


def active(filter: FilterMemory) -> int:
    """Return the number of rows of the covariance up to the last clone in use."""
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
    """Reduce the variance of entry i, and keep its correlations with the first n entries: clones
    whose readings have not arrived yet still depend on it.
    """
    share = math.sqrt(variance / filter.P[i][i])
    for j in range(i):
        filter.P[j][i] *= share
    for j in range(i, n):
        filter.P[i][j] *= share
    filter.P[i][i] = variance


def is_unknown(filter: FilterMemory, first: int, n: int) -> bool:
    """Return whether any entry of the error state from `first` to first + n - 1 is unknown."""
    unknown = False
    for i in range(first, first + n):
        unknown = unknown or filter.P[i][i] > tuning.UNKNOWN * filter.limit[i] * filter.limit[i]
    return unknown


def mean_variance(filter: FilterMemory, first: int) -> float:
    """Return the mean variance of the three entries of the error state from `first` on."""
    return (
        filter.P[first][first] + filter.P[first + 1][first + 1] + filter.P[first + 2][first + 2]
    ) / 3.0


def is_determined(variance: float, largest: float) -> bool:
    """Return whether a variance is between zero and the largest [square of a unit, both]; rounding
    may have made it negative.
    """
    return 0.0 <= variance <= largest


def response_variance(filter: FilterMemory, change: float) -> float:
    """Return the variance that a change of the commanded velocity [m/s, rad/s] in a tick adds to the
    velocity.

    The response errs by white noise in the acceleration, whose density is in proportion to the
    commanded acceleration, ``change / dt``: the faster a change, the less closely it is followed,
    and a change that takes several ticks adds the same whatever their length.
    """
    drive = filter.drive[ProcessNoise.REPLY] * change
    if filter.dt > 0.0:
        return drive * drive / filter.dt
    return 0.0


# The process model: constant acceleration, linear in W and angular in B, driven by white jerk.


def predict(filter: FilterMemory) -> None:
    """Predict the state, and its covariance by ``F P F' + Q``, at the end of the tick.

    Errors of the attitude are carried by ``E = exp(-angle)`` of the angle that the vehicle turns in
    the tick, those of angular velocity and acceleration enter them by h J and h^2 J / 2.
    """
    if filter.has_command:
        _follow_command(filter)
    dt = filter.dt
    if not dt > 0.0:
        return
    angle = zeros(3)
    E = zeros(9)
    J = zeros(9)
    hJ = zeros(9)
    half_hhJ = zeros(9)
    h = min(tuning.LONGEST_STEP, dt)
    n = active(filter)
    for i in range(3):
        angle[i] = h * filter.x[Part.SPIN + i] + h * h / 2.0 * filter.x[Part.SPIN_UP + i]
    turn_maps(angle, E, J)
    for i in range(9):
        hJ[i] = h * J[i]
        half_hhJ[i] = h * h / 2.0 * J[i]
    # The block of the vehicle is needed in full, not only its upper triangle.
    for i in range(1, MAIN):
        for j in range(i):
            filter.P[i][j] = filter.P[j][i]
    _move_rows(filter, n, h, E, hJ, half_hhJ)
    _move_columns(filter, h, E, hJ, half_hhJ)
    _add_process_noise(filter, dt, J)
    _bound_variances(filter, n)
    turn_by(filter.turn, angle)
    for i in range(3):
        filter.x[Part.PLACE + i] += (
            h * filter.x[Part.SPEED + i] + h * h / 2.0 * filter.x[Part.ACCELERATION + i]
        )
        filter.x[Part.SPEED + i] += h * filter.x[Part.ACCELERATION + i]
        filter.x[Part.SPIN + i] += h * filter.x[Part.SPIN_UP + i]


def _follow_command(filter: FilterMemory) -> None:
    """Change the estimated velocity by as much as the commanded one has changed; the linear one only
    where `guided`.
    """
    R = zeros(9)
    commanded = zeros(3)
    rotation(filter.turn, R)
    rotate(R, filter.response, commanded)
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
def _move_rows(
    filter: FilterMemory, n: int, h: float, E: Vector, hJ: Vector, half_hhJ: Vector
) -> None:
    """Replace the first n columns of P by those of F P; E, h J and h^2 J / 2 are the blocks of F in
    the rows of the attitude.
    """
    half_hh = h * h / 2.0
    turn = zeros(3)
    for j in range(n):
        for i in range(3):
            turn[i] = 0.0
            for k in range(3):
                turn[i] += (
                    E[3 * i + k] * filter.P[Part.TURN + k][j]
                    + hJ[3 * i + k] * filter.P[Part.SPIN + k][j]
                    + half_hhJ[3 * i + k] * filter.P[Part.SPIN_UP + k][j]
                )
        for i in range(3):
            filter.P[Part.TURN + i][j] = turn[i]
    for i in range(3):
        for j in range(n):
            filter.P[Part.PLACE + i][j] += (
                h * filter.P[Part.SPEED + i][j] + half_hh * filter.P[Part.ACCELERATION + i][j]
            )
            filter.P[Part.SPEED + i][j] += h * filter.P[Part.ACCELERATION + i][j]
            filter.P[Part.SPIN + i][j] += h * filter.P[Part.SPIN_UP + i][j]


def _move_columns(filter: FilterMemory, h: float, E: Vector, hJ: Vector, half_hhJ: Vector) -> None:
    """Multiply the block (MAIN, MAIN) of the vehicle, F P after `_move_rows`, by F' from the right."""
    half_hh = h * h / 2.0
    turn = zeros(3)
    for j in range(MAIN):
        row = filter.P[j]
        for i in range(3):
            turn[i] = 0.0
            for k in range(3):
                turn[i] += (
                    E[3 * i + k] * row[Part.TURN + k]
                    + hJ[3 * i + k] * row[Part.SPIN + k]
                    + half_hhJ[3 * i + k] * row[Part.SPIN_UP + k]
                )
        for i in range(3):
            row[Part.TURN + i] = turn[i]
            row[Part.PLACE + i] += h * row[Part.SPEED + i] + half_hh * row[Part.ACCELERATION + i]
            row[Part.SPEED + i] += h * row[Part.ACCELERATION + i]
            row[Part.SPIN + i] += h * row[Part.SPIN_UP + i]


def _add_process_noise(filter: FilterMemory, dt: float, J: Vector) -> None:
    """Add the process noise Q of a tick: white jerk, linear in W and angular in B, which J takes to
    the attitude, and random walks of the biases and the floor.
    """
    dt2 = dt * dt
    # Covariance (3, 3), row after row, of a value and its first two derivatives after a tick in which
    # the third is white noise of density 1.
    Q = zeros(9)
    Q[0] = dt2 * dt2 * dt / 20.0
    Q[1] = dt2 * dt2 / 8.0
    Q[2] = dt2 * dt / 6.0
    Q[4] = dt2 * dt / 3.0
    Q[5] = dt2 / 2.0
    Q[8] = dt
    jerk = filter.jerk_share * filter.drive[ProcessNoise.JERK]
    jerk *= jerk
    angular_jerk = filter.drive[ProcessNoise.ANGULAR_JERK]
    angular_jerk *= angular_jerk
    for i in range(3):
        for a in range(3):
            for b in range(a, 3):
                filter.P[Part.PLACE + 3 * a + i][Part.PLACE + 3 * b + i] += jerk * Q[3 * a + b]
        for j in range(3):
            JJ = J[3 * i] * J[3 * j] + J[3 * i + 1] * J[3 * j + 1] + J[3 * i + 2] * J[3 * j + 2]
            if j >= i:
                filter.P[Part.TURN + i][Part.TURN + j] += angular_jerk * Q[0] * JJ
            filter.P[Part.TURN + i][Part.SPIN + j] += angular_jerk * Q[1] * J[3 * i + j]
            filter.P[Part.TURN + i][Part.SPIN_UP + j] += angular_jerk * Q[2] * J[3 * i + j]
        filter.P[Part.SPIN + i][Part.SPIN + i] += angular_jerk * Q[4]
        filter.P[Part.SPIN + i][Part.SPIN_UP + i] += angular_jerk * Q[5]
        filter.P[Part.SPIN_UP + i][Part.SPIN_UP + i] += angular_jerk * Q[8]
        for k in range(3):
            drift = filter.drive[ProcessNoise.GYRO + k]
            bias = Part.GYRO_BIAS + 3 * k + i
            filter.P[bias][bias] += dt * drift * drift
    filter.P[Part.FLOOR][Part.FLOOR] += dt * _floor_drift(filter)


def _floor_drift(filter: FilterMemory) -> float:
    """Return the variance per time [m2/s] of the height of the floor below the altimeter: by its own
    random walk, and by the slope that the altimeter passes over.
    """
    R = zeros(9)
    turning_B = zeros(3)
    velocity = zeros(3)
    slope = filter.drive[ProcessNoise.ROUGHNESS]
    drift = filter.drive[ProcessNoise.SETTLING]
    rotation(filter.turn, R)
    cross(filter.x, Part.SPIN, filter.beam_at, turning_B)
    rotate(R, turning_B, velocity)
    for i in range(2):
        velocity[i] += filter.x[Part.SPEED + i]
    squared_speed = velocity[0] * velocity[0] + velocity[1] * velocity[1]
    return drift * drift + slope * slope * squared_speed


def _bound_variances(filter: FilterMemory, n: int) -> None:
    """Bound the variances by the squares of `limit`, and reset entries that are not finite.

    Beyond the limit, attitude, position and floor lose their correlations with the first n entries,
    as a reading can set them anew; velocities, accelerations and biases keep them. Velocities and
    accelerations become 0.
    """
    for i in range(MAIN):
        largest_variance = filter.limit[i] * filter.limit[i]
        is_lost = not math.isfinite(norm(filter.turn) if i < Part.PLACE else filter.x[i])
        if not is_lost and is_determined(filter.P[i][i], largest_variance):
            continue
        keeps_correlations = Part.SPEED <= i < Part.FLOOR
        is_regular = filter.P[i][i] > 0.0 and math.isfinite(filter.P[i][i])
        if keeps_correlations and is_regular and not is_lost:
            _limit_to(filter, i, n, largest_variance)
        else:
            clear(filter, i, n, largest_variance)
        is_motion = Part.SPEED <= i < Part.GYRO_BIAS
        if i >= Part.PLACE and (is_lost or is_motion):
            filter.x[i] = 0.0
    if not math.isfinite(norm(filter.turn)):
        for i in range(4):
            filter.turn[i] = 1.0 if i == 3 else 0.0


def inflate_velocity_variance(filter: FilterMemory, rests: bool) -> None:
    """Inflate the variance of the linear velocity to that of any motion that vehicles make.

    rests: the velocity was right until its readings ended. Velocity and acceleration are set to 0
    then, as extrapolation without readings leads ever farther astray. Otherwise the velocity has
    been wrong for `EXPOSED_FOR`, and so is the position that was integrated from it: were only the
    velocity in doubt, the next fix would be explained by the velocity of the last tick alone.
    """
    variance = tuning.EXPOSED * tuning.EXPOSED
    duration = tuning.EXPOSED_FOR
    for k in range(len(filter.owner)):
        filter.owner[k] = -1.0
    for i in range(3):
        place = Part.PLACE + i
        speed = Part.SPEED + i
        acceleration = Part.ACCELERATION + i
        filter.P[speed][speed] += variance
        if rests:
            filter.P[acceleration][acceleration] += variance
            filter.x[speed] = 0.0
            filter.x[acceleration] = 0.0
        else:
            filter.P[place][speed] += duration * variance
            filter.P[place][place] += duration * duration * variance


# The measurement models: h(x), its rate, and H, for each channel.


def predict_measurement(filter: FilterMemory, channel: int, n: int) -> None:
    """Predict the measurement of a channel now: h, H, its covariances ``H P`` with the first n errors,
    and ``S = H P H'``.
    """
    predicted = filter.predicted
    rows = filter.rows[channel]
    _evaluate_model(filter, predicted, channel)
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


def _evaluate_model(filter: FilterMemory, predicted: PredictedMeasurement, channel: int) -> None:
    """Evaluate the measurement model of a channel: h, H, the rate of h and its variance."""
    for i in range(3):
        predicted.rate[i] = 0.0
        for k in range(MAIN):
            predicted.H[i][k] = 0.0
    for i in range(4):
        predicted.h[i] = 0.0
    if channel == ChannelIndex.ATTITUDE:
        for i in range(4):
            predicted.h[i] = filter.turn[i]
        _predict_part(filter, predicted, Part.TURN, Part.SPIN)
    elif channel == ChannelIndex.ANGULAR_VELOCITY:
        for i in range(3):
            predicted.h[i] = filter.x[Part.SPIN + i] + filter.x[Part.GYRO_BIAS + i]
            predicted.H[i][Part.GYRO_BIAS + i] = 1.0
        _predict_part(filter, predicted, Part.SPIN, Part.SPIN_UP)
    elif channel == ChannelIndex.POSITION:
        for i in range(3):
            predicted.h[i] = filter.x[Part.PLACE + i]
        _predict_part(filter, predicted, Part.PLACE, Part.SPEED)
    elif channel == ChannelIndex.DEPTH:
        predicted.h[0] = filter.x[Part.PLACE + 2]
        predicted.rate[0] = filter.x[Part.SPEED + 2]
        predicted.H[0][Part.PLACE + 2] = 1.0
        predicted.rate_variance = filter.P[Part.SPEED + 2][Part.SPEED + 2]
    elif channel == ChannelIndex.ALTIMETER_RANGE:
        _predict_altitude(filter, predicted)
    elif channel >= filtering.N_CHANNELS:
        _predict_by_own_function(filter, predicted, channel)
    else:
        _predict_in_body(filter, predicted, channel == ChannelIndex.SPECIFIC_FORCE)


def _predict_part(
    filter: FilterMemory, predicted: PredictedMeasurement, part: int, rate: int
) -> None:
    """Write H of a channel that measures a part of the state, and its rate, which is another part."""
    predicted.rate_variance = mean_variance(filter, rate)
    for i in range(3):
        predicted.rate[i] = filter.x[rate + i]
        predicted.H[i][part + i] = 1.0


def _predict_in_body(filter: FilterMemory, predicted: PredictedMeasurement, force: bool) -> None:
    """Predict the velocity v in B, or the specific force a - g in B where `force`, each with its bias:
    ``h = R' v + bias``.
    """
    if force:
        part = int(Part.ACCELERATION)
        bias = int(Part.FORCE_BIAS)
    else:
        part = int(Part.SPEED)
        bias = int(Part.DVL_BIAS)
    R = zeros(9)
    v_W = zeros(3)
    v_B = zeros(3)
    acceleration_B = zeros(3)
    turning = zeros(3)
    rotation(filter.turn, R)
    for i in range(3):
        v_W[i] = filter.x[part + i] - (filter.gravity[i] if force else 0.0)
    rotate_back(R, v_W, 0, v_B)
    rotate_back(R, filter.x, Part.ACCELERATION, acceleration_B)
    cross(filter.x, Part.SPIN, v_B, turning)
    # An error of the attitude turns v_B: the skew matrix of v_B.
    predicted.H[0][Part.TURN + 1] = -v_B[2]
    predicted.H[0][Part.TURN + 2] = v_B[1]
    predicted.H[1][Part.TURN] = v_B[2]
    predicted.H[1][Part.TURN + 2] = -v_B[0]
    predicted.H[2][Part.TURN] = -v_B[1]
    predicted.H[2][Part.TURN + 1] = v_B[0]
    for i in range(3):
        for j in range(3):
            predicted.H[i][part + j] = R[3 * j + i]
        predicted.H[i][bias + i] = 1.0
        predicted.h[i] = v_B[i] + filter.x[bias + i]
        # A specific force changes by turning alone: the jerk is noise.
        predicted.rate[i] = (0.0 if force else acceleration_B[i]) - turning[i]
    squared_size = v_B[0] * v_B[0] + v_B[1] * v_B[1] + v_B[2] * v_B[2]
    if force:
        predicted.rate_variance = mean_variance(filter, Part.SPIN) * squared_size
    else:
        predicted.rate_variance = mean_variance(filter, Part.ACCELERATION)


def _predict_altitude(filter: FilterMemory, predicted: PredictedMeasurement) -> None:
    """Predict the altitude h[0] of the altimeter above the floor, and the cosine h[1] of the tilt of
    its beam, by which the range that it reads is multiplied before the two are compared.

    H is the derivative of the altitude less the range times the cosine.
    """
    R = zeros(9)
    z_W_in_B = zeros(3)
    altitude_by_turn = zeros(3)
    cosine_by_turn = zeros(3)
    cosine = 0.0
    altitude = filter.x[Part.PLACE + 2] - filter.x[Part.FLOOR]
    rotation(filter.turn, R)
    for i in range(3):
        z_W_in_B[i] = R[6 + i]
        cosine += z_W_in_B[i] * filter.beam_up[i]
        altitude += z_W_in_B[i] * filter.beam_at[i]
    cross(filter.beam_at, 0, z_W_in_B, altitude_by_turn)
    cross(filter.beam_up, 0, z_W_in_B, cosine_by_turn)
    for i in range(3):
        reading_by_turn = 0.0
        if abs(cosine) > STEEP:
            reading_by_turn = altitude / cosine * cosine_by_turn[i]
        predicted.H[0][Part.TURN + i] = altitude_by_turn[i] - reading_by_turn
    predicted.H[0][Part.PLACE + 2] = 1.0
    predicted.H[0][Part.FLOOR] = -1.0
    predicted.h[0] = altitude
    predicted.h[1] = cosine
    predicted.rate[0] = filter.x[Part.SPEED + 2]
    predicted.rate_variance = filter.P[Part.SPEED + 2][Part.SPEED + 2]


def _predict_by_own_function(
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
    """Write the predicted measurement of a channel at the time of a clone, as it was kept; slot: the
    clone, -1 to predict it for now. n: number of errors whose covariances count.
    """
    if slot < 0:
        predict_measurement(filter, channel, n)
        return
    predicted = filter.predicted
    rows = filter.rows[channel]
    first = MAIN + 3 * slot
    predicted.h[:] = filter.h[slot]
    predicted.rate[:] = filter.rate[slot]
    predicted.rate_variance = filter.rate_variance[slot]
    for i in range(rows):
        for j in range(first + i):
            predicted.HP[i][j] = filter.P[j][first + i]
        for j in range(first + i, n):
            predicted.HP[i][j] = filter.P[first + i][j]
        for j in range(rows):
            predicted.S[i][j] = filter.P[first + min(i, j)][first + max(i, j)]


def factorise(predicted: PredictedMeasurement, noise: float, n: int) -> None:
    """Compute the lower Cholesky factor L of the innovation covariance (n, n), S with the variance
    `noise` [square of its unit] on the diagonal; pivots that rounding makes smaller are set to it.
    """
    for j in range(n):
        for i in range(j, n):
            pivot = predicted.S[i][j] + (noise if i == j else 0.0)
            for k in range(j):
                pivot -= predicted.L[i][k] * predicted.L[j][k]
            if i == j:
                predicted.L[i][j] = math.sqrt(noise if pivot < noise else pivot)
            else:
                predicted.L[i][j] = pivot / predicted.L[j][j]


def divide(predicted: PredictedMeasurement, n: int, x: Vector) -> None:
    """Solve ``L y = x`` for y, which takes the place of x (n,)."""
    for i in range(n):
        for k in range(i):
            x[i] -= predicted.L[i][k] * x[k]
        x[i] /= predicted.L[i][i]


def second_derivative(filter: FilterMemory, channel: int, i: int) -> float:
    """Return entry i of the second derivative of what a channel of attitude or place measures."""
    if channel == ChannelIndex.ATTITUDE:
        return filter.x[Part.SPIN_UP + i]
    axis = i if filter.rows[channel] == 3 else 2  # of a depth or an altitude
    return filter.x[Part.ACCELERATION + axis]


def process_variance(filter: FilterMemory, channel: int, age: float) -> float:
    """Return the variance of the change of what a channel of attitude or place measures since a
    reading of an age [s]: by the errors of rate and acceleration, and by white jerk.
    """
    if channel == ChannelIndex.ATTITUDE:
        jerk = filter.drive[ProcessNoise.ANGULAR_JERK]
        acceleration_variance = mean_variance(filter, Part.SPIN_UP)
    else:
        jerk = filter.drive[ProcessNoise.JERK]
        acceleration_variance = mean_variance(filter, Part.ACCELERATION)
    squared = age * age
    by_rate = squared * filter.predicted.rate_variance
    by_acceleration = squared * squared / 4.0 * acceleration_variance
    by_jerk = jerk * jerk * squared * squared * age / 20.0
    return by_rate + by_acceleration + by_jerk
