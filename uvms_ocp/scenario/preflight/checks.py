"""Run every check of a mission before it begins: structure, freedom of tasks, accuracy of sensors,
and those beside this file.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.control.velocity import goals, levels, swing
from uvms_ocp.estimation.estimator import std_at_rest
from uvms_ocp.mission import Mission, Phase
from uvms_ocp.record.meta_values import DONE, ENERGIES
from uvms_ocp.robot import IDEAL_SENSORS, Kinematics, spatial, static_balance, unknowns
from uvms_ocp.scenario.preflight import forces, reachability, robot_check, undriven_axes
from uvms_ocp.scenario.preflight.altitude import check_altitude, check_echo, check_goals
from uvms_ocp.scenario.preflight.collisions import check_hull, check_obstacles
from uvms_ocp.scenario.preflight.delays import check_delays, check_period
from uvms_ocp.scenario.preflight.findings import Finding, PreflightReport, Severity
from uvms_ocp.scenario.preflight.phase_forecast import Visit, forecast, threshold_of
from uvms_ocp.scenario.preflight.setup import Setup
from uvms_ocp.tasks.goals import evaluate_pose
from uvms_ocp.tasks.pose import PoseTask, ToolPosition, VehiclePose
from uvms_ocp.tasks.task import TaskClass

# Checks on the mission alone: phases, transitions and activations.

CHECK = "activations"
_ACTING = (TaskClass.PREREQUISITE, TaskClass.ACTION)

_PARTS = {
    "position_error": np.s_[:3],
    "horizontal_error": np.s_[:2],
    "orientation_error": np.s_[3:],
}

_RANK = 1e-6  # singular values below it count as zero
_ASSUMPTIONS = {
    "plant": (
        "forces, floor and obstacles are judged by the robot's files, which it may not follow; no"
        " part of an export"
    ),
    "sensors": "accuracy is judged by their specs; no part of an export",
    "estimator": (
        "accuracy is judged by the toolkit's filter; no part of an export, which begins at its"
        " measurements"
    ),
    "controller": (
        "the mission is judged as the hierarchy would fly it; it has no form in C, so that it"
        " cannot be exported"
    ),
}
"""Assumptions about a user's own part in place of checks, by the kind of part."""


def check_structure(mission: Mission) -> Iterator[Finding]:
    """Find phases that nothing leads to, that nothing ends, or in which nothing acts."""
    for name in mission.unreachable_phases():
        yield Severity.WARNING.finding(
            "phases", f"no transition leads to phase {name!r}; add one or drop the phase", name
        )
    for name in mission.phases_without_exit():
        text = f"the mission cannot end from phase {name!r}; add a transition towards {DONE!r}"
        yield Severity.ERROR.finding("phases", text, name)
    for phase in mission.all_phases:
        active = [task for task in mission.hierarchy.tasks if task.name in phase.on]
        # Constraints, safety and preferences that it does not wait for move nothing on purpose.
        if not any(task.task_class in _ACTING or phase.waits_for(task.name) for task in active):
            text = (
                f"phase {phase.name!r} has no acting task switched on; nothing would happen in it"
            )
            yield Severity.ERROR.finding(CHECK, text, phase.name)
        for condition in phase.conditions:  # what is to fall needs the task that makes it fall
            task = condition.quantity.rpartition(".")[0]
            if (
                condition.is_below
                and len(phase.transitions) < 2
                and task in {*mission.hierarchy.names} - {*phase.on}
            ):
                text = (
                    f"phase {phase.name!r} waits for {condition.quantity}, but task {task} is off"
                    " in it"
                )
                yield Severity.WARNING.finding(CHECK, text, phase.name)
    names_on = set()
    for phase in mission.all_phases:
        names_on |= set(phase.on)
    for name in mission.hierarchy.names:
        if name not in names_on:
            yield Severity.WARNING.finding(
                CHECK, f"task {name} is never switched on; use it or drop it"
            )


# Check: the sensors can tell whether the thresholds of a mission are met.


