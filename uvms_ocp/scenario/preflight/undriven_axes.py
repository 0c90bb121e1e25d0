"""Check what a mission asks of axes of the vehicle that no thruster drives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from uvms_ocp.mission import Phase
from uvms_ocp.robot.rest_along_free_motions import motion_to_rest
from uvms_ocp.robot.size import size, weight
from uvms_ocp.robot.static_balance import TRIM_TOLERANCE, static_residual
from uvms_ocp.robot.thrusters import (
    AXES,
    driven_turns,
    free_motions,
    unactuated_axes,
    undriven_axes,
)
from uvms_ocp.scenario.preflight.findings import Finding, Severity
from uvms_ocp.scenario.preflight.forces import CURRENT_TIMES, FORCES
from uvms_ocp.scenario.preflight.phase_forecast import Visit, threshold_of
from uvms_ocp.scenario.preflight.setup import Setup, goals_of
from uvms_ocp.tasks import attitude, goals
from uvms_ocp.tasks.pose import PoseTask, VehiclePose

_UNDRIVEN = "axes without thrust"

_SWAY = 1  # numbers of the vehicle's axes
_HEAVE = 2
_LINEAR = 3  # how many of them are lengths
_ROLL = 3
_PITCH = 4
_YAW = 5

_REST_SHARE = 0.5  # of what a phase allows, by which the vehicle is off its depth at rest at most
_LARGEST_COUPLING = 0.4  # [rad] rotation about another axis that comes with 1 rad about a free one
_WHERE = ("ahead of or behind", "beside", "above or below")


def check_depth(setup: Setup, visits: Sequence[Visit]) -> Iterator[Finding]:
    """Check that no phase needs the vehicle to move along an axis that nothing drives, and that it
    is in trim where no thruster holds its depth.
    """
    unmoved = [axis for axis in unactuated_axes(setup.robot) if axis < _LINEAR]
    if not (setup.with_forces and setup.robot.description.thrusters and unmoved):
        return
    lift, _ = static_residual(setup.robot, setup.start)
    if _HEAVE in unmoved and abs(lift) > TRIM_TOLERANCE * weight(setup.robot.model):
        yield _trim_finding(setup, visits, lift)
    begin = setup.start[:_LINEAR]
    for visit in visits:
        yield from _check_way(setup, visit, begin, unmoved)
        begin = visit.stances[0].position


def _trim_finding(setup: Setup, visits: Sequence[Visit], lift: float) -> Finding:
    """Return the finding of a vehicle out of trim by a lift [N] whose depth no thruster holds: an error
    where that changes its depth for ever, or by more than a phase allows.
    """
    trim = "light" if lift > 0 else "heavy"
    text = f"the vehicle is {abs(lift):.2g} N too {trim}, and no thruster holds its depth"
    way = float(np.abs(motion_to_rest(setup.robot, setup.start)[_HEAVE]))
    limits = [size(setup.robot.model)]
    for visit in visits:
        task = visit.active(VehiclePose)
        if task is not None:
            limits.append(threshold_of(visit.phase, f"{task.name}.position_error") or np.inf)
    if way > _REST_SHARE * min(limits):
        return Severity.ERROR.finding(FORCES, f"{text}: trim it", lift_N=lift)
    text += f": it tilts as it moves by {way:.2g} m, which holds it there; trim it to be level"
    return Severity.WARNING.finding(FORCES, text, lift_N=lift, way_m=way)


def _check_way(
    setup: Setup, visit: Visit, begin: np.ndarray, unmoved: Sequence[int]
) -> Iterator[Finding]:
    """Check that a phase waits for no way of the vehicle along an axis that nothing moves.

    begin: (3,) [m] position of the vehicle in W at the start of the phase. unmoved: those axes.
    """
    task = visit.active(VehiclePose)
    if task is None:
        return
    limit = threshold_of(visit.phase, f"{task.name}.position_error")
    if limit is None:
        return
    goal = goals_of(setup, task.name, task.goal)[-1]
    alignment = visit.active(attitude.Alignment)
    R_WB = goal.rotation
    if alignment is not None:  # it turns the bow to its own goal
        x, y, _ = goals.evaluate_vector(alignment.name, alignment.goal, 0.0)[0] - begin
        R_WB = pin.rpy.rpyToMatrix(0.0, 0.0, float(np.arctan2(y, x)))
    ways = np.abs(R_WB.T @ (goal.translation - begin))  # [m] in B
    speed = min(float(setup.robot.limits.velocity[:_LINEAR].max()), task.saturation_linear)
    current = setup.environment.current
    flow = np.array([current.velocity(goal.translation[None], t)[0] for t in CURRENT_TIMES])
    largest_flow = np.abs(flow @ R_WB).max(axis=0)  # [m/s] in B
    drift = largest_flow * float(np.linalg.norm(ways)) / speed
    if alignment is not None:
        drift[_SWAY] = 0.0  # the bow is kept on the goal meanwhile
    drift_axis = max(unmoved, key=lambda axis: drift[axis])
    if drift[drift_axis] > limit:
        if drift_axis == _SWAY:
            cure = "turn its bow there with an Alignment"
        else:
            cure = "wait for less of it"
        text = (
            f"the current carries the vehicle {drift[drift_axis]:.2f} m along {AXES[drift_axis]},"
            f" and no thruster drives that, until {task.name} is there; {cure}"
        )
        figures = {"adrift_m": float(drift[drift_axis])}
        yield Severity.ERROR.finding(FORCES, text, visit.phase.name, **figures)
    way_axis = max(unmoved, key=lambda axis: ways[axis])
    if ways[way_axis] > limit:
        text = (
            f"{task.name} waits for a goal {ways[way_axis]:.2f} m {_WHERE[way_axis]} where the"
            f" vehicle is then, and no thruster drives {AXES[way_axis]}; give it thrust there, or"
            " goals where the other axes lead"
        )
        figures = {"way_m": float(ways[way_axis])}
        yield Severity.ERROR.finding(FORCES, text, visit.phase.name, **figures)


def check_undriven(setup: Setup, visits: Sequence[Visit]) -> Iterator[Finding]:
    """Note once which axes no thruster drives, and which tasks ask for less for it; an error where
    a phase waits for a task that is left out.
    """
    robot = setup.robot
    undriven = undriven_axes(robot)
    turns = ", ".join(AXES[axis] for axis in undriven if axis >= _LINEAR)
    reduced = dict[str, None]()  # names of tasks that ask for the other axes alone
    for visit in visits:
        for task in visit.tasks:
            if not turns or not isinstance(task, attitude.AngleTask | PoseTask):
                continue
            if driven_turns(robot, task.frame) is None:
                continue
            if isinstance(task, PoseTask):
                reduced[task.name] = None
                continue
            directions = task.turning_directions(robot)
            if directions is None:
                continue
            if directions.shape[1]:
                reduced[task.name] = None
            else:
                yield _left_out_finding(visit.phase, task, turns)
    if reduced:
        axis_names = ", ".join(AXES[axis] for axis in undriven)
        text = f"no thruster drives {axis_names}: {', '.join(reduced)} ask for the other axes alone"
        yield Severity.NOTE.finding(_UNDRIVEN, text)
    for axis, motion in zip(undriven, free_motions(robot)[0].T, strict=True):
        if setup.with_forces and reduced and axis >= _LINEAR:
            yield from _check_free_turn(axis, motion)


def _left_out_finding(phase: Phase, task: attitude.AngleTask, turns: str) -> Finding:
    """Return the finding of a task that no turn of the vehicle serves; turns: undriven ones."""
    text = (
        f"{task.name} is on but left out: no thruster drives {turns}, and no other axis turns"
        f" {task.frame} to its goal; switch it off"
    )
    quantities = (f"{task.name}.misalignment", f"{task.name}.angle")
    is_awaited = any(threshold_of(phase, quantity) for quantity in quantities)
    severity = Severity.ERROR if is_awaited else Severity.WARNING
    return severity.finding(_UNDRIVEN, text, phase.name)


def _check_free_turn(axis: int, motion: np.ndarray) -> Iterator[Finding]:
    """Check that an undriven turn is one that weight and buoyancy right, and takes no heading along.

    Roll and pitch that go together are both righted: nine of ten drawn vehicles of that kind arrived when
    they were flown. Of nine whose heading goes with a tilt four did with thrust to spare.

    motion: (6,) free motion of the vehicle with a unit of that turn.
    """
    severity = Severity.ERROR
    other = _PITCH if axis == _ROLL else _ROLL
    if axis == _YAW:
        reason = "and nothing rights it: the vehicle turns as it likes"
    elif abs(motion[_YAW]) > _LARGEST_COUPLING:
        reason = (
            f"which takes {abs(motion[_YAW]):.1f} rad of {AXES[_YAW]} along for each of its own: they are"
            " no two axes"
        )
    elif abs(motion[other]) > _LARGEST_COUPLING:
        severity = Severity.WARNING
        reason = (
            f"which takes {abs(motion[other]):.1f} rad of {AXES[other]} along for each of its own: they"
            " swing together until weight rights them"
        )
    else:
        return
    text = (
        f"no thruster drives {AXES[axis]}, {reason}; place thrusters elsewhere, or give it more of"
        " them"
    )
    yield severity.finding(_UNDRIVEN, text)
