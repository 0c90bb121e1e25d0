"""Channels that tell the same in two ways, compared over a few seconds."""

from __future__ import annotations

from collections import deque

import numpy as np
import pinocchio as pin

_GAP = 2.0  # [s] of silence after which a comparison begins anew
_SIGMAS = 8.0
_KEPT = 64  # readings of a DVL that late fixes may be compared with
_SPACING = 0.1  # [s] between readings that are compared: more tell no more


class VelocityAgainstPosition:
    """The way between two position fixes against the velocity of the DVL, integrated over the same time."""

    _SPAN, _RATE = 3.0, 0.04  # [s], [m/s]: a bias that a vehicle may have
    _BLIND = 1.2  # [s] without a velocity, in which a vehicle may have gone anywhere

    def __init__(self, sigma: float) -> None:
        """sigma [m]: noise of a fix."""
        self._tolerance = self._RATE + _SIGMAS * np.sqrt(2.0) * sigma / self._SPAN
        self._way, self._velocity, self._t = np.zeros(3), np.zeros(3), -np.inf
        self._ways: deque[tuple[float, np.ndarray]] = deque(maxlen=_KEPT)
        self._offsets: deque[tuple[float, np.ndarray]] = deque()

    def velocity(self, v_W: np.ndarray, t: float) -> None:
        """The DVL's velocity v_W (3,) [m/s] in W at time t [s]."""
        dt = t - self._t
        if not 0.0 <= dt <= self._BLIND:
            self._offsets.clear()
            self._ways.clear()
        else:
            self._way = self._way + 0.5 * dt * (v_W + self._velocity)
        self._velocity, self._t = v_W, t
        self._ways.append((t, self._way))

    def position(self, p: np.ndarray, t: float) -> str | None:
        """Why the two disagree, by a fix p (3,) [m] in W at time t [s].

        Thirds of the span are compared by their medians, which fixes that are far off now and then do not move.
        """
        if not (abs(t - self._t) <= _GAP and self._ways and t >= self._ways[0][0]):
            self._offsets.clear()
            return None
        if self._offsets and t - self._offsets[-1][0] < _SPACING:
            return None
        self._offsets.append((t, p - self._way_at(t)))
        while self._offsets[-1][0] - self._offsets[0][0] > self._SPAN + 0.5:
            self._offsets.popleft()
        if self._offsets[-1][0] - self._offsets[0][0] < self._SPAN or len(self._offsets) < 3:
            return None
        times, offsets = (np.array(values) for values in zip(*self._offsets, strict=True))
        n = len(times) // 3
        change = np.median(offsets[-n:], axis=0) - np.median(offsets[:n], axis=0)
        rate = float(np.linalg.norm(change)) / float(times[-n:].mean() - times[:n].mean())
        return f"position fixes and DVL disagree by {rate:.2g} m/s" if rate > self._tolerance else None

    def _way_at(self, t: float) -> np.ndarray:
        """(3,) [m] by the DVL until time t [s], which a late fix was taken at some readings ago."""
        if t >= self._t:
            return np.asarray(self._way + (t - self._t) * self._velocity)
        times, ways = (np.array(values) for values in zip(*self._ways, strict=True))
        return np.array([np.interp(t, times, ways[:, i]) for i in range(3)])


class RateAgainstAttitude:
    """The turn between two attitudes against that of the gyro, integrated over the same time."""

    _SPAN, _RATE = 1.0, 0.03  # [s], [rad/s]

    def __init__(self, sigma: float) -> None:
        """sigma [rad]: noise of an attitude."""
        self._tolerance = self._RATE + _SIGMAS * np.sqrt(2.0) * sigma / self._SPAN
        self._turn, self._omega, self._t = pin.Quaternion.Identity(), np.zeros(3), -np.inf
        self._offsets: deque[tuple[float, pin.Quaternion]] = deque()

    def rate(self, omega: np.ndarray, t: float) -> None:
        """The gyro's omega (3,) [rad/s] in B at time t [s]."""
        dt = t - self._t
        if not 0.0 <= dt <= _GAP:
            self._offsets.clear()
        else:
            self._turn = self._turn * _rotation(0.5 * dt * (omega + self._omega))
            self._turn.normalize()
        self._omega, self._t = omega, t

    def attitude(self, quaternion: np.ndarray, t: float) -> str | None:
        """Why the two disagree, by the attitude quaternion (4,) [-], xyzw, at time t [s]."""
        if not abs(t - self._t) <= _GAP:
            self._offsets.clear()
            return None
        if self._offsets and t - self._offsets[-1][0] < _SPACING:
            return None
        turned = self._turn * _rotation((t - self._t) * self._omega)
        # Constant in B where both turn alike.
        self._offsets.append((t, pin.Quaternion(quaternion) * turned.conjugate()))
        while self._offsets[-1][0] - self._offsets[0][0] > self._SPAN + _SPACING:
            self._offsets.popleft()
        (first, old), (last, new) = self._offsets[0], self._offsets[-1]
        if last - first < self._SPAN - 1e-6:
            return None
        rate = float(old.angularDistance(new)) / (last - first)
        return f"gyro and attitude disagree by {rate:.2g} rad/s" if rate > self._tolerance else None


class DepthAgainstPosition:
    """The depth against the z of position fixes, less what they differed by at first."""

    _FIRST, _LAST, _BASE = 10, 5, 0.05  # fixes, fixes, [m]

    def __init__(self, sigma: float) -> None:
        """sigma [m]: noise of both together."""
        self._tolerance = self._BASE + _SIGMAS * sigma * (self._FIRST**-1 + self._LAST**-1) ** 0.5
        self._first: list[float] = []
        self._last: deque[float] = deque(maxlen=self._LAST)
        self._depth, self._t = 0.0, -np.inf

    def depth(self, z: float, t: float) -> None:
        """The depth z [m] at time t [s]."""
        self._depth, self._t = z, t

    def position(self, p: np.ndarray, v_W: np.ndarray, t: float) -> str | None:
        """Why the two disagree, by a fix p (3,) [m] at time t [s]; v_W (3,) [m/s] is the velocity in W."""
        if not abs(t - self._t) <= _GAP:
            return None
        difference = float(p[2]) - self._depth - (t - self._t) * float(v_W[2])
        if len(self._first) < self._FIRST:
            self._first.append(difference)
            return None
        self._last.append(difference)
        apart = abs(float(np.mean(self._last)) - float(np.mean(self._first)))
        full = len(self._last) == self._LAST
        return f"depth and position disagree by {apart:.2g} m" if full and apart > self._tolerance else None


def _rotation(vector: np.ndarray) -> pin.Quaternion:
    """Of a small rotation vector (3,) [rad]."""
    x, y, z = (0.5 * vector).tolist()
    turn = pin.Quaternion(1.0 - 0.5 * (x * x + y * y + z * z), x, y, z)
    turn.normalize()
    return turn
