"""Compute what the constants that a fit held would change if they were otherwise; intervals are
widened by those that are assumed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.identification import parameters, uncertainty
from uvms_ocp.identification.estimates import Estimate
from uvms_ocp.identification.fit import FitContext
from uvms_ocp.identification.identified_numbers import slopes_of
from uvms_ocp.identification.model import stage_of
from uvms_ocp.identification.mounting_checks import Mounting, estimated_mounting
from uvms_ocp.identification.parameters import Declaration, Unknowns
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.segments import PreparedRecording
from uvms_ocp.identification.settings import CalibrationSettings
from uvms_ocp.identification.turning_checks import GyroMounting, estimated_gyro_mounting

_SPREADS = {
    "gain": 0.03,
    "reverse": 0.03,
    "lag": 0.1,
    "delay": 0.01,
    "velocity_delay": 0.01,
    "mass": 0.02,
    "centre_of_mass": 0.005,
    "second_moment": 0.1,
    "velocity_point": 0.02,
    "attitude_turn": 0.01,
    "bias": 0.003,
    "current": 0.01,
    "rate_bias": 0.002,
}
"""Assumed standard deviations of constants: relative for gains, lags and masses, delays [s], points
[m], turns [rad], rates [rad/s], currents [m/s], biases by shares of the weight, and that at an arm
of 1 m.
"""
_ALIKE = {"wrench_offset": "bias", "attitude_offset": "attitude_turn"}
"""Constants of single recordings, by the constant of all recordings that a fit adds to each."""
_FILED = ("mass", "centre_of_mass", "second_moment")
"""Constants of the robot's file."""
_SEEN = ("bias", "current")
"""Assumed constants that are no part of intervals: recordings show them where they are not 0."""
_SCALES = ("velocity scale", "rate scale")
"""Scales of measured channels, which a fit takes for 1."""
_SCALE_SPREAD = 0.01  # assumed standard deviation of a scale that no other channel shows
_SCALE_STEP = 0.01  # by which a channel is scaled to see what that changes
_MIN_SHARE = 0.8  # of a motion that must be explained, so that it shows a scale
_NEXT_TO_NOTHING = 1e-9  # [1 / unknowns^2] of information, so that no matrix is singular
_NOISES = {"velocity": "m/s", "rate": "rad/s", "vertical": "-", "process": "m/s, rad/s, rad"}
"""Standard deviations of noise that weigh samples, with their units; each is doubled to see its
effect.
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class HeldConstant:
    """A quantity that a fit held, and its effect on the numbers."""

    quantity: str
    """Name of the quantity; of noise with the word before it, as ``noise velocity``; of a channel's
    scale with the word after it, as ``velocity scale``.
    """
    known: str
    """``given`` by the settings, of the ``robot's file``, ``shown`` by other channels, or
    ``assumed``.
    """
    spread: float
    """Assumed standard deviation, relative or in [s], [m] or [rad]; for noise the relative increase
    that is looked at.
    """
    most_changed: str
    """Name of the number that such a deviation changes most, in its standard errors."""
    change: float
    """[standard errors] change of that number."""
    value: float = 0.0
    """[unit] value of a noise or a scale in the fit; 0 for other constants, which the declaration has."""
    unit: str = ""
    """Unit of `value`."""


def held_constants(
    fitted: FitContext, settings: CalibrationSettings, inflation: float
) -> tuple[Estimate, tuple[HeldConstant, ...]]:
    """Return the estimate with the uncertainty from assumed constants added, and all constants that
    a fit held.
    """
    quantities = fitted.vehicle.shared.declaration.quantities
    held_names = [name for name in _SPREADS if not quantities[name].free.any()]
    names, slopes = constant_slopes(fitted, held_names)
    owners = np.array([name.partition(" ")[0] for name in names])
    units = _units(fitted)
    spreads = [_SPREADS[name] * units.get(name, 1.0) for name in owners]
    unknowns_moved = slopes * spreads
    effects = _Effects(fitted, inflation)
    constants = []
    assumed = fitted.estimate.assumed
    for name in dict.fromkeys(owners.tolist()):
        origin = _origin(name, settings)
        moved = unknowns_moved[:, owners == name]
        if origin == "assumed" and name not in _SEEN:
            assumed = assumed + moved @ moved.T
        number, change = effects.largest(moved)
        alike = [quantity for quantity, constant in _ALIKE.items() if constant == name]
        for quantity in (name, *alike):
            if quantity == name or not quantities[quantity].free.any():
                constants.append(
                    HeldConstant(
                        quantity=quantity,
                        known=origin,
                        spread=_SPREADS[name],
                        most_changed=number,
                        change=change,
                    )
                )
    for name, moved in _moved_by_scales(fitted):
        known, spread = _scale_spread(name, fitted)
        moved = spread * moved
        assumed = assumed + moved @ moved.T
        number, change = effects.largest(moved)
        constants.append(
            HeldConstant(
                quantity=name,
                known=known,
                spread=spread,
                most_changed=number,
                change=change,
                value=1.0,
                unit="-",
            )
        )
    constants += _noise_constants(fitted, settings, effects)
    return replace(fitted.estimate, assumed=assumed), tuple(constants)


def constant_slopes(
    fitted: FitContext, constants: Sequence[str]
) -> tuple[tuple[str, ...], np.ndarray]:
    """Return the names of m coordinates that a fit held, and slopes (n, m) of its n unknowns with
    these.

    Constants that each recording has for itself are taken to be off in all of them alike.
    """
    unknowns = fitted.vehicle.shared
    quantities = dict(fitted.vehicle.shared.declaration.quantities)
    for name in constants:
        all_free = np.ones_like(quantities[name].free)
        quantities[name] = replace(quantities[name], free=all_free, per_recording=False)
    all_unknowns = Unknowns(Declaration(quantities=quantities))
    learnt = np.isin(all_unknowns.names, unknowns.names)
    point = all_unknowns.start
    point[learnt] = fitted.estimate.shared
    per_recording = Unknowns(all_unknowns.declaration, per_recording=True)
    vehicle = replace(fitted.vehicle, shared=all_unknowns, per_recording=per_recording)
    rollout = Rollout(stage_of(vehicle, sharp=True))
    problem = replace(fitted, vehicle=vehicle, rollout=rollout).problem()
    start = problem.resumed(replace(fitted.estimate, shared=point))
    H = problem.solve(start, iterations=0).information
    stiffness = H[np.ix_(learnt, learnt)] + _NEXT_TO_NOTHING * np.eye(int(learnt.sum()))
    to_constants = H[np.ix_(learnt, ~learnt)]
    try:
        slopes = -np.linalg.solve(stiffness, to_constants)
    except np.linalg.LinAlgError:  # unknowns that nothing tells do not move
        slopes = -np.linalg.pinv(stiffness, hermitian=True) @ to_constants
    return tuple(np.array(all_unknowns.names)[~learnt].tolist()), slopes


def _units(fitted: FitContext) -> dict[str, float]:
    """Return the factors by which some spreads are multiplied: delays are searched by their
    logarithms, biases are shares of the weight.
    """
    quantities = fitted.vehicle.shared.declaration.quantities
    units = {}
    for name in parameters.DELAYS:
        units[name] = 1.0 / max(quantities[name].value.item(), parameters.AT_ONCE)
    gravity = float(np.linalg.norm(fitted.vehicle.dynamics.model.gravity.linear))  # [m/s2]
    units["bias"] = gravity * quantities["mass"].value.item()
    return units


def _origin(name: str, settings: CalibrationSettings) -> str:
    """Say how a constant is known."""
    if getattr(settings, name, None) is not None:
        return "given"
    is_lag_of_file = name == "lag" and settings.commands != "wrench"
    if name in _FILED or is_lag_of_file:
        return "robot's file"
    return "assumed"


class _Effects:
    """Changes of a robot's numbers that follow from changes of the unknowns of a fit."""

    def __init__(self, fitted: FitContext, inflation: float) -> None:
        """inflation: factor on the variance for residuals that are alike, of
        `variance_inflation`.
        """
        named, slopes = slopes_of(fitted.vehicle, fitted.estimate.shared)
        C = uncertainty.covariance(fitted.vehicle, fitted.estimate, inflation)
        self._names = [name for _, name in named]
        self._slopes = slopes
        self._errors = np.sqrt(np.einsum("ij,jk,ik->i", slopes, C, slopes))

    def largest(self, moved: np.ndarray) -> tuple[str, float]:
        """Find the number that changes (n, m) of the unknowns move farthest, and how far [standard
        errors].
        """
        changes = np.linalg.norm(self._slopes @ moved, axis=1) / self._errors
        return self._names[int(np.argmax(changes))], float(changes.max())


