"""All checks of a mission before it begins."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.control.velocity.levels import LevelsProblem, build_levels
from uvms_ocp.control.velocity.parameters import parameters_of
from uvms_ocp.model.assembly.trim import without_trim
from uvms_ocp.model.files.unknowns import unknowns
from uvms_ocp.preflight.accuracy import check_accuracy
from uvms_ocp.preflight.altitude import check_altitude, check_echo, check_goals
from uvms_ocp.preflight.delays import check_delays
from uvms_ocp.preflight.findings import Finding, PreflightReport, Severity
from uvms_ocp.preflight.forces import check_forces, check_rest
from uvms_ocp.preflight.forecast import Visit, forecast
from uvms_ocp.preflight.load import check_load
from uvms_ocp.preflight.obstacles import check_obstacles
from uvms_ocp.preflight.setup import Setup
from uvms_ocp.preflight.structure import check_structure
from uvms_ocp.preflight.tool import check_tool
from uvms_ocp.tasks.task import Task, TaskClass

_RANK = 1e-6  # singular values below it count as zero
_TELLS = {
    "plant": "forces, floor and obstacles are judged by the robot's files, which it may not follow; no part of an export",
    "sensors": "accuracy is judged by their specs; no part of an export",
    "estimator": "accuracy is judged by the toolkit's filter; no part of an export, which begins at its measurements",
    "controller": "the mission is judged as the hierarchy would fly it; it has no form in C, so that it cannot be exported",
}
"""What pre-flight and export cannot say of a part that is not the toolkit's, by what it is."""


@checked
def check_mission(setup: Setup) -> PreflightReport:
    """Every check on a mission; see `PreflightReport`. Raises what `build_levels` raises for unknown names."""
    problem = build_levels(setup.robot, setup.mission.hierarchy, setup.dt)
    setup.mission.check_quantities(problem.quantity_names)
    if not setup.robot.n_vehicle:
        findings = [*check_structure(setup.mission), *check_echo(setup), *check_goals(setup), *check_accuracy(setup)]
        return PreflightReport(findings=(*findings, *check_delays(setup), *_check_wherever(setup)))
    visits = forecast(setup)
    findings = [
        *check_structure(setup.mission),
        *check_echo(setup),
        *check_altitude(setup, visits),
        *check_goals(setup),
        *check_obstacles(setup, visits),
        *check_freedom(setup, visits, problem),
        *check_forces(setup, visits),
        *check_rest(setup, visits),
        *check_accuracy(setup),
        *check_delays(setup, visits),
        *_check_wherever(setup),
    ]
    return PreflightReport(findings=(*findings, *check_tool(setup, visits)))


def _check_wherever(setup: Setup) -> Iterator[Finding]:
    """What is looked at wherever the mission leads."""
    yield from check_unknowns(setup)
    yield from check_own_parts(setup)
    yield from check_load(setup)


def check_unknowns(setup: Setup) -> Iterator[Finding]:
    """What the robot's files leave open and the plant takes for nothing."""
    if setup.with_forces:
        for subject, text in unknowns(without_trim(setup.robot).model, setup.robot.description):
            yield Finding(severity=Severity.WARNING, check=subject, text=text)


def check_own_parts(setup: Setup) -> Iterator[Finding]:
    """A note on each part that is not the toolkit's."""
    for what, name in setup.own_parts.items():
        yield Finding(severity=Severity.NOTE, check="parts", text=f"{what} {name} is your own: {_TELLS[what]}")


def check_freedom(setup: Setup, visits: Sequence[Visit], problem: LevelsProblem) -> Iterator[Finding]:
    """Equality tasks of one phase must leave each other room: one that has no freedom left acts in name only."""
    for visit in visits:
        q = visit.stances[0].configuration(setup)
        J = _jacobians(setup, problem, q)
        N = np.eye(setup.robot.n_v)
        for task in visit.tasks:
            if not task.equality:
                continue
            rows = J[task.name]
            if task.task_class < TaskClass.OPTIMIZATION and _rank(rows) and not _rank(rows @ N):
                yield _without_freedom(visit, task)
            N = N - np.linalg.pinv(rows @ N, rcond=_RANK) @ rows @ N


def _without_freedom(visit: Visit, task: Task) -> Finding:
    awaited = any(
        condition.quantity.startswith(f"{task.name}.")
        for transition in visit.phase.transitions
        for condition in transition.when
    )
    names = ", ".join(other.name for other in visit.tasks if other.equality and other is not task)
    return Finding(
        severity=Severity.ERROR if awaited else Severity.WARNING,
        check="contradiction",
        phase=visit.phase.name,
        text=f"{task.name} is on but has no freedom left below the other equality tasks ({names}); switch one off",
    )


def _rank(rows: np.ndarray) -> int:
    return int(np.linalg.matrix_rank(rows, tol=_RANK)) if rows.size else 0


def _jacobians(setup: Setup, problem: LevelsProblem, q: np.ndarray) -> dict[str, np.ndarray]:
    """Jacobian of each level at q."""
    n_v, n_tasks = setup.robot.n_v, len(setup.mission.hierarchy.tasks)
    parameters = np.concatenate([parameters_of(task, task.reference(0.0), q) for task in setup.mission.hierarchy.tasks])
    zeros = np.zeros(n_v)
    outputs = problem.function(q, zeros, zeros, zeros, 10.0, parameters, np.ones(n_tasks))
    J = np.array(outputs[problem.function.index_out("J")])
    return dict(zip(problem.names, np.split(J, np.cumsum(problem.sizes)[:-1]), strict=True))
