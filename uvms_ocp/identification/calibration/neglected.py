"""What a recording says, and a fit with these settings takes for something else: doubts about both together."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.identification.calibration.mixed_thrusters import mixed_thrusters
from uvms_ocp.identification.calibration.settings import Settings
from uvms_ocp.identification.calibration.subject import Subject
from uvms_ocp.identification.parameters.declaration import Quantity
from uvms_ocp.identification.recordings.doubts.doubt import Doubt
from uvms_ocp.identification.recordings.recording import Channel, Recording
from uvms_ocp.model.thrusters import thrust_limits, thruster_matrix

_FLOWS = 0.01  # [m/s] of a current that is told
_STRONG = 0.05  # [m/s] of one that spoils a fit without it: added mass and drag take its place
_SOON = 0.005  # [s] of a delay that is not
_BEYOND = 1e-3  # [-] of a limit


def neglected(subject: Subject, settings: Settings, recording: Recording) -> Iterator[Doubt]:
    """One after the other."""
    known, channels = subject.vehicle.own.declaration.quantities, recording.channels
    if "current" in channels:
        yield from _of_current(channels["current"], learnt=bool(known["current"].free.all()))
    if recording.at_once:
        yield from _of_delay(settings, known["delay"])
        if settings.commands == "wrench" and "thrust" in channels:
            text = "thrusters were driven ahead of their lag to give it, and a lag by it is not theirs: give commands: thrust"
            yield Doubt(channel="wrench", problem=text)
    if "thrust" in channels and settings.commands == "thrust":
        yield from _of_thrust(recording, channels["thrust"].of(subject.robot.thruster_names, "thrust"), subject)


def require_current(subject: Subject, recording: Recording) -> None:
    """Raises InvalidInput for a recorded current that is strong, and that no unknown may take.

    Such a fit converges where its numbers are wrong by many of their standard errors.
    """
    current, free = recording.channels.get("current"), subject.vehicle.own.declaration.quantities["current"].free
    size = 0.0 if current is None else float(np.linalg.norm(current.values.mean(axis=0)))
    if size > _STRONG and not free.any():
        given = f"{recording.name}: a current of {size:.2g} m/s, which the fit would take for still water"
        raise InvalidInput(f"{given}; learn it too: `current: {{prior: 0.2}}`, or leave the recording out")


def _of_current(current: Channel, *, learnt: bool) -> Iterator[Doubt]:
    values = current.values - (current.values.mean(axis=0) if learnt else 0.0)
    size = float(np.linalg.norm(values, axis=1).max())
    if size > _FLOWS:
        taken = (
            "about its mean, and a fit takes it for steady" if learnt else "that a fit takes for still water: learn it"
        )
        yield Doubt(channel="current", problem=f"up to {size:.2g} m/s {taken}")


def _of_delay(settings: Settings, delay: Quantity) -> Iterator[Doubt]:
    if settings.delay > _SOON and not delay.free.any():
        held = f"and a fit holds their delay at {settings.delay:g} s: give less, or learn it"
        yield Doubt(channel=settings.commands, problem=f"commands of a run of this toolkit act at once, {held}")


def _of_thrust(recording: Recording, thrust: Channel, subject: Subject) -> Iterator[Doubt]:
    lower, upper = thrust_limits(subject.robot)
    beyond = ((thrust.values > upper * (1.0 + _BEYOND)) | (thrust.values < lower * (1.0 + _BEYOND))).any(axis=0)
    if beyond.any():
        names = ", ".join(np.array(subject.robot.thruster_names)[beyond])
        yield Doubt(channel="thrust", problem=f"more is asked of {names} than they can give: a fit takes it for given")
    mixed = mixed_thrusters(recording, thrust, thruster_matrix(subject.robot), subject.robot.thruster_names)
    if mixed:
        yield Doubt(channel="thrust", problem=f"the vehicle accelerates as with {mixed}: their order, their signs?")