def quantity_stds(setup: Setup, q: np.ndarray, std: np.ndarray | None = None) -> dict[str, float]:
    """Compute the achievable standard deviation [m] or [rad] of each ``task.quantity`` at q (n_q,)
    [m, rad].

    Of the distances and angles of frames from their goals, the root of the sum of the variances of
    their axes, from `std` (n_v,) [m, rad], the standard deviations of the configuration, or from
    `std_at_rest`. Empty with ideal sensors, which allow everything. Joints may be beyond their
    limits, where a fault has pushed them.
    """
    tasks = [
        task for task in setup.mission.hierarchy.tasks if isinstance(task, (PoseTask, ToolPosition))
    ]
    if setup.sensors == IDEAL_SENSORS or not tasks:
        return {}
    unlimited = np.full(setup.robot.n_joints, np.inf)
    limits = replace(setup.robot.limits, position_lower=-unlimited, position_upper=unlimited)
    kinematics = Kinematics(replace(setup.robot, limits=limits), q)
    variance = np.diag((std_at_rest(setup.robot, setup.sensors) if std is None else std) ** 2)
    if setup.robot.n_vehicle:  # Jacobians take the velocity of B in B
        R_WB = spatial.quaternion_to_matrix(q[3:7])
        variance[:3, :3] = R_WB.T @ variance[:3, :3] @ R_WB
    allowed = {}
    for task in tasks:
        J = kinematics.jacobian(task.frame)
        error_variance = J @ variance @ J.T
        for name, rows in _PARTS.items():
            if name == "position_error" or not isinstance(task, ToolPosition):
                part = error_variance[rows, rows]
                allowed[f"{task.name}.{name}"] = float(np.sqrt(np.trace(part)))
    return allowed


def check_accuracy(setup: Setup) -> Iterator[Finding]:
    """Find thresholds below what the sensors allow, in the posture of the start."""
    allowed = quantity_stds(setup, setup.start)
    for phase in setup.mission.phases:
        for condition in sorted(set(phase.conditions), key=lambda item: item.quantity):
            sigma = allowed.get(condition.quantity, 0.0)
            if condition.is_below and condition.limit < sigma:
                limitation = (
                    f"the sensors tell it to {sigma:.2g} only (one standard deviation): the phase"
                    " may end early, or never"
                )
                request = f"{condition.quantity} < {condition.limit:g} is asked for"
                text = f"{request}, but {limitation}; raise the limit or take better sensors"
                yield Severity.WARNING.finding(
                    "accuracy", text, phase.name, limit=condition.limit, sensors_allow=sigma
                )


# All checks of a mission before it begins.


@checked
def check_mission(setup: Setup) -> PreflightReport:
    """Run every check on a mission; see `PreflightReport`. Raises what `build_levels` raises for
    unknown names.
    """
    problem = levels.build_levels(
        setup.robot, setup.mission.hierarchy, setup.dt, setup.mission.beside_tasks
    )
    setup.mission.check_quantities(problem.quantity_names)
    if not setup.robot.n_vehicle:
        findings = [
            *check_structure(setup.mission),
            *check_echo(setup),
            *check_goals(setup),
            *check_accuracy(setup),
        ]
        return PreflightReport(findings=(*findings, *check_delays(setup), *_check_wherever(setup)))
    visits = forecast(setup)
    findings = [
        *check_structure(setup.mission),
        *check_echo(setup),
        *check_altitude(setup, visits),
        *check_goals(setup),
    ]
    findings += [
        *check_hull(setup),
        *check_obstacles(setup, visits),
        *check_freedom(setup, visits, problem),
        *check_time(setup, visits),
    ]
    for check in (
        forces.check_forces,
        undriven_axes.check_depth,
        undriven_axes.check_undriven,
        forces.check_rest,
    ):
        findings += check(setup, visits)
    findings += [
        *check_accuracy(setup),
        *check_delays(setup, visits),
        *_check_wherever(setup),
    ]
    return PreflightReport(findings=(*findings, *reachability.check_tool(setup, visits)))


def _check_wherever(setup: Setup) -> Iterator[Finding]:
    """Yield findings that hold wherever the mission leads."""
    for check in (
        check_period,
        check_unspecified,
        check_inertia,
        check_geometry,
        check_own_parts,
        check_energy,
        forces.check_load,
    ):
        yield from check(setup)


def check_unspecified(setup: Setup) -> Iterator[Finding]:
    """Find numbers that the robot's files leave open and the plant takes for 0."""
    if setup.with_forces:
        for subject, text in unknowns.unknowns(
            static_balance.without_trim(setup.robot).model, setup.robot.description
        ):
            yield Severity.WARNING.finding(subject, text)


def check_energy(setup: Setup) -> Iterator[Finding]:
    """Find phases that wait for an energy that nobody knows."""
    silent = [
        thruster.name for thruster in setup.robot.description.thrusters if thruster.power is None
    ]
    if not setup.with_forces:
        why = "the kinematic plant uses none; use the dynamic plant"
    elif silent:
        why = f"no power is given for thruster {', '.join(silent)}; give it in hydrodynamics.yaml"
    else:
        return
    for phase in setup.mission.all_phases:
        for condition in phase.conditions:
            if condition.quantity in ENERGIES:
                text = f"phase {phase.name!r} waits for {condition.quantity}, but {why}"
                yield Severity.ERROR.finding("energy", text, phase.name)


