"""Laws of the first plan of a robot: it waits for no compiler, and is the plan that machine code
gives.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pytest
from compiler import needs_compiler
from reaches import reach

from uvms_ocp.codegen import background, bound_calls
from uvms_ocp.ocp import planner as planning
from uvms_ocp.ocp.diagnosis import Diagnosis
from uvms_ocp.ocp.plan import OcpStatus, Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.stagewise import sqp
from uvms_ocp.ocp.transcription import term_rows
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics
from uvms_ocp.solvers.nlp.level_solver import LevelSolver, NlpOutcome, NlpPoint
from uvms_ocp.solvers.nlp.options import NlpOptions
from uvms_ocp.solvers.nlp.program import NlpStatus
from uvms_ocp.solvers.nlp.solve_monitor import IterationReport


class Later:
    """Workers that compile nothing before they are told to."""

    def __init__(self) -> None:
        self.works: list[LaterResult] = []

    def apply_async(self, work: Callable[[], Any]) -> LaterResult:
        self.works.append(LaterResult(work))
        return self.works[-1]

    def begin(self) -> None:
        for one in self.works:
            one.get()


class LaterResult:
    """Of one of them."""

    def __init__(self, work: Callable[[], Any]) -> None:
        self._work = work
        self._found = list[Any]()

    def ready(self) -> bool:
        return bool(self._found)

    def get(self) -> Any:
        if not self._found:
            self._found.append(self._work())
        return self._found[0]


@pytest.fixture
def later(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Later:
    monkeypatch.setenv("UVMS_OCP_CACHE", str(tmp_path))
    monkeypatch.delenv("UVMS_OCP_WAIT_FOR_COMPILER", raising=False)
    workers = Later()
    monkeypatch.setattr(background, "_workers", lambda process: workers)
    monkeypatch.setattr(background, "_BEGUN", [])
    return workers


def assert_same(one: Plan, other: Plan) -> None:
    """Down to the last bit."""
    assert (one.status, one.iterations) == (other.status, other.iterations)
    for name in ("q", "v", "a", "thrust", "torque"):
        np.testing.assert_array_equal(
            getattr(one.trajectory, name), getattr(other.trajectory, name)
        )


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("after", [None, 3])
def test_the_plan_does_not_depend_on_when_machine_code_is_there(
    robot: Robot, later: Later, after: int | None
) -> None:
    planner = Planner(reach(robot))
    assert planner.options.plugin == "stagewise"
    assert all(not one.ready() for one in later.works[1:]), (
        "nobody waits, but for what all programs share"
    )

    def compile_now(moment: IterationReport) -> None:
        if moment.iteration == after:
            later.begin()

    plan = planner.plan(progress=compile_now)
    evaluation = planner._nlp.program.levels.memory.evaluate  # type: ignore[union-attr]
    assert isinstance(evaluation._make, bound_calls._MachineCode) is (after is not None)
    later.begin()
    assert_same(planner.plan(), plan)
    assert isinstance(evaluation._make, bound_calls._MachineCode)


@pytest.mark.slow
@needs_compiler
def test_ipopt_begins_at_once_and_the_next_planner_has_machine_code(
    robot: Robot, later: Later
) -> None:
    options = NlpOptions(plugin="ipopt")
    first = Planner(reach(robot), options)
    assert not any(one.ready() for one in later.works)
    plan = first.plan()
    later.begin()
    n = len(later.works)
    second = Planner(reach(robot), options)
    assert len(later.works) == n, "all is known"
    assert_same(second.plan(), plan)


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("how", ["asked for", "time limit", "environment"])
def test_machine_code_is_waited_for_where_that_is_wanted(
    robot: Robot, later: Later, how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if how == "environment":
        monkeypatch.setenv("UVMS_OCP_WAIT_FOR_COMPILER", "1")
    options = NlpOptions(time_limit=600.0) if how == "time limit" else NlpOptions()
    Planner(reach(robot), options, wait_for_compiler=how == "asked for")
    assert all(one.ready() for one in later.works[1:])


@pytest.mark.slow
@needs_compiler
def test_problems_that_tie_steps_to_one_another_are_solved_by_ipopt(robot: Robot) -> None:
    assert Planner(reach(robot)).options.plugin == "stagewise"
    free = replace(reach(robot).phases[0], duration=(4.0, 9.0))
    assert Planner(replace(reach(robot), phases=(free,), longest=8.0)).options.plugin == "ipopt"


@pytest.mark.slow
@needs_compiler
def test_ipopt_is_tried_where_the_solver_by_stages_does_not_come_to_an_end(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    direct = Planner(reach(robot), NlpOptions(plugin="ipopt")).plan()
    assert direct.plugin == "ipopt"
    assert Planner(reach(robot)).plan().plugin == "stagewise"
    monkeypatch.setattr(sqp.StageSqp, "_iterate", lambda self, merit: (NlpStatus.STALLED, merit))
    planner = Planner(reach(robot))
    begin = perf_counter()
    plan = planner.plan()
    assert plan.solve_time == pytest.approx(perf_counter() - begin, rel=0.1), (
        "of both, and of what it takes to build the second"
    )
    assert plan.status is OcpStatus.SOLVED
    assert plan.plugin == "ipopt"
    assert plan.reason == "all goals are met; by ipopt: stagewise ended 'stalled'"
    assert_same(plan, direct)
    assert (
        Planner(reach(robot), NlpOptions(plugin="stagewise")).plan(diagnose=False).plugin
        == "stagewise"
    )


@pytest.mark.slow
@needs_compiler
def test_where_neither_solver_ends_the_better_plan_alone_is_diagnosed(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged: list[Diagnosis] = []

    def court(**given: Any) -> Diagnosis:
        judged.append(Diagnosis(**given))
        return judged[-1]

    def nowhere(self: LevelSolver, start: NlpPoint, p: object, bounds: object) -> NlpOutcome:
        return NlpOutcome(point=start, status=NlpStatus.STALLED, iterations=0, violation=np.inf)

    monkeypatch.setattr(planning, "Diagnosis", court)
    monkeypatch.setattr(sqp.StageSqp, "_iterate", lambda self, merit: (NlpStatus.STALLED, merit))
    monkeypatch.setattr(LevelSolver, "__call__", nowhere)
    plan = Planner(reach(robot)).plan()
    assert plan.plugin == "stagewise"
    assert len(judged) == 1


@needs_compiler
def test_a_second_planner_of_a_robot_writes_no_equations_of_motion_and_asks_terms_once(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = Counter[str]()

    def count(owner: Any, name: str) -> None:
        called = getattr(owner, name)

        def counted(*given: Any) -> Any:
            calls[name] += 1
            return called(*given)

        monkeypatch.setattr(owner, name, counted)

    Planner(reach(robot))
    count(SymbolicDynamics, "inverse_dynamics")
    count(term_rows, "residual_of")
    problem = reach(robot, shift=(0.9, -0.5, -0.6))
    Planner(problem)
    assert calls == {
        "residual_of": len(problem.terms)
    }  # of one phase, at whose end or along which each counts
