"""Turn the unknowns of a fit into numbers of the vehicle, with units, standard errors and intervals.

Numbers are the entries of its quantities, and what each axis has to move. Mass and added mass of an
axis weigh the same in most motions: their sum is often known where neither is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.identification import coordinates, parameters
from uvms_ocp.identification.estimates import Estimate, FitStatus
from uvms_ocp.identification.model import Vehicle
from uvms_ocp.identification.uncertainty import NEXT_TO_NOTHING, covariance
from uvms_ocp.identification.whiteness import Whiteness

NARROWED = 0.7
"""Share of a prior's deviation below which recordings say more than the prior."""
DETERMINED_BELOW = 0.1
"""Largest standard error, relative to the size of a number, with which it counts as determined."""
INTERVAL = 1.96
"""Standard errors to either side, in which 95 % lie."""
TOTAL = "mass and added mass"
"""Name of the total inertia of an axis, as a quantity."""
SIZES = {"m": 0.05, "s": 0.05, "rad": 0.05, "m/s": 0.05, "N, N m": 1.0}
"""By unit: size [unit] that errors of numbers which may be zero are compared with; errors of others are
compared with the number itself.
"""
_XYZ = ("x", "y", "z")
_Entry = tuple[str, str, str, bool]
"""Quantity, entry, unit and whether it can only be positive, as `IdentifiedNumber` has them."""
MISSES = 5.0
"""Size of coloured residuals of a channel, in standard deviations of the noise, beyond which no
number counts as determined.
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class IdentifiedNumber:
    """A number of the vehicle with its standard error and 95 % interval, such as the added mass in
    surge.
    """

    quantity: str
    """Quantity of the declaration, or `TOTAL`."""
    entry: str
    """Axis, axes of row and column, or name of an actuator; empty where the quantity is one number."""
    unit: str
    value: float
    """[unit] value at the estimate."""
    sigma: float
    """[unit] standard error."""
    size: float
    """[unit] size that the standard error is compared with."""
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
        """[unit] interval that holds it with 95 %; unbounded where the search has not converged."""
        if not self.settled:
            lower = 0.0 if self.positive else -np.inf
            return lower, np.inf
        if self.positive:
            factor = float(np.exp(min(INTERVAL * self.sigma / max(self.value, 1e-300), 500.0)))
            return self.value / factor, self.value * factor
        return self.value - INTERVAL * self.sigma, self.value + INTERVAL * self.sigma


def numbers(
    vehicle: Vehicle,
    estimate: Estimate,
    inflation: float = 1.0,
    whiteness_tests: Sequence[Whiteness] = (),
) -> tuple[IdentifiedNumber, ...]:
    """Return every number that depends on a shared unknown, as far as the model explains the
    recordings.

    inflation: number of samples that miss alike, by `variance_inflation`. whiteness_tests: of the
    residuals of all channels.
    """
    identified = numbers_at(vehicle, estimate.shared, covariance(vehicle, estimate, inflation))
    explained = not any(test.unexplained and test.size > MISSES for test in whiteness_tests)
    return tuple(
        replace(number, settled=estimate.status is FitStatus.CONVERGED, explained=explained)
        for number in identified
    )


def numbers_at(vehicle: Vehicle, shared: np.ndarray, C: np.ndarray) -> tuple[IdentifiedNumber, ...]:
    """Return the identified numbers at unknowns shared (n,) [as `Unknowns.start`] with a covariance
    C (n, n) [unknowns^2].
    """
    entries, values, slopes = _entries(vehicle, shared)
    prior_information = 1.0 / vehicle.shared.sigma**2 + NEXT_TO_NOTHING
    prior_covariance = np.diag(1.0 / prior_information)
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


@checked
def values_of(vehicle: Vehicle, shared: np.ndarray) -> np.ndarray:
    """Compute the values (m,) [units of `numbers`] of all `numbers` at unknowns shared (n,) [as
    `Unknowns.start`].
    """
    _, values, _ = _entries(vehicle, shared)
    return values


def slopes_of(vehicle: Vehicle, shared: np.ndarray) -> tuple[list[tuple[str, str]], np.ndarray]:
    """Return quantities and names of all `numbers`, and their slopes (m, n) [units of numbers, per
    unknown] at unknowns shared (n,) [as `Unknowns.start`].
    """
    entries, _, slopes = _entries(vehicle, shared)
    names = [(quantity, f"{quantity} {entry}".strip()) for quantity, entry, _, _ in entries]
    return names, slopes


def number_of(
    vehicle: Vehicle, number: IdentifiedNumber
) -> Callable[[np.ndarray], tuple[float, np.ndarray]]:
    """Make the function from unknowns (n,) to one of `numbers`: its value [unit], or the logarithm of
    it where it is positive, and its slope (n,).
    """
    theta = ca.SX.sym("theta", len(vehicle.shared.start))
    expressions = {entry[:2]: expression for entry, expression in _pairs(vehicle, theta)}
    value = expressions[number.quantity, number.entry]
    if number.positive:
        scaled = ca.log(value)
    else:
        scaled = value
    function = ca.Function("number", [theta], [scaled, ca.densify(ca.jacobian(scaled, theta))])

    def evaluate(shared: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = function(shared)
        return float(value), np.asarray(slope).ravel()

    return evaluate


def _propagated(slopes: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Compute standard deviations (m,) of numbers from slopes (m, n) and a covariance C (n, n)."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, C, slopes), 0.0)))


def _entries(vehicle: Vehicle, shared: np.ndarray) -> tuple[list[_Entry], np.ndarray, np.ndarray]:
    """List the numbers that depend on unknowns shared (n,), with their values (m,) and slopes (m, n)."""
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
    """List all entries of quantities and totals, with their expressions in theta (n,)."""
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
    """Yield the entries of a matrix; of a symmetric one those on and below its diagonal."""
    axes: tuple[str, ...] = _XYZ
    if value.shape[0] == len(parameters.AXES):
        axes = parameters.AXES
    is_symmetric = "drag" not in name
    for i, row in enumerate(axes):
        for j, column in enumerate(axes):
            if i < j and is_symmetric:
                continue
            entry = row if i == j else f"{row}-{column}"
            yield (name, entry, unit, i == j), value[i, j]


def _totals(quantities: dict[str, ca.SX]) -> Iterator[tuple[_Entry, ca.SX]]:
    """Yield total inertias of rigid body and added mass, about the frame of the vehicle's joint."""
    inertia = coordinates.spatial_inertia(
        quantities["mass"], quantities["centre_of_mass"], quantities["second_moment"]
    )
    for k, axis in enumerate(parameters.AXES):
        unit = "kg" if k < len(_XYZ) else "kg m2"
        yield (TOTAL, axis, unit, True), inertia[k, k] + quantities["added_mass"][k, k]
