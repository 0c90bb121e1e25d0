"""Check what a mission asks of axes of the vehicle that no thruster drives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from uvms_ocp.mission import Phase
from uvms_ocp.robot.rest_along_free_motions import motion_to_rest, tilt_for_drag
from uvms_ocp.robot.robot import Robot
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
from uvms_ocp.scenario.preflight.robot_check import LARGEST_TILT
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
# [rad] of heading with 1 rad of tilt, above which a free turn is rather one of heading
_LARGEST_HEADING = 1.0
_TOGETHER = "they swing together until weight rights them"
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
            f" vehicle is then, and no thruster drives {AXES[way_axis]}"
        )
        figures = {"way_m": float(ways[way_axis])}
        lean = _lean_on_the_way(setup, R_WB.T @ (goal.translation - begin), task, limit)
        if lean <= LARGEST_TILT:
            text += (
                f": it leans by {lean:.2g} rad and more on the way, slowly; give it thrust there"
            )
            yield Severity.WARNING.finding(FORCES, text, visit.phase.name, **figures)
            return
        text += "; give it thrust there, or goals where the other axes lead"
        yield Severity.ERROR.finding(FORCES, text, visit.phase.name, **figures)


def _lean_on_the_way(setup: Setup, way: np.ndarray, task: VehiclePose, limit: float) -> float:
    """Return the tilt [rad] at which weight bears what thrusters cannot give on a way (3,) [m] in B, at the
    speed that the task asks for as it comes within its limit [m]; infinite where weight does not hold
    the vehicle within half of that limit.
    """
    robot = setup.robot
    at_rest = float(np.linalg.norm(motion_to_rest(robot, setup.start)[:_LINEAR]))
    if not at_rest <= _REST_SHARE * min(limit, size(robot.model)):
        return np.inf
    v = np.zeros(robot.n_v)
    v[:_LINEAR] = task.gain_linear * limit * way / np.linalg.norm(way)
    return float(np.linalg.norm(tilt_for_drag(robot, setup.start, v)))


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
    if setup.with_forces and reduced:
        yield from _check_free_turns(robot)


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


def _check_free_turns(robot: Robot) -> Iterator[Finding]:
    """Check that undriven turns are ones that weight and buoyancy right, and are rather tilts than turns
    of the heading.

    Roll and pitch that go together are both righted: nine of ten drawn vehicles of that kind arrived when
    they were flown. So did 18 of 21 with less heading than tilt, and 6 of 9 with more.
    """
    undriven = undriven_axes(robot)
    motions = free_motions(robot)[0]
    turns = [k for k, axis in enumerate(undriven) if axis in (_ROLL, _PITCH)]
    # of the tilt that takes the most heading along
    heading = float(np.linalg.norm(motions[_YAW, turns]))
    if _YAW in undriven:
        reason = "and nothing rights it: the vehicle turns as it likes"
        yield _free_turn_finding(Severity.ERROR, AXES[_YAW], reason)
    if heading > _LARGEST_COUPLING:
        tilts = " and ".join(AXES[undriven[k]] for k in turns)
        along = f"which takes {heading:.1f} rad of yaw along for each of its own"
        if heading > _LARGEST_HEADING:
            reason = f"{along}: they are no two axes"
            yield _free_turn_finding(Severity.ERROR, tilts, reason)
        else:
            yield _free_turn_finding(Severity.WARNING, tilts, f"{along}: {_TOGETHER}")
    for k in turns:
        axis = undriven[k]
        other = _PITCH if axis == _ROLL else _ROLL
        coupling = abs(motions[other, k])
        if coupling > _LARGEST_COUPLING:
            reason = f"which takes {coupling:.1f} rad of {AXES[other]} along for each of its own: {_TOGETHER}"
            yield _free_turn_finding(Severity.WARNING, AXES[axis], reason)


def _free_turn_finding(severity: Severity, turn: str, reason: str) -> Finding:
    cure = "place thrusters elsewhere, or give it more of them"
    return severity.finding(_UNDRIVEN, f"no thruster drives {turn}, {reason}; {cure}")
