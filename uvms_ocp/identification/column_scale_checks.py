"""Check each column of a pose against the velocity along its axis: one may have a unit or a sign that
the columns beside it do not have, such as a depth beside x and y.

Heights come from another sensor than x and y, and angles of a table may be in either unit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification.pressure_units import METRES, PRESSURE_UNITS, read_in, unit_by_rate
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.resampling import (
    GRID,
    angular_rate,
    interpolated,
    rotations,
    smoothed,
)
from uvms_ocp.identification.series_agreement import MOVES, WINDOW, correlation

_PERIOD = 2.0  # [s] over which displacements are compared
_MIN_MOTION = 0.02  # [m] standard deviation of displacements that tell a scale
_MIN_CORRELATION = 0.9  # from which on two columns are of the same motion
_SAME_UNIT = 1.3  # factor by which columns of one unit may differ
_FOREIGN_UNIT = 1.9  # factor from which on a column is in another unit
_UNIT_ERROR = 0.06  # share by which an observed factor may differ from that of a unit
_FASTEST_TURN = 2.0  # [rad/s] beyond which it is the gyro that is in degrees
_LENGTHS = {"cm": 100.0, "mm": 1000.0, "ft": 3.28084, "km": 1e-3}
"""Number of units in a metre."""
_DEGREES = 180.0 / np.pi  # in a radian


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Displacements:
    """Displacements over `_PERIOD` from each of uniform times."""

    by_position: np.ndarray
    """(m, 3) [m] differences of positions, in W."""
    by_velocity: np.ndarray
    """(m, 3) [m] integrals of velocities, in W."""


def of_columns(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield channels and doubts about single columns in another unit, or of another sign."""
    channels = recording.channels
    if "attitude" in channels and {"position", "linear_velocity"} <= channels.keys():
        for text in _of_position(recording):
            yield "position", text
    if {"attitude", "angular_velocity"} <= channels.keys():
        yield from _of_angles(channels["attitude"], channels["angular_velocity"])


def height_scale(recording: Recording) -> float | None:
    """Return the ratio of changes of height to those that the velocity tells of; `None` where it is
    not known.
    """
    if not {"attitude", "position", "linear_velocity"} <= recording.channels.keys():
        return None
    moves = displacements(recording)
    if moves is None:
        return None
    return _column_factor(moves.by_velocity[:, 2], moves.by_position[:, 2], _MIN_MOTION)


def displacements(recording: Recording) -> Displacements | None:
    """Compute displacements by position and by velocity; `None` where they have no time in common."""
    position = recording.channels["position"]
    velocity = recording.channels["linear_velocity"]
    attitude = recording.channels["attitude"]
    t, places = smoothed(position.undelayed_t, position.values, WINDOW)
    begin = max(t[0], velocity.undelayed_t[0], attitude.undelayed_t[0])
    end = min(t[-1], velocity.undelayed_t[-1], attitude.undelayed_t[-1])
    inside = (t >= begin) & (t <= end)
    n = round(_PERIOD / GRID)
    if inside.sum() < 4 * n:
        return None
    t = t[inside]
    places = places[inside]
    t_velocity, smooth = smoothed(velocity.undelayed_t, velocity.values, WINDOW)
    in_body = interpolated(t, t_velocity, smooth)
    in_world = np.einsum("nij,nj->ni", rotations(attitude, t), in_body)
    travelled = np.vstack(
        [np.zeros(3), GRID * np.cumsum((in_world[1:] + in_world[:-1]) / 2, axis=0)]
    )
    return Displacements(
        by_position=places[n:] - places[:-n], by_velocity=travelled[n:] - travelled[:-n]
    )


def _column_factor(expected: np.ndarray, measured: np.ndarray, min_motion: float) -> float | None:
    """Compute the factor, with its sign, by which measured (m,) [any] is larger than expected (m,)
    [any]; `None` where they do not agree, or expected moves by less than `min_motion` [any].
    """
    x = expected - expected.mean()
    y = measured - measured.mean()
    if x.std() < min_motion or abs(correlation(x, y)) < _MIN_CORRELATION:
        return None
    return float(np.sign(x @ y) * np.linalg.norm(y) / np.linalg.norm(x))


def _of_position(recording: Recording) -> Iterator[str]:
    """Yield doubts about columns of a position, where not all have the same factor."""
    moves = displacements(recording)
    if moves is None:
        return
    factors = []
    for k in range(3):
        factors.append(
            _column_factor(moves.by_velocity[:, k], moves.by_position[:, k], _MIN_MOTION)
        )
    horizontal = [factor for factor in factors[:2] if factor is not None]
    if horizontal and _is_foreign(float(np.median(np.abs(horizontal)))):
        return  # the whole channel is in another unit
    heights = recording.channels["position"].values[:, 2]
    for k, factor in enumerate(factors):
        if k in recording.channels["position"].constants or factor is None:
            continue
        factors_beside = [factor for j, factor in enumerate(factors) if j != k and factor]
        is_alone = k == 2 or _are_same(factors_beside)
        falls = k == 2 and bool(horizontal) and factor < 0.0  # with height, as a pressure
        is_psi = falls and unit_by_rate(-factor, _UNIT_ERROR) == "psi"
        if is_alone and (is_psi or _is_foreign(abs(factor))):
            yield from _unit_of_column(k, factor, heights)
        elif factor < 0.0 and k == 2 and horizontal and min(horizontal) > 0.0:
            yield (
                "z alone moves against the velocity: a height of the other sign? give scale: [1,"
                " 1, -1]"
            )