def check_time(setup: Setup, visits: Sequence[Visit]) -> Iterator[Finding]:
    """Find a time limit that is shorter than the mission takes at least: along straight ways from
    way point to way point at the fastest that the vehicle may move, with all that is to be held.
    """
    fastest = float(np.linalg.norm(setup.robot.limits.velocity[:3]))
    place = setup.start[:3]
    nearby = 0.0
    shortest = 0.0
    for visit in visits:
        shortest += _shortest_stay(visit.phase)
        pose = visit.active(VehiclePose)
        if pose is None or callable(pose.goal):
            continue
        threshold = threshold_of(visit.phase, f"{pose.name}.position_error")
        if threshold is None:
            continue
        goal, _ = evaluate_pose(pose.name, pose.goal, 0.0)
        way = float(np.linalg.norm(goal.translation - place))
        shortest += max(way - nearby - threshold, 0.0) / fastest
        place = goal.translation
        nearby = threshold
    if shortest > setup.duration:
        text = (
            f"the phases take {shortest:.3g} s at least, at {fastest:.3g} m/s along straight ways;"
            f" the time limit is {setup.duration:.3g} s: give a longer duration"
        )
        yield Severity.WARNING.finding("time", text, least_s=shortest, duration_s=setup.duration)


def _shortest_stay(phase: Phase) -> float:
    """Return the shortest time [s] that a phase lasts: what its transitions hold or wait for."""
    stays = []
    for transition in phase.transitions:
        waits = [
            condition.limit
            for condition in transition.when
            if not condition.is_below and condition.quantity == "phase.time"
        ]
        stays.append(max(waits, default=0.0) + transition.hold)
    return min(stays, default=0.0)


def check_inertia(setup: Setup) -> Iterator[Finding]:
    """Find inertias of no body, and joints that have nothing to move: their acceleration under a
    force is not defined.
    """
    if setup.with_forces and "plant" not in setup.own_parts:
        for finding in robot_check.body_errors(setup.robot):
            yield Severity.ERROR.finding("inertia", finding.text)


def check_geometry(setup: Setup) -> Iterator[Finding]:
    """Find meshes of another size or with other axes, and a z axis that seems to point down, as
    `check-robot` does.
    """
    for finding in robot_check.geometry_doubts(setup.robot):
        yield Severity.WARNING.finding(finding.subject, finding.text)


def check_own_parts(setup: Setup) -> Iterator[Finding]:
    """Note each part that is not the toolkit's, and what is assumed of it."""
    for part, name in setup.own_parts.items():
        yield Severity.NOTE.finding("parts", f"{part} {name} is your own: {_ASSUMPTIONS[part]}")


def check_freedom(
    setup: Setup, visits: Sequence[Visit], problem: levels.LevelsProblem
) -> Iterator[Finding]:
    """Find equality tasks to which those above leave no freedom in a phase, so that they act in
    name only.
    """
    for visit in visits:
        J = _jacobians(setup, problem, visit.stances[0].configuration(setup))
        N = np.eye(setup.robot.n_v)
        for task in visit.tasks:
            if not task.equality:
                continue
            rows = J[task.name]
            if task.task_class < TaskClass.OPTIMIZATION and _rank(rows) and not _rank(rows @ N):
                names = ", ".join(
                    competitor.name
                    for competitor in visit.tasks
                    if competitor.equality and competitor is not task
                )
                text = (
                    f"{task.name} is on but has no freedom left below the other equality tasks"
                    f" ({names}); switch one off"
                )
                awaited = visit.phase.waits_for(task.name)
                yield (Severity.ERROR if awaited else Severity.WARNING).finding(
                    "contradiction", text, visit.phase.name
                )
            N = N - np.linalg.pinv(rows @ N, rcond=_RANK) @ rows @ N


def _rank(rows: np.ndarray) -> int:
    if rows.size:
        return int(np.linalg.matrix_rank(rows, tol=_RANK))
    return 0


def _jacobians(setup: Setup, problem: levels.LevelsProblem, q: np.ndarray) -> dict[str, np.ndarray]:
    """Return the Jacobian of each level at q (n_q,) [m, rad]."""
    n_v = setup.robot.n_v
    n_tasks = len(setup.mission.hierarchy.tasks)
    parameters = np.concatenate(
        [
            goals.task_parameters(task, task.reference(0.0), q)
            for task in setup.mission.hierarchy.tasks
        ]
    )
    zeros = np.zeros(n_v)
    outputs = problem.function(
        q, zeros, np.zeros(swing.N_PASSIVE), zeros, zeros, 10.0, parameters, np.ones(n_tasks)
    )
    J = np.array(outputs[problem.function.index_out("J")])
    return dict(zip(problem.names, np.split(J, np.cumsum(problem.sizes)[:-1]), strict=True))
