"""Check a recording against the settings of a calibration, with which a fit could mistake one
effect for another.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.calibration_robot import CalibratedRobot
from uvms_ocp.identification.data_quality import QualityIssue
from uvms_ocp.identification.mixed_thrusters import mixed_thrusters
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.segments import POSE_INTERVAL
from uvms_ocp.identification.settings import CalibrationSettings
from uvms_ocp.robot.thrusters import thrust_limits, thruster_matrix

_NOTABLE_CURRENT = 0.01  # [m/s] from which on a current is doubted
_STRONG_CURRENT = 0.05  # [m/s] from which on added mass and drag take its place in a fit without it
_NO_DELAY = 0.005  # [s] up to which a delay counts as none
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
    """Yield doubts about thrust beyond its limits, and thrusters that seem exchanged or reversed."""
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
    mixed = mixed_thrusters(
        recording, thrust, thruster_matrix(subject.robot), subject.robot.thruster_names
    )
    if mixed:
        yield QualityIssue(
            channel="thrust",
            problem=f"the vehicle accelerates as with {mixed}: their order, their signs?",
        )