def _moved_by_scales(fitted: FitContext) -> Iterator[tuple[str, np.ndarray]]:
    """Yield each scale of a measured channel with the slopes (n, 1) of the unknowns with it.

    A rate that was taken from an attitude has no scale; a velocity that was taken from positions has
    theirs.
    """
    factor = 1.0 + _SCALE_STEP
    for name in _SCALES:
        prepared = []
        n_scaled = 0
        for part in fitted.prepared:
            scaled = part
            if name == "velocity scale":
                velocity = part.recording.channel("linear_velocity")
                velocity = replace(velocity, values=factor * velocity.values)
                channels = {**part.recording.channels, "linear_velocity": velocity}
                recording = replace(part.recording, channels=channels)
                scaled = replace(part, recording=recording)
                n_scaled += 1
            elif "angular_velocity" in part.recording.channels:
                rate = replace(part.rate, values=factor * part.rate.values)
                scaled = replace(part, rate=rate)
                n_scaled += 1
            prepared.append(scaled)
        if not n_scaled:
            continue
        problem = replace(fitted, prepared=tuple(prepared)).problem()
        point, _ = problem.stepped(problem.resumed(fitted.estimate))
        yield name, (point.shared - fitted.estimate.shared)[:, None] / _SCALE_STEP


def _scale_spread(name: str, fitted: FitContext) -> tuple[str, float]:
    """Return how the scale of a channel is known, and by how much it may be off: as much as other
    channels say that it is, with their standard error, at worst of all recordings.
    """
    spreads = []
    is_shown_by_all = True
    for part in fitted.prepared:
        mounting: Mounting | GyroMounting | None
        if name == "velocity scale":
            mounting = _velocity_mounting(part)
        elif "angular_velocity" in part.recording.channels:
            mounting = _gyro_mounting(part)
        else:
            continue
        if mounting is not None and mounting.share > _MIN_SHARE:
            spreads.append(float(np.hypot(mounting.scale - 1.0, mounting.scale_sigma)))
        else:
            is_shown_by_all = False
    if is_shown_by_all:
        return "shown", max(spreads)
    return "assumed", max([*spreads, _SCALE_SPREAD])


