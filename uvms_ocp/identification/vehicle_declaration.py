"""Declare every quantity of a vehicle: body, water, actuators and sensors, with their units and
coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from uvms_ocp.identification.coordinates import (
    Interval,
    LinearDrag,
    PositiveDefinite,
    Positives,
    QuadraticDrag,
    Reals,
    second_moment,
)
from uvms_ocp.identification.parameters import (
    AT_ONCE,
    Declaration,
    Quantity,
)
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics
from uvms_ocp.robot.thrusters import AXES as AXES

LONGEST_DELAY = 1.0
"""[s] longest delay of commands and of measurements that can be learnt."""
_SPEED = 0.3  # [m/s, rad/s] size that velocities have
_SHORTEST_DELAY = 1e-3  # [s] shortest delay of commands at which a search for it begins
_VELOCITY_DELAY = 0.01  # [s] shortest delay of velocities at which a search for it begins
_XYZ = ("x", "y", "z")
Pairs = tuple[tuple[int, int], ...]
"""Pairs of axes, by their indices."""


def vehicle_declaration(
    start: NominalParameters,
    hull: np.ndarray,
    actuators: ActuatorModel | None = None,
    couplings: AxisCouplings | None = None,
    velocity_delay: float = 0.0,
) -> Declaration:
    """Declare every quantity of a vehicle as fixed; `Declaration.with_status` frees some.

    hull: (2, 3) [m] lowest and highest corner of a box that holds the hull, in the frame of the
    coefficients. velocity_delay: [s] of measured velocity. Raises InvalidInput for numbers that no
    vehicle has.
    """
    return Declaration(
        quantities={
            **_body(start, hull),
            **_water(start, couplings or AxisCouplings()),
            **_actuation(actuators or ActuatorModel()),
            **_sensing(velocity_delay),
        }
    )


def _body(start: NominalParameters, hull: np.ndarray) -> dict[str, Quantity]:
    """Declare mass, its distribution, volume and centre of buoyancy."""
    S = second_moment(start.inertia)
    moments = PositiveDefinite(
        axes=_XYZ, scale=np.sqrt(np.diag(S)), couplings=((0, 1), (0, 2), (1, 2))
    )
    box = Interval(
        names=_XYZ, lower=np.asarray(hull[0], dtype=float), upper=np.asarray(hull[1], dtype=float)
    )
    return {
        "mass": Quantity.fixed("kg", Positives(names=("",)), np.array([start.mass])),
        "centre_of_mass": Quantity.fixed("m", Reals(names=_XYZ), start.centre_of_mass),
        "second_moment": Quantity.fixed("kg m2", moments, S),
        "volume": Quantity.fixed("m3", Positives(names=("",)), np.array([start.volume])),
        "centre_of_buoyancy": Quantity.fixed("m", box, start.centre_of_buoyancy),
    }


def _water(start: NominalParameters, couplings: AxisCouplings) -> dict[str, Quantity]:
    """Declare added mass and drag."""
    added = PositiveDefinite(
        axes=AXES,
        scale=np.sqrt(np.diag(start.added_mass)),
        couplings=couplings.added_mass,
    )
    symmetric = PositiveDefinite(
        axes=AXES,
        scale=np.sqrt(np.diag(start.linear_drag)),
        couplings=couplings.linear_drag,
    )
    linear = LinearDrag(symmetric=symmetric)
    quadratic = QuadraticDrag(
        axes=AXES,
        scale=np.diag(start.quadratic_drag),
        speed=np.full(6, _SPEED),
        couplings=couplings.quadratic_drag,
    )
    return {
        "added_mass": Quantity.fixed("kg, kg m, kg m2", added, start.added_mass),
        "linear_drag": Quantity.fixed("N/(m/s), N m/(rad/s)", linear, start.linear_drag),
        "quadratic_drag": Quantity.fixed(
            "N/(m/s)^2, N m/(rad/s)^2", quadratic, start.quadratic_drag
        ),
    }


def _actuation(actuators: ActuatorModel) -> dict[str, Quantity]:
    """Declare gains, lag, dead zones, bias and delay of the actuators."""
    positives = Positives(names=actuators.names)
    ones = np.ones(len(actuators.names))
    return {
        "gain": Quantity.fixed("-", positives, ones),
        "reverse": Quantity.fixed("-", positives, ones),
        "lag": Quantity.fixed("s", Positives(names=("",)), np.array([actuators.lag])),
        "dead_zone": Quantity.fixed("N, N m", positives, ones * actuators.dead_zone),
        "dead_zone_reverse": Quantity.fixed("N, N m", positives, ones * actuators.dead_zone),
        "bias": Quantity.fixed("N, N m", Reals(names=AXES), np.zeros(6)),
        "delay": _delay(actuators.delay, begin=max(actuators.delay, _SHORTEST_DELAY)),
    }


def _sensing(velocity_delay: float) -> dict[str, Quantity]:
    """Declare the sensors, and what each recording has for itself.

    The sensor of attitude and rate sits in B turned by a rotation vector, to which each recording
    adds an offset. Each recording also has its current, an unknown force, and the bias of its gyro.
    """
    return {
        "velocity_point": Quantity.fixed("m", Reals(names=_XYZ), np.zeros(3)),
        "velocity_delay": _delay(velocity_delay, begin=max(velocity_delay, _VELOCITY_DELAY)),
        "attitude_turn": Quantity.fixed("rad", Reals(names=_XYZ), np.zeros(3)),
        "current": Quantity.fixed("m/s", Reals(names=_XYZ), np.zeros(3), per_recording=True),
        "wrench_offset": Quantity.fixed(
            "N, N m", Reals(names=AXES), np.zeros(6), per_recording=True
        ),
        "attitude_offset": Quantity.fixed(
            "rad", Reals(names=_XYZ), np.zeros(3), per_recording=True
        ),
        "rate_bias": Quantity.fixed("rad/s", Reals(names=_XYZ), np.zeros(3), per_recording=True),
    }


def _delay(delay: float, begin: float) -> Quantity:
    """Make a quantity fixed at a delay [s], of which a search begins at `begin` [s]."""
    inside = Interval(names=("",), lower=np.zeros(1), upper=np.full(1, LONGEST_DELAY))
    quantity = Quantity.fixed("s", inside, np.array([max(delay, AT_ONCE)]))
    return replace(quantity, begin=inside.encode(np.array([begin])))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NominalParameters:
    """Nominal numbers of the vehicle, where the search begins, and by which coordinates are scaled:
    those of each axis are positive.
    """

    mass: float
    """[kg] mass of the rigid body."""
    centre_of_mass: np.ndarray
    """(3,) [m] centre of mass, in the frame of the vehicle's joint."""
    inertia: np.ndarray
    """(3, 3) [kg m2] inertia of the rigid body, about the centre of mass."""
    volume: float
    """[m3] volume of displaced water."""
    centre_of_buoyancy: np.ndarray
    """(3,) [m] in the frame of the coefficients."""
    added_mass: np.ndarray
    """(6, 6) [kg, kg m, kg m2] added mass about the frame of the coefficients, linear rows first."""
    linear_drag: np.ndarray
    """(6, 6) [N/(m/s), N m/(rad/s)] linear drag, linear rows first."""
    quadratic_drag: np.ndarray
    """(6, 6) [N/(m/s)^2, N m/(rad/s)^2] quadratic drag, linear rows first."""

    @staticmethod
    def of(dynamics: SymbolicDynamics, link: int = 0) -> NominalParameters:
        """Read the numbers of a link in water, and of the rigid body that carries it, from the model."""
        wet = dynamics.links[link]
        body = dynamics.model.inertias[dynamics.joint_of(link)]
        return NominalParameters(
            mass=float(body.mass),
            centre_of_mass=np.asarray(body.lever),
            inertia=np.asarray(body.inertia),
            volume=float(wet.volume),
            centre_of_buoyancy=wet.p_LB,
            added_mass=wet.added_mass,
            linear_drag=wet.linear_drag,
            quadratic_drag=wet.quadratic_drag,
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ActuatorModel:
    """Actuators of the vehicle: thrusters, or the wrench as commanded."""

    names: tuple[str, ...] = AXES
    """(n,) names of the actuators."""
    wrench: np.ndarray = field(default_factory=lambda: np.eye(6))
    """(6, n) [-, m] wrench per unit of each actuator, linear rows first."""
    allocation: np.ndarray = field(default_factory=lambda: np.eye(6))
    """(n, m) [-, 1/m] commands of the actuators per unit of the recorded commands."""
    lag: float = 0.1
    """[s] time constant of all actuators."""
    dead_zone: float = 1e-3
    """[N, N m] command below which nothing comes of it."""
    whole_beyond: bool = False
    """True where a command beyond the dead zone acts in full, as for thrusters of robot files; else
    it acts less the size of the dead zone.
    """
    delay: float = 0.1
    """[s] between a command and its effect, lag aside."""
    commands: str = ""
    """Channel of a recording with the commands; empty for the only one that a recording has."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class AxisCouplings:
    """Pairs of axes that may act on each other."""

    added_mass: Pairs = ()
    """Pairs of axes that are coupled in the added mass, in any order."""
    linear_drag: Pairs = ()
    """Pairs of axes that are coupled in the linear drag, in any order."""
    quadratic_drag: Pairs = ()
    """Rows and columns that are coupled in the quadratic drag: the force on the first axis from the
    motion of the second.
    """
