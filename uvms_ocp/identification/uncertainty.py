"""Uncertainty of a fit: covariance inflated for coloured residuals, unidentifiable directions,
numbers with units, whiteness.

Errors of a model are not white: samples that follow each other miss alike, and count for less than
their number. The information is divided by the number of samples that miss together before standard
errors are taken from it. Mass and added mass of an axis weigh the same in most motions: their sum
is often known where neither is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.identification import coordinates, parameters
from uvms_ocp.identification.fit import Predicted
from uvms_ocp.identification.model import Vehicle
from uvms_ocp.identification.output_error import Estimate, FitStatus, Noise

# How sure the unknowns are, and which combinations of them the recordings leave open.

DETERMINED = 0.3
"""Largest standard error of a coordinate, relative for what is positive, with which it counts as
determined.
"""
NARROWED = 0.7
"""Share of a prior's deviation below which recordings say more than the prior."""
_NOTHING = 1e-12  # of information: all that is known where there is none
_LEAST_SHARE = 0.3  # of the largest entry of a combination

_MOVED = 0.1  # [noise] less is left of what does not move, as along an axis that is held

DETERMINED_BELOW = 0.1
"""Largest standard error, relative to the size of a number, with which it counts as determined."""
INTERVAL = 1.96
"""Standard errors to either side, in which 95 % lie."""
TOTAL = "mass and added mass"
SIZES = {"m": 0.05, "s": 0.05, "rad": 0.05, "m/s": 0.05, "N, N m": 1.0}
"""[unit] of numbers that may be zero; others are compared with themselves."""
_XYZ = ("x", "y", "z")

_Entry = tuple[str, str, str, bool]
"""Quantity, entry, unit and whether it can only be positive, as `IdentifiedNumber` has them."""

CHANNELS = (*parameters.AXES, "vertical x", "vertical y", "vertical z")
"""Channels of the three sensors, three of each."""
LEVEL = 0.05
"""Level of the test: share of white residuals that it takes for coloured."""
MISSES = 5.0
"""Size of coloured residuals of a channel, in standard deviations of the noise, beyond which no
number counts as determined.
"""
LEAST_P = 1e-6
"""Chance that is not told more exactly."""
_LAGS = 20


@dataclass(frozen=True, kw_only=True, slots=True)
class UnidentifiableDirection:
    """A combination of unknowns that the recordings do not determine."""

    sigma: float
    """[as `Unknowns.start`] standard error along it, priors left out."""
    shares: tuple[tuple[str, float], ...]
    """Names of unknowns and their entries [-] in it, the largest first."""


def standard_errors(vehicle: Vehicle, estimate: Estimate, inflation: float = 1.0) -> np.ndarray:
    """Compute standard errors (n,) [as `Unknowns.start`] of the shared unknowns. inflation: samples
    that miss alike, as `variance_inflation` finds.
    """
    return np.sqrt(np.diag(covariance(vehicle, estimate, inflation)))


def covariance(vehicle: Vehicle, estimate: Estimate, inflation: float = 1.0) -> np.ndarray:
    """Compute the covariance (n, n) [unknowns^2] of the shared unknowns, by recordings and priors.

    inflation: samples that miss alike, as `variance_inflation` finds. Priors of delays are as wide
    in seconds as where the search began: next to 0 a coordinate says nothing of the other side.
    """
    shared = vehicle.shared
    is_delay = [name in parameters.DELAYS for name in shared.names]
    widening = np.where(is_delay, np.cosh(estimate.shared) / np.cosh(shared.start), 1.0)
    prior_sigma = shared.sigma * np.maximum(widening, 1.0) ** 2
    prior = np.diag(1.0 / prior_sigma**2 + _NOTHING)
    known = _data(vehicle, estimate, inflation) + prior
    try:
        covariance_by_data = np.linalg.inv(known)
    except np.linalg.LinAlgError:  # unknowns that differ by powers of ten in what is known of them
        scale = 1.0 / np.sqrt(np.diag(known))
        scaled = known * np.outer(scale, scale) + _NOTHING * np.eye(len(known))
        covariance_by_data = np.linalg.inv(scaled) * np.outer(scale, scale)
    return np.asarray(covariance_by_data + estimate.assumed)


