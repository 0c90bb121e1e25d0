"""What each channel of the vehicle sees of the estimate, in NumPy: what sights.c does; keep both in step."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from uvms_ocp.arrays import Array
from uvms_ocp.control.navigation.filter.memory import CONSTANTS, MAIN, ROWS, Channel, Memory, Noise, Part
from uvms_ocp.control.navigation.filter.vehicle import active, part, rotation


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Sight:
    """What a channel sees of the estimate, now or at the time of a clone."""

    seen: Array
    """(4,) [unit of the channel]; of the altimeter altitude and cosine of the tilt."""
    rate: Array
    """(3,) its rate [per s]."""
    doubt: float
    """[square of its unit] variance of the rate."""
    HP: Array
    """(rows, n) [SI] covariance with all errors."""
    S: Array
    """(rows, rows) [SI] its own."""

    def factor(self, more: float) -> Array:
        """(rows, rows) lower factor of S with `more` [square of its unit] on the diagonal: no pivot is less but by rounding."""
        L = np.zeros(self.S.shape)
        for j in range(len(L)):
            column = self.S[j:, j] - L[j:, :j] @ L[j, :j]
            pivot = column[0] + more
            L[j, j] = math.sqrt(more if pivot < more else pivot)
            L[j + 1 :, j] = column[1:] / L[j, j]
        return L


def look(m: Memory, c: Channel) -> Sight:
    """What channel c sees now."""
    seen, H, rate, doubt = _LOOKS[c](m)
    HP = H @ m.P[:MAIN, : active(m)]
    return Sight(seen=np.resize(seen, 4), rate=np.resize(rate, 3), doubt=doubt, HP=HP, S=HP[:, :MAIN] @ H.T)


_View = tuple[Array, Array, Array, float]


def _rows(n: int, *blocks: tuple[int, Array]) -> Array:
    H = np.zeros((n, MAIN))
    for at, block in blocks:
        H[:, at : at + block.shape[1]] = block
    return H


def doubt_of(m: Memory, first: int) -> float:
    """Mean variance of three entries of the error state."""
    return float((m.P[first, first] + m.P[first + 1, first + 1] + m.P[first + 2, first + 2]) / 3)


def _see_attitude(m: Memory) -> _View:
    return m.turn.copy(), _rows(3, (Part.TURN, np.eye(3))), part(m, Part.SPIN).copy(), doubt_of(m, Part.SPIN)


def _see_spin(m: Memory) -> _View:
    seen = part(m, Part.SPIN) + part(m, Part.GYRO_BIAS)
    H = _rows(3, (Part.SPIN, np.eye(3)), (Part.GYRO_BIAS, np.eye(3)))
    return seen, H, part(m, Part.SPIN_UP).copy(), doubt_of(m, Part.SPIN_UP)


def _see_place(m: Memory) -> _View:
    H = _rows(3, (Part.PLACE, np.eye(3)))
    return part(m, Part.PLACE).copy(), H, part(m, Part.SPEED).copy(), doubt_of(m, Part.SPEED)


def _see_depth(m: Memory) -> _View:
    H, z = _rows(1, (Part.PLACE + 2, np.eye(1))), Part.SPEED + 2
    return part(m, Part.PLACE)[2:].copy(), H, part(m, Part.SPEED)[2:].copy(), float(m.P[z, z])


def _see_speed(m: Memory) -> _View:
    R, spin = rotation(m), part(m, Part.SPIN)
    v_B = R.T @ part(m, Part.SPEED)
    rate = R.T @ part(m, Part.ACCELERATION) - np.cross(spin, v_B)
    H = _rows(3, (Part.TURN, pin.skew(v_B)), (Part.SPEED, R.T), (Part.DVL_BIAS, np.eye(3)))
    return v_B + part(m, Part.DVL_BIAS), H, rate, doubt_of(m, Part.ACCELERATION)


def _see_force(m: Memory) -> _View:
    R, spin = rotation(m), part(m, Part.SPIN)
    force = R.T @ (part(m, Part.ACCELERATION) - m.gravity)
    H = _rows(3, (Part.TURN, pin.skew(force)), (Part.ACCELERATION, R.T), (Part.FORCE_BIAS, np.eye(3)))
    return force + part(m, Part.FORCE_BIAS), H, -np.cross(spin, force), doubt_of(m, Part.SPIN) * float(force @ force)


def _see_floor(m: Memory) -> _View:
    down = rotation(m)[2]
    cosine = down @ m.beam_up
    altitude = part(m, Part.PLACE)[2] + down @ m.beam_at - m.x[Part.FLOOR - Part.PLACE]
    tilt = altitude / cosine * np.cross(m.beam_up, down) if abs(cosine) > CONSTANTS.steep else np.zeros(3)
    by_turn = np.cross(m.beam_at, down) - tilt
    H = _rows(1, (Part.TURN, by_turn[None]), (Part.PLACE + 2, np.eye(1)), (Part.FLOOR, -np.eye(1)))
    z = Part.SPEED + 2
    return np.array([altitude, cosine]), H, part(m, Part.SPEED)[2:].copy(), float(m.P[z, z])


_LOOKS = {
    Channel.ATTITUDE: _see_attitude,
    Channel.ANGULAR_VELOCITY: _see_spin,
    Channel.POSITION: _see_place,
    Channel.DEPTH: _see_depth,
    Channel.LINEAR_VELOCITY: _see_speed,
    Channel.SPECIFIC_FORCE: _see_force,
    Channel.ALTIMETER_RANGE: _see_floor,
}


def second_of(m: Memory, c: Channel) -> Array:
    """(3,) second derivative of what a channel that sets a part sees; its first entry alone for one row."""
    if c == Channel.ATTITUDE:
        return part(m, Part.SPIN_UP).copy()
    acceleration = part(m, Part.ACCELERATION)
    return acceleration.copy() if ROWS[c] == 3 else np.repeat(acceleration[2], 3)


def doubt_since(m: Memory, c: Channel, sight: Sight, age: float) -> float:
    """Variance of the way since a reading of that age [s]."""
    turns = c == Channel.ATTITUDE
    drive = m.drive[Noise.ANGULAR_JERK if turns else Noise.JERK]
    second = doubt_of(m, Part.SPIN_UP if turns else Part.ACCELERATION)
    squared = age * age
    return float(squared * sight.doubt + squared * squared / 4 * second + drive * drive * squared * squared * age / 20)
