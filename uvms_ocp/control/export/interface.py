"""What the controller in C is given at every tick, and what it tells: the same structures for C and Python."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from uvms_ocp.arguments import trusted
from uvms_ocp.control.navigation.degraded import CHANNELS
from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector, view
from uvms_ocp.model.health import Trust
from uvms_ocp.model.state import Command, Measurement

_command = trusted(Command)
_PLACE = {name: place for place, name in enumerate(CHANNELS)}


class ControllerInputs(Layout):
    """What was measured, as `Measurement` has it. Numbers that are none are a sensor that fails."""

    t: float
    """[s] time of the tick; they follow each other by the control period."""
    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] configuration: position of B in W, its quaternion xyzw, joints."""
    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity: linear and angular of B in B, joints."""
    altimeter_range: float
    """[m] along the beam; NAN without an echo."""
    age: float
    """[s] of the oldest reading that the measurement needs; INFINITY before the first."""
    joint_age: float
    """[s] of the joint positions alone."""
    trust: Annotated[list[int], Sized(len(CHANNELS))]
    """How far each channel can be trusted: 0 good, 1 suspect, 2 lost."""
    since: Annotated[Vector, Sized(len(CHANNELS))]
    """[s] since when."""


class ControllerOutputs(Layout):
    """What the robot is to do, and what the mission has come to."""

    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] reference velocity."""
    thrust: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [N] of each thruster."""
    torque: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [N m or N] of each joint."""
    hold: bool
    """The measured velocity of the vehicle is not to be trusted."""
    stop: bool
    """Cut the thrust."""
    brakes: bool
    """Lock the joints."""
    finished: bool
    """The mission is over."""
    phase: int
    """Where it is: a place in CONTROLLER_PHASES."""
    freshness: int
    """0 the measurement is fresh, 1 too old: the robot holds, 2 lost: it stops."""
    status: int
    """Of the hierarchy: a place in CONTROLLER_STATUSES."""
    viable_share: float
    """[-] of the hierarchy's velocity that a stop allows."""
    quantities: Annotated[Vector, Sized("n_quantities")]
    """[m, rad, ...] those of CONTROLLER_QUANTITIES; NAN where nothing tells."""


def write_measurement(inputs: Any, measurement: Measurement, t: float) -> None:
    """A measurement at time t [s] into `ControllerInputs`."""
    inputs.t, inputs.altimeter_range = t, measurement.altimeter_range
    inputs.age, inputs.joint_age = measurement.age, measurement.joint_age
    view(inputs.q)[:], view(inputs.v)[:] = measurement.q, measurement.v
    for place in range(len(CHANNELS)):
        inputs.trust[place], inputs.since[place] = Trust.GOOD, 0.0
    for item in measurement.health:
        place = _PLACE[item.channel]
        inputs.trust[place], inputs.since[place] = item.trust, item.since


def command_in(outputs: Any, *, forces: bool) -> Command:
    """The command in `ControllerOutputs`, without thrust and torque unless there are forces."""
    v, thrust, torque = (np.array(getattr(outputs, name)) for name in ("v", "thrust", "torque"))
    return _command(
        v=v,
        thrust=thrust if forces else None,
        torque=torque if forces else None,
        hold=bool(outputs.hold),
        stop=bool(outputs.stop),
        brakes=bool(outputs.brakes),
        finished=bool(outputs.finished),
    )
