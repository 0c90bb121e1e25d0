"""The quantities of a vehicle, all of them known to be what its model says."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from uvms_ocp.identification.parameters.coordinates import Interval, PositiveDefinite, Positives, Reals
from uvms_ocp.identification.parameters.declaration import Declaration, Quantity
from uvms_ocp.identification.parameters.drag import LinearDrag, QuadraticDrag
from uvms_ocp.identification.parameters.rigid_body import second_moment
from uvms_ocp.model.symbolic.dynamics import SymbolicDynamics

AXES = ("surge", "sway", "heave", "roll", "pitch", "yaw")
Pairs = tuple[tuple[int, int], ...]
_XYZ = ("x", "y", "z")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Actuators:
    """What drives the vehicle: thrusters, or the wrench as commanded."""

    names: tuple[str, ...] = AXES
    wrench: np.ndarray = field(default_factory=lambda: np.eye(6))
    """(6, n) [-, m] per unit of each actuator, linear rows first."""
    allocation: np.ndarray = field(default_factory=lambda: np.eye(6))
    """(n, m) [-, 1/m] what each is told, per unit of the commands that are recorded."""
    lag: float = 0.1
    """[s] time constant of all of them."""
    dead_zone: float = 1e-3
    """[N, N m] below which nothing comes of a command."""
    whole_beyond: bool = False
    """Whether all of a command comes beyond it, as thrusters of robot files have it; else its size is missing there."""
    delay: float = 0.1
    """[s] between a command and its effect, lag aside."""
    longest_delay: float = 1.0
    """[s] of commands and of measurements."""
    commands: str = ""
    """Channel of a recording that has them; empty for the only one that a recording has."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Couplings:
    """Pairs of axes that may act on each other."""

    added_mass: Pairs = ()
    linear_drag: Pairs = ()
    quadratic_drag: Pairs = ()
    """Row and column: the force on the first axis from the motion of the second."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Start:
    """Where the search begins, and what coordinates are scaled by: numbers of the vehicle, a positive one for each axis."""

    mass: float
    """[kg]"""
    centre_of_mass: np.ndarray
    """(3,) [m] in the frame of the vehicle's joint."""
    inertia: np.ndarray
    """(3, 3) [kg m2] about the centre of mass."""
    volume: float
    """[m3]"""
    centre_of_buoyancy: np.ndarray
    """(3,) [m] in the frame of the coefficients."""
    added_mass: np.ndarray
    """(6, 6) [kg, kg m, kg m2]"""
    linear_drag: np.ndarray
    """(6, 6) [N/(m/s), N m/(rad/s)]"""
    quadratic_drag: np.ndarray
    """(6, 6) [N/(m/s)^2, N m/(rad/s)^2]"""

    @staticmethod
    def of(dynamics: SymbolicDynamics, link: int = 0) -> Start:
        """As the model has them: of a link in water, and of the joint body that carries it."""
        wet = dynamics.links[link]
        body = dynamics.model.inertias[dynamics.joint_of(link)]
        return Start(
            mass=float(body.mass),
            centre_of_mass=np.asarray(body.lever),
            inertia=np.asarray(body.inertia),
            volume=float(wet.volume),
            centre_of_buoyancy=wet.p_LB,
            added_mass=wet.added_mass,
            linear_drag=wet.linear_drag,
            quadratic_drag=wet.quadratic_drag,
        )


def vehicle_declaration(
    start: Start,
    hull: np.ndarray,
    actuators: Actuators | None = None,
    couplings: Couplings | None = None,
    speed: np.ndarray | None = None,
) -> Declaration:
    """Everything about a vehicle, known; `Declaration.learning` says what is not.

    hull: (2, 3) [m] lowest and highest corner of a box that holds the hull, in the frame of the coefficients. speed: (6,)
    [m/s, rad/s] of the size that velocities have, default 0.3. Raises InvalidInput for numbers that no vehicle has.
    """
    driven, coupled = actuators or Actuators(), couplings or Couplings()
    return Declaration(
        quantities={
            **_body(start, hull),
            **_water(start, coupled, np.full(6, 0.3) if speed is None else np.asarray(speed, dtype=float)),
            **_actuation(driven),
            **_sensing(driven),
            **_of_recordings(),
        }
    )