def _velocity_mounting(part: PreparedRecording) -> Mounting | None:
    """Estimate the mounting of a sensor of velocity; `None` where velocity or position were not
    measured, each by itself.
    """
    channels = part.recording.channels
    if not part.has_velocity or "position" not in channels:
        return None
    needed = ("attitude", "linear_velocity", "position")
    if any(channels[name].constants for name in needed):
        return None
    return estimated_mounting(part.recording)


def _gyro_mounting(part: PreparedRecording) -> GyroMounting | None:
    """Estimate the mounting of a gyro; `None` where not all of its rates were measured."""
    channels = part.recording.channels
    if any(channels[name].constants for name in ("attitude", "angular_velocity")):
        return None
    return estimated_gyro_mounting(part.recording)


def _noise_constants(
    fitted: FitContext, settings: CalibrationSettings, effects: _Effects
) -> Iterator[HeldConstant]:
    """Yield standard deviations of noise, each with the number that changes most where it is
    doubled.
    """
    for name, unit in _NOISES.items():
        sigma = getattr(fitted.noise, name)
        noise = replace(fitted.noise, **{name: 2.0 * sigma})
        problem = replace(fitted, noise=noise).problem()
        point, _ = problem.stepped(problem.resumed(fitted.estimate))
        number, change = effects.largest((point.shared - fitted.estimate.shared)[:, None])
        yield HeldConstant(
            quantity=f"noise {name}",
            known="given" if name in settings.noise.model_fields_set else "assumed",
            spread=1.0,
            most_changed=number,
            change=change,
            value=sigma,
            unit=unit,
        )