def _is_foreign(factor: float) -> bool:
    """Check whether a factor is that of another unit."""
    return factor > _FOREIGN_UNIT or factor < 1.0 / _FOREIGN_UNIT


def _are_same(factors: Sequence[float]) -> bool:
    """Check whether there are factors, all of them nearly 1."""
    return bool(factors) and all(1.0 / _SAME_UNIT < factor < _SAME_UNIT for factor in factors)


def _unit_of_column(k: int, factor: float, heights: np.ndarray) -> Iterator[str]:
    """Yield a doubt that names the unit of column k, which changes by `factor` [unit/m]."""
    axis = "xyz"[k]
    beside = f"{axis} alone is {factor:.3g} times the way that the velocity says"
    unit = ""
    if k == 2:
        unit = unit_by_rate(abs(factor), _UNIT_ERROR)
    sign = -float(np.sign(factor))  # of a pressure, which falls with height
    # A millibar is nearly a centimetre: what presses more than air does, and is nearer to it.
    if unit and _presses(sign * heights, unit) and _is_nearest(abs(factor), unit):
        yield _of_pressure(beside, unit, sign, heights)
        return
    for length, per_metre in _LENGTHS.items():
        if abs(abs(factor) / per_metre - 1.0) < _UNIT_ERROR:
            scale = [1.0, 1.0, 1.0]
            scale[k] = float(np.sign(factor)) / per_metre
            scale_text = ", ".join(f"{column_scale:.7g}" for column_scale in scale)
            yield f"{beside}: in {length}? give scale: [{scale_text}]"
            return
    if unit:
        yield _of_pressure(beside, unit, sign, heights)
    else:
        yield f"{beside}: its unit?"


def _presses(pressures: np.ndarray, unit: str) -> bool:
    """Check whether pressures (n,) [unit] include that of the air."""
    return read_in(unit, pressures).air > 0.0


def _is_nearest(factor: float, unit: str) -> bool:
    """Check that a factor [unit/m] is nearer to that of a pressure than to that of any length."""
    of_lengths = [abs(np.log(factor / per_metre)) for per_metre in _LENGTHS.values()]
    return bool(abs(np.log(factor * METRES * PRESSURE_UNITS[unit])) < min(of_lengths))


def _of_pressure(beside: str, unit: str, sign: float, heights: np.ndarray) -> str:
    """Write the doubt that heights (n,) [unit] are pressures of a sign."""
    reading = read_in(unit, sign * heights)
    return f"{beside}: in {unit} of pressure, {reading.evidence}? give {reading.keys(sign)}"


def _of_angles(attitude: Channel, gyro: Channel) -> Iterator[tuple[str, str]]:
    """Yield doubts about single angles, and single rates, that are in degrees, or not."""
    t, omega = angular_rate(attitude, WINDOW)
    t_gyro, rates = smoothed(gyro.undelayed_t, gyro.values, WINDOW)
    inside = (t > t_gyro[0]) & (t < t_gyro[-1])
    if not inside.any():
        return
    rates = interpolated(t[inside], t_gyro, rates)
    omega = omega[inside]
    min_motion = MOVES["angular_velocity"] / _DEGREES
    factors = []
    for k in range(3):
        factor = _column_factor(omega[:, k], rates[:, k], min_motion)
        if factor is not None:
            factor = abs(factor)
        factors.append(factor)
    known = [factor for factor in factors if factor is not None]
    if not any(1.0 / _SAME_UNIT < factor < _SAME_UNIT for factor in known):
        return
    in_degrees = [k for k, factor in enumerate(factors) if _is_about(factor, _DEGREES)]
    if not in_degrees:
        return
    if np.percentile(np.abs(rates[:, in_degrees]), 90.0) > _FASTEST_TURN:
        names = " and ".join("xyz"[k] for k in in_degrees)
        yield (
            "angular_velocity",
            (
                f"{names} alone turn {_DEGREES:.3g} times as fast as the attitude: in deg/s? give"
                f" scale: {_scale(in_degrees, 1.0 / _DEGREES)}"
            ),
        )
    else:
        angles = " and ".join(("roll", "pitch", "yaw")[k] for k in in_degrees)
        yield (
            "attitude",
            (
                f"{angles} alone turn {_DEGREES:.3g} times slower than the angular_velocity says: in"
                f" rad beside deg? give scale: {_scale(in_degrees, _DEGREES)}"
            ),
        )


def _is_about(factor: float | None, expected: float) -> bool:
    """Check that a factor is known and within `_SAME_UNIT` of what is expected."""
    return factor is not None and 1.0 / _SAME_UNIT < factor / expected < _SAME_UNIT


def _scale(columns: Sequence[int], factor: float) -> str:
    """Write the factors of three columns, of which some have one."""
    scales = [f"{factor:.10g}" if k in columns else "1" for k in range(3)]
    return f"[{', '.join(scales)}]"
