"""Check a recording against the settings of a calibration, with which a fit could mistake one
effect for another.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.calibration_robot import CalibratedRobot
from uvms_ocp.identification.command_checks import early_motion
from uvms_ocp.identification.command_lags import measured_lag
from uvms_ocp.identification.data_quality import QualityIssue
from uvms_ocp.identification.explained_motion import motion_of
from uvms_ocp.identification.mixed_thrusters import mixed_thrusters
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.resampling import ZeroOrderHold
from uvms_ocp.identification.segments import POSE_INTERVAL
from uvms_ocp.identification.settings import CalibrationSettings
from uvms_ocp.identification.thruster_effects import weak_thrusters
from uvms_ocp.robot.thrusters import thrust_limits, thruster_matrix

_NOTABLE_CURRENT = 0.01  # [m/s] from which on a current is doubted
_STRONG_CURRENT = 0.05  # [m/s] from which on added mass and drag take its place in a fit without it
_NO_DELAY = 0.005  # [s] up to which a delay counts as none
_SURE = 3.0  # [standard errors] from which on a lag is certain
_LATE = 0.1  # [s] by which a lag may be longer than is expected
_LIMIT_ERROR = 1e-3  # share of a limit by which thrust may be beyond it


def check_settings(
    subject: CalibratedRobot, settings: CalibrationSettings, recording: Recording
) -> Iterator[QualityIssue]:
    """Yield doubts about a recording and settings together."""
    quantities = subject.vehicle.per_recording.declaration.quantities
    channels = recording.channels
    if "current" in channels:
        yield from _current_doubts(
            channels["current"], learnt=bool(quantities["current"].free.all())
        )
    if not channels.keys() & {"thrust", "wrench"}:
        yield QualityIssue(
            channel=settings.commands,
            problem="not recorded: a fit along some axes takes nothing to push it",
        )
    if "linear_velocity" not in channels and "position" in channels:
        text = (
            f"not recorded: means between poses {POSE_INTERVAL:g} s apart or more take its place,"
            " with large noise"
        )
        yield QualityIssue(channel="linear_velocity", problem=text)
    is_delay_held = not quantities["delay"].free.any()
    is_delayed = settings.delay is not None and settings.delay > _NO_DELAY
    if recording.at_once and is_delayed and is_delay_held:
        text = (
            "commands of a run of this toolkit act at once, and a fit holds their delay at"
            f" {settings.delay:g} s: leave it out"
        )
        yield QualityIssue(channel=settings.commands, problem=text)
    if recording.at_once and settings.commands == "wrench" and "thrust" in channels:
        text = (
            "thrusters were driven ahead of their lag to give it, and a lag by it is not theirs:"
            " give commands: thrust"
        )
        yield QualityIssue(channel="wrench", problem=text)
    if "thrust" in channels and settings.commands != "wrench":
        thrust = channels["thrust"].of(subject.robot.thruster_names, "thrust")
        yield from _thrust_doubts(recording, thrust, subject)
        wrench = replace(thrust, values=thrust.values @ thruster_matrix(subject.robot).T)
        for problem in _timing_doubts(recording, wrench, subject):
            yield QualityIssue(channel="thrust", problem=problem)


def require_current(subject: CalibratedRobot, recording: Recording) -> None:
    """Require that a strong current of a recording is learnt. Raises InvalidInput where it is not: a fit
    then converges to numbers that are wrong by many of their standard errors.
    """
    current = recording.channels.get("current")
    free = subject.vehicle.per_recording.declaration.quantities["current"].free
    if current is None or free.any():
        return
    size = float(np.linalg.norm(current.values.mean(axis=0)))  # [m/s]
    if size > _STRONG_CURRENT:
        problem = (
            f"{recording.name}: a current of {size:.2g} m/s, which the fit would take for still"
            " water"
        )
        raise InvalidInput(
            f"{problem}; learn it too: `current: {{prior: 0.2}}`, or leave the recording out"
        )


def _current_doubts(current: Channel, *, learnt: bool) -> Iterator[QualityIssue]:
    """Yield a doubt about a current that a fit takes for still or for steady water."""
    if learnt:
        deviations = current.values - current.values.mean(axis=0)
        assumption = "about its mean, and a fit takes it for steady"
    else:
        deviations = current.values
        assumption = "that a fit takes for still water: learn it"
    size = float(np.linalg.norm(deviations, axis=1).max())  # [m/s]
    if size > _NOTABLE_CURRENT:
        yield QualityIssue(channel="current", problem=f"up to {size:.2g} m/s {assumption}")


def _thrust_doubts(
    recording: Recording, thrust: Channel, subject: CalibratedRobot
) -> Iterator[QualityIssue]:
    """Yield doubts about thrust beyond its limits, and about thrusters."""
    lower, upper = thrust_limits(subject.robot)  # [N]
    is_above = thrust.values > upper * (1.0 + _LIMIT_ERROR)
    is_below = thrust.values < lower * (1.0 + _LIMIT_ERROR)
    is_beyond = (is_above | is_below).any(axis=0)
    if is_beyond.any():
        names = ", ".join(np.array(subject.robot.thruster_names)[is_beyond])
        yield QualityIssue(
            channel="thrust",
            problem=f"more is asked of {names} than they can give: a fit takes it for given",
        )
    for problem in _thruster_doubts(recording, thrust, subject):
        yield QualityIssue(channel="thrust", problem=problem)


def _timing_doubts(
    recording: Recording, wrench: Channel, subject: CalibratedRobot
) -> Iterator[str]:
    """Yield doubts about the times of the wrench (n, 6) that thrusters are commanded to give."""
    motion = motion_of(recording)
    if motion is None:
        return
    held = ZeroOrderHold(wrench)
    quantities = subject.vehicle.shared.declaration.quantities
    actuator_lag = quantities["lag"].value.item()  # [s]
    yield from early_motion(held, motion, actuator_lag)
    delay = quantities["delay"]
    if delay.free.any():
        return
    expected = actuator_lag + delay.value.item()  # [s]
    measured = measured_lag(held, motion, signed=True)
    if measured is not None and measured.lag - _SURE * measured.sigma > expected + _LATE:
        yield (
            f"the vehicle accelerates {measured.lag:.2f} +- {measured.sigma:.2f} s after what is"
            f" commanded, of which lag and delay explain {expected:.2f} s: have delay learnt"
        )


def _thruster_doubts(
    recording: Recording, thrust: Channel, subject: CalibratedRobot
) -> Iterator[str]:
    """Yield doubts about thrusters that seem dead, weak, exchanged or reversed."""
    B = thruster_matrix(subject.robot)
    names = subject.robot.thruster_names
    mixed = mixed_thrusters(recording, thrust, B, names)
    given, weak = weak_thrusters(recording, thrust, B, names)
    # Two that are exchanged seem dead both; a dead one explains more with its sign turned, too.
    if "exchanged" not in mixed:
        yield from weak
        if (given == 0.0).any():
            mixed = mixed_thrusters(
                recording, replace(thrust, values=thrust.values * given), B, names
            )
    if mixed:
        yield f"the vehicle accelerates as with {mixed}: their order, their signs?"
