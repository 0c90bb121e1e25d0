"""Check: how far a vehicle will tilt where no thruster holds it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from uvms_ocp.mission.phase import Phase
from uvms_ocp.model.assembly.rest import up_at_rest
from uvms_ocp.preflight.findings import Finding, Severity
from uvms_ocp.preflight.forecast import Visit, limit_of
from uvms_ocp.preflight.setup import Setup
from uvms_ocp.tasks.attitude import HorizontalAttitude

_TILTED = 0.1  # [rad] that is worth a word where no task asks for a level vehicle


def check_rest(setup: Setup, visits: Sequence[Visit]) -> Iterator[Finding]:
    """The attitude in which weight and buoyancy leave the vehicle, with the arm as at the start.

    An error where a phase waits for less tilt than that.
    """
    if not (setup.with_forces and setup.robot.description.thrusters):
        return
    up = up_at_rest(setup.robot, setup.start)
    missed = [(visit.phase, task) for visit in visits if (task := _missed(visit, up)) is not None]
    waiting = [pair for pair in missed if _waits(*pair, up)]
    severity = Severity.ERROR if waiting else Severity.WARNING
    for phase, task in (waiting or missed)[:1]:
        yield _finding(up, severity, phase, task)
    if not missed and _tilt(up) > _TILTED:
        yield _finding(up, severity)


def _missed(visit: Visit, up: np.ndarray) -> HorizontalAttitude | None:
    """The task that is on and cannot bring the tilt into the range in which it lets the vehicle be."""
    task = visit.active(HorizontalAttitude)
    return task if task is not None and _tilt(up) > task.bell.end else None


def _waits(phase: Phase, task: HorizontalAttitude, up: np.ndarray) -> bool:
    limit = limit_of(phase, f"{task.name}.tilt")
    return limit is not None and limit < _tilt(up)


def _tilt(up: np.ndarray) -> float:
    return float(np.arccos(np.clip(up[2], -1.0, 1.0)))


def _finding(
    up: np.ndarray, severity: Severity, phase: Phase | None = None, task: HorizontalAttitude | None = None
) -> Finding:
    roll, pitch = float(np.arctan2(up[1], up[2])), float(-np.arcsin(up[0]))
    text = f"where no thruster drives it the vehicle will rest at roll {_degrees(roll)}, pitch {_degrees(pitch)}"
    if task is not None:
        text += f": {task.name} is on, and its goal, a tilt of {task.aim:.2g} rad, is missed"
    return Finding(
        severity=severity,
        check="attitude at rest",
        phase="" if phase is None else phase.name,
        text=f"{text}; trim the robot (`check-robot` tells by what)",
        figures={"roll_rad": roll, "pitch_rad": pitch, "tilt_rad": _tilt(up)},
    )


def _degrees(angle: float) -> str:
    return f"{np.rad2deg(angle):.0f} deg"
