"""What has been learnt, as numbers of the vehicle with their units: entries of quantities, and what each axis has to move.

Mass and added mass of an axis weigh the same in most motions: their sum is often known where neither is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from uvms_ocp.identification.answers.certainty import NARROWED, covariance, prior_covariance
from uvms_ocp.identification.methods.output_error import Estimate, FitStatus
from uvms_ocp.identification.models.stage import Vehicle
from uvms_ocp.identification.parameters.rigid_body import spatial_inertia
from uvms_ocp.identification.parameters.vehicle_quantities import AXES

KNOWN = 0.1
"""[-] largest standard error, relative to the size of a number, with which it counts as determined."""
INTERVAL = 1.96
"""[-] standard errors to either side, in which 95 % lie."""
TOTAL = "mass and added mass"
SIZES = {"m": 0.05, "s": 0.05, "rad": 0.05, "m/s": 0.05, "N, N m": 1.0}
"""[unit] of numbers that may be zero; others are compared with themselves."""
_XYZ = ("x", "y", "z")


@dataclass(frozen=True, kw_only=True, slots=True)
class Number:
    """One."""

    quantity: str
    """Of the declaration, or `TOTAL`."""
    entry: str
    """Axis, axes of row and column, or name of an actuator; empty where there is one."""
    unit: str
    value: float
    """[unit]"""
    sigma: float
    """[unit] standard error."""
    size: float
    """[unit] that errors are relative to."""
    learnt: bool
    """Whether the recordings say more than the priors."""
    positive: bool
    """Whether it can only be positive."""
    settled: bool = True
    """Whether it is where a search has converged: elsewhere its standard error says nothing."""

    @property
    def name(self) -> str:
        """As ``added_mass surge``."""
        return f"{self.quantity} {self.entry}".strip()

    @property
    def determined(self) -> bool:
        """By the recordings, to within `KNOWN`, where the search has converged."""
        return self.settled and self.learnt and self.sigma < KNOWN * self.size

    @property
    def interval(self) -> tuple[float, float]:
        """[unit] that holds it with 95 %: all that there is, where the search has not converged."""
        if not self.settled:
            return 0.0 if self.positive else -np.inf, np.inf
        if self.positive:
            factor = float(np.exp(min(INTERVAL * self.sigma / max(self.value, 1e-300), 500.0)))
            return self.value / factor, self.value * factor
        return self.value - INTERVAL * self.sigma, self.value + INTERVAL * self.sigma


@dataclass(frozen=True, slots=True)
class _Entry:
    quantity: str
    entry: str
    unit: str
    positive: bool


def numbers(vehicle: Vehicle, estimate: Estimate, together: float = 1.0) -> tuple[Number, ...]:
    """Every number that depends on a shared unknown. together: [-] samples that miss alike, as in `certainties`."""
    found = numbers_at(vehicle, estimate.shared, covariance(vehicle, estimate, together))
    return tuple(replace(one, settled=estimate.status is FitStatus.CONVERGED) for one in found)


def numbers_at(vehicle: Vehicle, shared: np.ndarray, C: np.ndarray) -> tuple[Number, ...]:
    """The same at unknowns shared (n,) [as `Unknowns.start`] with a covariance C (n, n) [unknowns^2]."""
    entries, values, slopes = _entries(vehicle, shared)
    sigmas, believed = _deviations(slopes, C), _deviations(slopes, prior_covariance(vehicle))
    return tuple(
        Number(
            quantity=entry.quantity,
            entry=entry.entry,
            unit=entry.unit,
            value=float(value),
            sigma=float(sigma),
            size=SIZES.get(entry.unit, abs(float(value))),
            learnt=bool(sigma < NARROWED * prior),
            positive=entry.positive,
        )
        for entry, value, sigma, prior in zip(entries, values, sigmas, believed, strict=True)
    )


def slopes_of(vehicle: Vehicle, shared: np.ndarray) -> tuple[list[tuple[str, str]], np.ndarray]:
    """Quantities and names of the same numbers, and their slopes (m, n) [units of numbers, per unknown].

    At unknowns shared (n,) [as `Unknowns.start`].
    """
    entries, _, slopes = _entries(vehicle, shared)
    return [(one.quantity, f"{one.quantity} {one.entry}".strip()) for one in entries], slopes


def number_of(vehicle: Vehicle, one: Number) -> Callable[[np.ndarray], tuple[float, np.ndarray]]:
    """One of `numbers`, as it depends on the unknowns (n,): its value [unit], or logarithm where it is positive; its slope."""
    theta = ca.SX.sym("theta", len(vehicle.shared.start))
    pairs = _pairs(vehicle, theta)
    (value,) = (each for entry, each in pairs if (entry.quantity, entry.entry) == (one.quantity, one.entry))
    told = ca.log(value) if one.positive else value
    function = ca.Function("number", [theta], [told, ca.densify(ca.jacobian(told, theta))])
    return lambda shared: _evaluated(function, shared)


def _evaluated(function: ca.Function, shared: np.ndarray) -> tuple[float, np.ndarray]:
    value, slope = function(shared)
    return float(value), np.asarray(slope).ravel()


def values_of(vehicle: Vehicle, shared: np.ndarray) -> np.ndarray:
    """(m,) [units of `numbers`] of the same numbers at other unknowns shared (n,) [as `Unknowns.start`]."""
    return _entries(vehicle, shared)[1]


def _deviations(slopes: np.ndarray, C: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, C, slopes), 0.0)))


def _entries(vehicle: Vehicle, shared: np.ndarray) -> tuple[list[_Entry], np.ndarray, np.ndarray]:
    """With values (m,) and their slopes (m, n)."""
    theta = ca.SX.sym("theta", len(shared))
    pairs = _pairs(vehicle, theta)
    stacked = ca.vertcat(*(value for _, value in pairs))
    function = ca.Function("numbers", [theta], [ca.densify(stacked), ca.densify(ca.jacobian(stacked, theta))])
    values, slopes = (np.asarray(one) for one in function(shared))
    chosen = np.flatnonzero(np.abs(slopes).sum(axis=1))
    return [pairs[k][0] for k in chosen], values.ravel()[chosen], slopes[chosen]


def _pairs(vehicle: Vehicle, theta: ca.SX) -> list[tuple[_Entry, ca.SX]]:
    quantities = vehicle.shared.values(theta)
    return [*_of_quantities(vehicle, quantities), *_totals(quantities)]


def _of_quantities(vehicle: Vehicle, quantities: dict[str, ca.SX]) -> Iterator[tuple[_Entry, ca.SX]]:
    for name, value in quantities.items():
        one = vehicle.shared.declaration.quantities[name]
        if value.shape[1] > 1:
            yield from _of_matrix(name, one.unit, value)
            continue
        positive = one.unit not in SIZES or name == "lag"
        for k, entry in enumerate(one.coordinates.names):
            yield _Entry(name, entry, one.unit, positive), value[k]


def _of_matrix(name: str, unit: str, value: ca.SX) -> Iterator[tuple[_Entry, ca.SX]]:
    axes, symmetric = AXES if value.shape[0] == len(AXES) else _XYZ, "drag" not in name
    for i, row in enumerate(axes):
        for j, column in enumerate(axes):
            if i >= j or not symmetric:
                yield _Entry(name, row if i == j else f"{row}-{column}", unit, i == j), value[i, j]


def _totals(quantities: dict[str, ca.SX]) -> Iterator[tuple[_Entry, ca.SX]]:
    """Of the rigid body and the water with it, about the frame of the vehicle's joint."""
    inertia = spatial_inertia(*(quantities[name] for name in ("mass", "centre_of_mass", "second_moment")))
    for k, axis in enumerate(AXES):
        unit = "kg" if k < len(_XYZ) else "kg m2"
        yield _Entry(TOTAL, axis, unit, True), inertia[k, k] + quantities["added_mass"][k, k]