def unidentifiable_directions(
    vehicle: Vehicle, estimate: Estimate, inflation: float = 1.0
) -> tuple[UnidentifiableDirection, ...]:
    """List combinations of which less is known than `DETERMINED`, the worst first.

    inflation: samples that miss alike, as `variance_inflation` finds.
    """
    values, axes = np.linalg.eigh(_data(vehicle, estimate, inflation))
    directions = []
    for value, axis in zip(values, axes.T, strict=True):
        sigma = 1.0 / np.sqrt(max(float(value), _NOTHING))
        if sigma > DETERMINED:
            order = np.argsort(-np.abs(axis))
            main = [i for i in order if abs(axis[i]) > _LEAST_SHARE * abs(axis[order[0]])]
            shares = tuple((vehicle.shared.names[i], float(axis[i])) for i in main)
            directions.append(UnidentifiableDirection(sigma=sigma, shares=shares))
    return tuple(directions)


def _data(vehicle: Vehicle, estimate: Estimate, inflation: float) -> np.ndarray:
    """Return the information of the recordings alone."""
    return np.asarray(estimate.information - np.diag(1.0 / vehicle.shared.sigma**2)) / inflation


def variance_inflation(predicted: Predicted, noise: Noise) -> float:
    """Estimate the variance inflation: samples of a prediction that miss alike, times their squared
    miss relative to `noise`; at least 1.

    By Bartlett's formula, ``1 + 2 sum rho_k``, up to the first lag at which residuals are no longer
    correlated. The mean over the channels, but no less than of any that the model does not explain:
    what is wrong with it may be wrong for all numbers.
    """
    inflations = []
    for _, residual, _ in _residuals(predicted, noise):
        if np.ptp(residual) > _MOVED:
            square = float((residual**2).mean())
            inflations.append(square * bartlett(residual - residual.mean()))
    inflation = max(1.0, float(np.mean(inflations or [1.0])))
    for test in whiteness(predicted, noise):
        if test.unexplained:
            inflation = max(inflation, test.size**2 * test.inflation)
    return inflation


def bartlett(residual: np.ndarray) -> float:
    """Compute ``1 + 2 sum rho_k`` of a residual (m,) [any] with mean zero, up to the first lag
    without correlation.
    """
    n = len(residual)
    rho = autocorrelation(residual)[1:]
    below = np.flatnonzero(rho < 2.0 / np.sqrt(n))
    return 1.0 + 2.0 * float(rho[: below[0] if len(below) else n].sum())


def autocorrelation(residual: np.ndarray) -> np.ndarray:
    """Compute the autocorrelation (m,) from lag 0 on, of a residual (m,) [any] with mean zero."""
    n = len(residual)
    spectrum = np.fft.rfft(residual, 1 << (2 * n - 1).bit_length())
    covariances = np.fft.irfft((spectrum * spectrum.conj()).real)[:n]
    return np.asarray(covariances / max(float(covariances[0]), 1e-300))


# What has been learnt, as numbers of the vehicle with their units: entries of quantities, and what
# each axis has to move.


@dataclass(frozen=True, kw_only=True, slots=True)
class IdentifiedNumber:
    """A number of the vehicle with its standard error and 95 % interval, such as the added mass in
    surge.
    """

    quantity: str
    """Quantity of the declaration, or `TOTAL`."""
    entry: str
    """Axis, axes of row and column, or name of an actuator; empty where there is one."""
    unit: str
    value: float
    """[unit]"""
    sigma: float
    """[unit] standard error."""
    size: float
    """[unit] that errors are relative to."""
    informed: bool
    """True if the recordings say more than the priors."""
    positive: bool
    """True if it can only be positive."""
    settled: bool = True
    """True if the search has converged: else its standard error means nothing."""
    explained: bool = True
    """True unless residuals of a channel are coloured and many times the noise: then numbers lie
    anywhere.
    """

    @property
    def name(self) -> str:
        """Name, as ``added_mass surge``."""
        return f"{self.quantity} {self.entry}".strip()

    @property
    def determined(self) -> bool:
        """True if the recordings determine it to within `DETERMINED_BELOW`, and the search has
        converged and explains them.
        """
        return (
            self.settled
            and self.explained
            and self.informed
            and self.sigma < DETERMINED_BELOW * self.size
        )

    @property
    def interval(self) -> tuple[float, float]:
        """[unit] that holds it with 95 %: all that there is, where the search has not converged."""
        if not self.settled:
            return 0.0 if self.positive else -np.inf, np.inf
        if self.positive:
            factor = float(np.exp(min(INTERVAL * self.sigma / max(self.value, 1e-300), 500.0)))
            return self.value / factor, self.value * factor
        return self.value - INTERVAL * self.sigma, self.value + INTERVAL * self.sigma