def _body(start: Start, hull: np.ndarray) -> dict[str, Quantity]:
    S = second_moment(start.inertia)
    moments = PositiveDefinite(axes=_XYZ, scale=np.sqrt(np.diag(S)), couplings=((0, 1), (0, 2), (1, 2)))
    box = Interval(names=_XYZ, lower=np.asarray(hull[0], dtype=float), upper=np.asarray(hull[1], dtype=float))
    return {
        "mass": Quantity.fixed("kg", Positives(names=("",)), np.array([start.mass])),
        "centre_of_mass": Quantity.fixed("m", Reals(names=_XYZ), start.centre_of_mass),
        "second_moment": Quantity.fixed("kg m2", moments, S),
        "volume": Quantity.fixed("m3", Positives(names=("",)), np.array([start.volume])),
        "centre_of_buoyancy": Quantity.fixed("m", box, start.centre_of_buoyancy),
    }


def _water(start: Start, coupled: Couplings, speed: np.ndarray) -> dict[str, Quantity]:
    root = {name: np.sqrt(np.diag(getattr(start, name))) for name in ("added_mass", "linear_drag")}
    added = PositiveDefinite(axes=AXES, scale=root["added_mass"], couplings=coupled.added_mass)
    linear = LinearDrag(symmetric=PositiveDefinite(axes=AXES, scale=root["linear_drag"], couplings=coupled.linear_drag))
    own = np.diag(start.quadratic_drag)
    quadratic = QuadraticDrag(axes=AXES, scale=own, speed=speed, couplings=coupled.quadratic_drag)
    return {
        "added_mass": Quantity.fixed("kg, kg m, kg m2", added, start.added_mass),
        "linear_drag": Quantity.fixed("N/(m/s), N m/(rad/s)", linear, start.linear_drag),
        "quadratic_drag": Quantity.fixed("N/(m/s)^2, N m/(rad/s)^2", quadratic, start.quadratic_drag),
    }


def _actuation(driven: Actuators) -> dict[str, Quantity]:
    each, ones = Positives(names=driven.names), np.ones(len(driven.names))
    return {
        "gain": Quantity.fixed("-", each, ones),
        "reverse": Quantity.fixed("-", each, ones),
        "lag": Quantity.fixed("s", Positives(names=("",)), np.array([driven.lag])),
        "dead_zone": Quantity.fixed("N, N m", each, ones * driven.dead_zone),
        "dead_zone_reverse": Quantity.fixed("N, N m", each, ones * driven.dead_zone),
        "bias": Quantity.fixed("N, N m", Reals(names=AXES), np.zeros(6)),
        "delay": Quantity.fixed("s", _delay(driven), np.array([driven.delay])),
    }


def _sensing(driven: Actuators) -> dict[str, Quantity]:
    """The sensor of attitude and its rate sits in B turned by a rotation vector, to which each recording adds its own."""
    return {
        "velocity_point": Quantity.fixed("m", Reals(names=_XYZ), np.zeros(3)),
        "velocity_delay": Quantity.fixed("s", _delay(driven), np.array([0.01 * driven.longest_delay])),
        "attitude_turn": Quantity.fixed("rad", Reals(names=_XYZ), np.zeros(3)),
    }


def _of_recordings() -> dict[str, Quantity]:
    """What each has for itself."""
    return {
        "current": Quantity.fixed("m/s", Reals(names=_XYZ), np.zeros(3), own=True),
        "wrench_offset": Quantity.fixed("N, N m", Reals(names=AXES), np.zeros(6), own=True),
        "attitude_offset": Quantity.fixed("rad", Reals(names=_XYZ), np.zeros(3), own=True),
    }


def _delay(driven: Actuators) -> Interval:
    return Interval(names=("",), lower=np.zeros(1), upper=np.full(1, driven.longest_delay))
