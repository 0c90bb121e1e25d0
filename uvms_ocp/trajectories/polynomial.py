"""Piecewise polynomials in time, of any degree and any number of axes.

Each piece is written in its own unit interval, ``u = (t - breaks[j]) / durations[j]``: powers of
absolute time lose all digits for very long or very short pieces. `[axis]` is the unit of an axis,
such as m or rad, derivatives of order d are [axis/s^d].
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from math import factorial
from pathlib import Path

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked, checked_dataclass, checked_on_failure
from uvms_ocp.errors import InvalidInput
from uvms_ocp.model_errors import printable
from uvms_ocp.record.array_file import read_arrays
from uvms_ocp.record.display import FieldTable
from uvms_ocp.record.output import as_output_errors
from uvms_ocp.types import Array, Count, Finite, Positive, read_only

_EXTREMUM_GRID = np.linspace(0.0, 1.0, 65)
"""Unit times at which the largest value of a piece is looked for first."""


@checked_dataclass(slots=False, eq=False, repr=False)
class PiecewisePolynomial(FieldTable):
    """A curve ``t -> R^n_axes`` made of polynomials; as a callable it is a ``Reference``, ``t ->
    (value, rate)``.

    Raises `InvalidInput` for wrong shapes, NaN, or breaks that do not increase (the first offending
    index is named).
    """

    breaks: Array
    """(n_pieces + 1,) [s] strictly increasing times at which the pieces begin and end."""
    coefficients: Array
    """(degree + 1, n_pieces, n_axes) [axis] coefficients of ascending powers of the unit-interval
    time of each piece.
    """

    def __post_init__(self) -> None:
        breaks = read_only(self.breaks, np.float64)
        coefficients = read_only(self.coefficients, np.float64)
        _check_breaks(breaks)
        _check_coefficients(coefficients, breaks.size - 1)
        object.__setattr__(self, "breaks", breaks)
        object.__setattr__(self, "coefficients", coefficients)

    @property
    def degree(self) -> int:
        return self.coefficients.shape[0] - 1

    @property
    def n_pieces(self) -> int:
        return self.coefficients.shape[1]

    @property
    def n_axes(self) -> int:
        return self.coefficients.shape[2]

    @property
    def start(self) -> float:
        """[s]"""
        return float(self.breaks[0])

    @property
    def end(self) -> float:
        """[s]"""
        return float(self.breaks[-1])

    @property
    def duration(self) -> float:
        """[s]"""
        return self.end - self.start

    @cached_property
    def durations(self) -> Array:
        """(n_pieces,) [s]"""
        return np.diff(self.breaks)

    @checked_on_failure
    def __call__(self, t: float) -> tuple[Array, Array]:
        """Return value (n_axes,) [axis] and rate (n_axes,) [axis/s] at t [s]; outside of its times
        the curve rests at its ends.
        """
        inside = min(max(t, self.start), self.end)
        piece = int(np.searchsorted(self.breaks, inside, side="right")) - 1
        piece = min(piece, self.n_pieces - 1)
        duration = self.breaks[piece + 1] - self.breaks[piece]
        u = (inside - self.breaks[piece]) / duration
        value, unit_rate = _horner_with_rate(self.coefficients[:, piece], u)
        if inside != t:
            return value, np.zeros(self.n_axes)
        return value, unit_rate / duration

    @checked_on_failure
    def evaluate(self, t: ArrayLike, derivative: Count = 0) -> Array:
        """Return the derivative-th derivative (..., n_axes) [axis/s^derivative] at times t (...)
        [s], clipped to the ends.
        """
        times = np.clip(np.asarray(t, dtype=float), self.start, self.end)
        piece = np.searchsorted(self.breaks, times, side="right") - 1
        piece = np.clip(piece, 0, self.n_pieces - 1)
        u = (times - self.breaks[piece]) / self.durations[piece]
        scaled = _differentiated(self.coefficients, derivative)
        unit_value = polyval(u[..., None], scaled[:, piece], tensor=False)
        return unit_value / self.durations[piece][..., None] ** derivative

    def derivative(self, order: Count = 1) -> PiecewisePolynomial:
        """Return the order-th time derivative as a curve of its own."""
        scale = self.durations[:, None] ** -order
        return PiecewisePolynomial(
            breaks=self.breaks, coefficients=_differentiated(self.coefficients, order) * scale
        )

    def sample(self, period: Positive, derivatives: Count = 0) -> tuple[Array, Array]:
        """Return the times (n,) [s] every ``period`` [s], end included, and values (n, derivatives
        + 1, n_axes) [axis/s^d].
        """
        n_periods = max(int(np.ceil(self.duration / period - 1e-9)), 1)
        times = np.minimum(self.start + period * np.arange(n_periods + 1), self.end)
        values = [self.evaluate(times, d) for d in range(derivatives + 1)]
        return times, np.stack(values, axis=1)

    def jumps(self, derivative: Count) -> Array:
        """Return (n_pieces - 1, n_axes) [axis/s^derivative] value just after minus just before each
        inner break.
        """
        scaled = _differentiated(self.coefficients, derivative)
        rate = self.durations[:, None] ** -derivative
        return scaled[0, 1:] * rate[1:] - scaled[:, :-1].sum(axis=0) * rate[:-1]

    def peak(self, derivative: Count = 0) -> Array:
        """Return (n_axes,) [axis/s^derivative] largest absolute value of the derivative-th
        derivative over the whole curve.
        """
        unit_peaks = _unit_peaks(_differentiated(self.coefficients, derivative))
        return np.max(unit_peaks / self.durations[:, None] ** derivative, axis=0)

    def scaled(self, factor: Positive) -> PiecewisePolynomial:
        """Return the path ``factor`` times slower, with the start time that it has."""
        return PiecewisePolynomial(
            breaks=self.start + factor * (self.breaks - self.start), coefficients=self.coefficients
        )

    def shifted(self, delay: Finite) -> PiecewisePolynomial:
        """Return the curve ``delay`` [s] later. Raises `InvalidInput` where no clock could tell its
        breaks apart.
        """
        breaks = self.breaks + delay
        if not (np.diff(breaks) > 0.0).all():
            raise InvalidInput(
                f"delay = {delay} s; give less: at so late a time the breaks cannot be told apart"
            )
        return PiecewisePolynomial(breaks=breaks, coefficients=self.coefficients)

    def axes(self, indices: Sequence[int]) -> PiecewisePolynomial:
        """Return the curve of the chosen axes only. Raises `InvalidInput` for none."""
        if not len(indices):
            raise InvalidInput("indices = (); give at least one axis")
        return PiecewisePolynomial(
            breaks=self.breaks, coefficients=self.coefficients[:, :, list(indices)]
        )

    def table(
        self, period: float, derivatives: Count = 4, names: Sequence[str] | None = None
    ) -> tuple[tuple[str, ...], Array]:
        """Return column names and rows ``t, d0_axis0, d0_axis1, ..., d1_axis0, ...`` every
        ``period`` [s].

        ``names`` (n_axes,) take the place of ``axis0, axis1, ...``. Raises `InvalidInput` for
        another number of them, and as `sample`.
        """
        times, values = self.sample(period, derivatives)
        if names is None:
            names = [f"axis{axis}" for axis in range(self.n_axes)]
        if len(names) != self.n_axes:
            raise InvalidInput(
                f"{len(names)} names given for {self.n_axes} axes; give one for each."
            )
        columns = ["t"]
        for d in range(derivatives + 1):
            columns += [f"d{d}_{name}" for name in names]
        return tuple(columns), np.column_stack([times, values.reshape(times.size, -1)])

    def to_csv(
        self,
        path: Path | str,
        period: float,
        derivatives: Count = 4,
        names: Sequence[str] | None = None,
    ) -> None:
        """Write ``table``, with a row every ``period`` [s], as comma-separated text.

        Raises `OutputError` where the file cannot be written, `InvalidInput` as ``table``.
        """
        columns, rows = self.table(period, derivatives, names)
        with as_output_errors(Path(path), "choose another place"):
            np.savetxt(
                path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.17g"
            )

    def to_numpy(self, path: Path | str) -> Path:
        """Write breaks and coefficients to one ``.npz`` file, without loss, and return its path.
        Raises `OutputError` where that fails.
        """
        with as_output_errors(Path(path), "choose another place"):
            np.savez(path, breaks=self.breaks, coefficients=self.coefficients)
        return Path(path)

    @staticmethod
    def from_numpy(path: Path | str) -> PiecewisePolynomial:
        """Read what ``to_numpy`` wrote. Raises `InvalidInput` for any other file, or none."""
        try:
            arrays = read_arrays(path)
            if "__meta__" in arrays:
                raise InvalidInput("a record; give the plan.npz beside it")
            missing = [name for name in ("breaks", "coefficients") if name not in arrays]
            if missing or len(arrays) > 2:
                raise InvalidInput(
                    f"it holds {', '.join(sorted(arrays)[:5])}; allowed: breaks and coefficients"
                )
            return PiecewisePolynomial(**arrays)
        except ValueError as error:
            raise InvalidInput(
                f"{printable(path)}: not a trajectory written by to_numpy ({error})."
            ) from error


@checked
def concatenate(curves: Sequence[PiecewisePolynomial]) -> PiecewisePolynomial:
    """Join one curve after the other, each shifted to begin where the one before ends; lower
    degrees are padded.

    Raises `InvalidInput` for no curve, or numbers of axes that differ (the offending index is
    named).
    """
    if not curves:
        raise InvalidInput("no curve to concatenate; give at least one.")
    for index, curve in enumerate(curves):
        if curve.n_axes != curves[0].n_axes:
            raise InvalidInput(
                f"curve {index} has {curve.n_axes} axes; curve 0 has {curves[0].n_axes}."
            )
    degree = max(curve.degree for curve in curves)
    durations = np.concatenate([curve.durations for curve in curves])
    breaks = curves[0].start + np.concatenate([[0.0], np.cumsum(durations)])
    padded = list[Array]()
    for curve in curves:
        n_missing = degree - curve.degree
        padded.append(np.pad(curve.coefficients, ((0, n_missing), (0, 0), (0, 0))))
    return PiecewisePolynomial(breaks=breaks, coefficients=np.concatenate(padded, axis=1))


def _check_breaks(breaks: Array) -> None:
    """Raise `InvalidInput` for times that are too few, not finite or do not increase."""
    if breaks.ndim != 1 or breaks.size < 2:
        raise InvalidInput(
            f"breaks have shape {breaks.shape}; allowed is (n_pieces + 1,) with n_pieces >= 1."
        )
    is_not_increasing = ~(np.diff(breaks) > 0.0)
    is_finite = np.isfinite(breaks)
    if is_not_increasing.any() or not is_finite.all():
        if is_not_increasing.any():
            index = int(np.argmax(is_not_increasing)) + 1
        else:
            index = int(np.argmin(is_finite))
        raise InvalidInput(
            f"break {index} is {breaks[index]}; breaks must be finite and increase [s]."
        )


def _check_coefficients(coefficients: Array, n_pieces: int) -> None:
    if coefficients.ndim != 3 or coefficients.shape[1] != n_pieces or 0 in coefficients.shape:
        raise InvalidInput(
            f"coefficients have shape {coefficients.shape}; allowed is (degree + 1, {n_pieces},"
            " n_axes)."
        )
    # The sum is finite in all but a few cases where each term is, and needs no memory.
    if not np.isfinite(coefficients.sum()) and not np.isfinite(coefficients).all():
        index = int(np.argmin(np.isfinite(coefficients).all(axis=(0, 2))))
        raise InvalidInput(f"the coefficients of piece {index} are not finite.")


def _horner_with_rate(coefficients: Array, u: float) -> tuple[Array, Array]:
    """Evaluate polynomials (degree + 1, n_axes) and their slopes at unit time u by Horner's scheme."""
    value = coefficients[-1]
    rate = np.zeros(coefficients.shape[1])
    for row in coefficients[-2::-1]:
        rate = rate * u + value
        value = value * u + row
    return value, rate