def numbers(
    vehicle: Vehicle, estimate: Estimate, inflation: float = 1.0, left: Sequence[Whiteness] = ()
) -> tuple[IdentifiedNumber, ...]:
    """Return every number that depends on a shared unknown, as far as the model explains the
    recordings.

    inflation: samples that miss alike, as in `standard_errors`. left: residuals of all channels.
    """
    identified = numbers_at(vehicle, estimate.shared, covariance(vehicle, estimate, inflation))
    explained = not any(test.unexplained and test.size > MISSES for test in left)
    return tuple(
        replace(number, settled=estimate.status is FitStatus.CONVERGED, explained=explained)
        for number in identified
    )


def numbers_at(vehicle: Vehicle, shared: np.ndarray, C: np.ndarray) -> tuple[IdentifiedNumber, ...]:
    """Return the identified numbers at unknowns shared (n,) [as `Unknowns.start`] with a covariance
    C (n, n) [unknowns^2].
    """
    entries, values, slopes = _entries(vehicle, shared)
    # Without recordings.
    prior_covariance = np.diag(1.0 / (1.0 / vehicle.shared.sigma**2 + _NOTHING))
    sigmas = _propagated(slopes, C)
    prior_sigmas = _propagated(slopes, prior_covariance)
    identified = []
    for k, (quantity, entry, unit, positive) in enumerate(entries):
        value = float(values[k])
        identified.append(
            IdentifiedNumber(
                quantity=quantity,
                entry=entry,
                unit=unit,
                value=value,
                sigma=float(sigmas[k]),
                size=SIZES.get(unit, abs(value)),
                informed=bool(sigmas[k] < NARROWED * prior_sigmas[k]),
                positive=positive,
            )
        )
    return tuple(identified)


def _propagated(slopes: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Compute standard deviations (m,) of numbers from slopes (m, n) and a covariance C (n, n)."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, C, slopes), 0.0)))


def slopes_of(vehicle: Vehicle, shared: np.ndarray) -> tuple[list[tuple[str, str]], np.ndarray]:
    """Return quantities and names of the same numbers, and their slopes (m, n) [units of numbers,
    per unknown].

    At unknowns shared (n,) [as `Unknowns.start`].
    """
    entries, _, slopes = _entries(vehicle, shared)
    return [(quantity, f"{quantity} {entry}".strip()) for quantity, entry, _, _ in entries], slopes


def number_of(
    vehicle: Vehicle, number: IdentifiedNumber
) -> Callable[[np.ndarray], tuple[float, np.ndarray]]:
    """Make the function from unknowns (n,) to one of `numbers`: its value [unit], or logarithm
    where it is positive; its slope.
    """
    theta = ca.SX.sym("theta", len(vehicle.shared.start))
    (value,) = (
        candidate
        for entry, candidate in _pairs(vehicle, theta)
        if entry[:2] == (number.quantity, number.entry)
    )
    if number.positive:
        scaled = ca.log(value)
    else:
        scaled = value
    function = ca.Function("number", [theta], [scaled, ca.densify(ca.jacobian(scaled, theta))])

    def evaluate(shared: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = function(shared)
        return float(value), np.asarray(slope).ravel()

    return evaluate


@checked
def values_of(vehicle: Vehicle, shared: np.ndarray) -> np.ndarray:
    """Compute values (m,) [units of `numbers`] of the same numbers at other unknowns shared (n,)
    [as `Unknowns.start`].
    """
    return _entries(vehicle, shared)[1]


def _entries(vehicle: Vehicle, shared: np.ndarray) -> tuple[list[_Entry], np.ndarray, np.ndarray]:
    """List all numbers, with values (m,) and their slopes (m, n)."""
    theta = ca.SX.sym("theta", len(shared))
    pairs = _pairs(vehicle, theta)
    stacked = ca.vertcat(*(value for _, value in pairs))
    function = ca.Function(
        "numbers", [theta], [ca.densify(stacked), ca.densify(ca.jacobian(stacked, theta))]
    )
    values, slopes = map(np.asarray, function(shared))
    chosen = np.flatnonzero(np.abs(slopes).sum(axis=1))
    return [pairs[k][0] for k in chosen], values.ravel()[chosen], slopes[chosen]


def _pairs(vehicle: Vehicle, theta: ca.SX) -> list[tuple[_Entry, ca.SX]]:
    quantities = vehicle.shared.values(theta)
    pairs = list[tuple[_Entry, ca.SX]]()
    for name, value in quantities.items():
        quantity = vehicle.shared.declaration.quantities[name]
        if value.shape[1] > 1:
            pairs += _of_matrix(name, quantity.unit, value)
            continue
        positive = quantity.unit not in SIZES or name == "lag"
        for k, entry in enumerate(quantity.coordinates.names):
            pairs.append(((name, entry, quantity.unit, positive), value[k]))
    return [*pairs, *_totals(quantities)]


def _of_matrix(name: str, unit: str, value: ca.SX) -> Iterator[tuple[_Entry, ca.SX]]:
    axes = parameters.AXES if value.shape[0] == len(parameters.AXES) else _XYZ
    symmetric = "drag" not in name
    for i, row in enumerate(axes):
        for j, column in enumerate(axes):
            if i >= j or not symmetric:
                yield (name, row if i == j else f"{row}-{column}", unit, i == j), value[i, j]


def _totals(quantities: dict[str, ca.SX]) -> Iterator[tuple[_Entry, ca.SX]]:
    """Yield total inertias of rigid body and added mass, about the frame of the vehicle's joint."""
    inertia = coordinates.spatial_inertia(
        quantities["mass"], quantities["centre_of_mass"], quantities["second_moment"]
    )
    for k, axis in enumerate(parameters.AXES):
        unit = "kg" if k < len(_XYZ) else "kg m2"
        yield (TOTAL, axis, unit, True), inertia[k, k] + quantities["added_mass"][k, k]


# Whether what a search has left is white noise: then the model has nothing more to say, and samples
# count one by one.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Whiteness:
    """Whiteness test of the residuals of one channel."""

    channel: str
    size: float
    """Root mean square of the residuals, by the noise that was expected."""
    inflation: float
    """Samples that miss alike, by Bartlett's formula."""
    p: float
    """p-value of the Ljung-Box test."""
    correlation: np.ndarray
    """(k + 1,) autocorrelation from lag 0 on, in samples."""
    interval: float
    """[s] between samples, in the median."""
    bound: float
    """Bound within which 95 % of the correlations of white noise lie."""

    @property
    def white(self) -> bool:
        """True if the test does not reject whiteness."""
        return self.p >= LEVEL

    @property
    def unexplained(self) -> bool:
        """True if residuals are coloured and so large that standard errors of the channel alone
        would be twice as large.
        """
        return not self.white and self.size**2 * self.inflation > 4.0


def whiteness(predicted: Predicted, noise: Noise) -> tuple[Whiteness, ...]:
    """Test the whiteness of every channel in `CHANNELS` that has residuals."""
    return tuple(
        _whiteness(*entry) for entry in _residuals(predicted, noise) if np.ptp(entry[1]) > 0.0
    )


def _residuals(predicted: Predicted, noise: Noise) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield channels in `CHANNELS`, their residuals (m,), relative to the noise, and times (m,)
    [s].
    """
    for k, sigma in enumerate((noise.velocity, noise.rate, noise.vertical)):
        residuals = (predicted.rows[k] - predicted.measured[k]) / sigma
        names = CHANNELS[3 * k : 3 * k + 3]
        for name, residual in zip(names, residuals.T, strict=True):
            yield name, residual, predicted.t[k]


def _whiteness(name: str, residual: np.ndarray, t: np.ndarray) -> Whiteness:
    p, rho = ljung_box(residual)
    return Whiteness(
        channel=name,
        size=float(np.sqrt((residual**2).mean())),
        inflation=bartlett(residual - residual.mean()),
        p=p,
        correlation=rho,
        interval=float(np.median(np.diff(t))),
        bound=1.96 / float(np.sqrt(len(residual))),
    )


def ljung_box(residual: np.ndarray, lags: int = _LAGS) -> tuple[float, np.ndarray]:
    """Compute the probability that white noise is as correlated as a residual (m,) [any], and its
    autocorrelation (k + 1,).

    lags: that are looked at, a fifth of the samples at most. What a model has been fitted to has a
    little less freedom than the test believes.
    """
    from scipy.special import gammaincc  # a tenth of a second

    n = len(residual)
    k = max(1, min(lags, n // 5))
    rho = autocorrelation(residual - residual.mean())[: k + 1]
    statistic = n * (n + 2) * float((rho[1:] ** 2 / (n - np.arange(1, k + 1))).sum())
    return float(gammaincc(k / 2, statistic / 2)), rho