def _differentiated(coefficients: Array, order: int) -> Array:
    """Return the coefficients of the order-th derivative by unit time, of all pieces and axes."""
    if order == 0:
        return coefficients
    if order >= coefficients.shape[0]:
        return np.zeros((1, *coefficients.shape[1:]))
    powers = range(order, coefficients.shape[0])
    factors = np.array([factorial(power) / factorial(power - order) for power in powers])
    return coefficients[order:] * factors[:, None, None]


def _unit_peaks(coefficients: Array) -> Array:
    """Return (n_pieces, n_axes) largest absolute value in the unit interval: best of a grid, then
    Newton on the slope.
    """
    grid = _EXTREMUM_GRID[:, None, None]
    values = np.abs(polyval(grid, coefficients[:, None], tensor=False))
    best_index = np.argmax(values, axis=0)
    peaks = np.take_along_axis(values, best_index[None], axis=0)[0]
    u = _EXTREMUM_GRID[best_index]
    first_derivative = _differentiated(coefficients, 1)
    second_derivative = _differentiated(coefficients, 2)
    for _ in range(3):
        slope = polyval(u, first_derivative, tensor=False)
        curvature = polyval(u, second_derivative, tensor=False)
        step = np.divide(slope, curvature, out=np.zeros_like(u), where=curvature != 0.0)
        u = np.clip(u - np.clip(step, -1 / 64, 1 / 64), 0.0, 1.0)
        peaks = np.maximum(peaks, np.abs(polyval(u, coefficients, tensor=False)))
    return peaks
