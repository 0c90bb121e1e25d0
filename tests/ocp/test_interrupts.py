"""Laws of whoever looks on: every iteration is told, and a stop by hand returns the best point so
far.
"""

from __future__ import annotations

import os
import random
import signal
import sys
from dataclasses import replace
from threading import Thread
from time import perf_counter, sleep

import numpy as np
import pytest
from compiler import needs_compiler
from pressed import PYTHON_MAY_LOSE_IT, pressed_after
from reaches import patient, reach, tool_goal

from uvms_ocp.interrupts import Interrupted, Stopped
from uvms_ocp.ocp import diagnosis, planner as planning
from uvms_ocp.ocp.plan import OcpStatus, Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.stagewise import sqp
from uvms_ocp.ocp.terms import TaskTerm
from uvms_ocp.ocp.trajectory import hold_guess
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.robot.robot import Robot
from uvms_ocp.solvers.nlp.program import NlpStatus
from uvms_ocp.solvers.nlp.solve_monitor import IterationReport


@pytest.fixture(scope="module", params=["ipopt", "stagewise"])
def planner(robot: Robot, request: pytest.FixtureRequest) -> Planner:
    return patient(reach(robot), request.param)


@pytest.mark.sampled
def test_every_iteration_is_told_with_its_level(planner: Planner) -> None:
    told: list[IterationReport] = []
    plan = planner.plan(progress=told.append)
    assert [moment.iteration for moment in told] == list(range(plan.iterations + 1))
    assert {moment.level for moment in told} == {"effort"}, "the last one, all above in full"
    assert told[-1].violation < 1e-6 < told[0].violation
    assert plan.result is not None
    cost = planner.transcription.costs(plan.result.x, planner.transcription.parameters())[-1]
    assert told[-1].residual == pytest.approx(np.sqrt(2 * cost), rel=1e-6)


def far(planner: Planner, robot: Robot) -> Planner:
    """Whose levels are solved in order."""
    goal = TaskTerm(task=tool_goal(robot, planner.problem.start.q, (100.0, 0.0, 0.0)))
    levels = (replace(planner.problem.levels[0], terms=(goal,)), planner.problem.levels[1])
    return Planner(
        replace(planner.problem, levels=levels), replace(planner.options, anticipate=False)
    )


@pytest.mark.sampled
@pytest.mark.parametrize("at", [0, 1, 20])
def test_a_stop_by_hand_returns_the_best_point_so_far(
    planner: Planner, robot: Robot, at: int
) -> None:
    told: list[IterationReport] = []

    def stop(moment: IterationReport) -> None:
        told.append(moment)
        if moment.iteration == at:
            raise KeyboardInterrupt

    searching = far(planner, robot)
    plan = searching.plan(progress=stop)
    assert plan.status is OcpStatus.INTERRUPTED
    assert "stopped by hand" in plan.reason
    assert plan.result is not None
    kept = [moment.residual for moment in told if moment.violation <= searching.options.feasibility]
    if kept:
        assert plan.levels[0].residual == pytest.approx(min(kept), rel=1e-6)
    else:
        assert plan.result.violation == pytest.approx(
            min(moment.violation for moment in told), rel=1e-6
        )
    assert np.isfinite(plan.trajectory.q).all()


@pytest.mark.sampled
def test_a_search_goes_on_from_where_it_was_stopped(planner: Planner) -> None:
    def stop(moment: IterationReport) -> None:
        if moment.iteration == 2:
            raise KeyboardInterrupt

    plan = planner.plan(progress=stop)
    assert plan.status is OcpStatus.INTERRUPTED
    assert "guess=plan" in plan.advice
    assert planner.plan(guess=plan).status is OcpStatus.SOLVED


@pytest.mark.slow
def test_the_signal_of_ctrl_c_does_the_same_and_its_handler_is_put_back(planner: Planner) -> None:
    before = signal.getsignal(signal.SIGINT)

    def press(moment: IterationReport) -> None:
        if moment.iteration == 3:
            os.kill(os.getpid(), signal.SIGINT)

    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(Interrupted, match="stopped by hand") as stop:
            planner.plan(progress=press)
        assert stop.value.result.status is OcpStatus.INTERRUPTED
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert planner.plan().status is OcpStatus.SOLVED


@PYTHON_MAY_LOSE_IT
@pytest.mark.slow
@needs_compiler
@pytest.mark.skipif(sys.platform == "win32", reason="timers by signals")
def test_whenever_it_is_pressed_a_new_planner_and_its_plan_end_in_one_line(robot: Robot) -> None:
    """While it was built one press in four was lost within CasADi, and the plan went on to its
    end.
    """

    problem = reach(robot)

    def work() -> tuple[Planner, Plan]:
        planner = Planner(problem, wait_for_compiler=True)
        return planner, planner.plan()

    work()
    begin = perf_counter()
    _, plan = work()
    assert plan.status is OcpStatus.SOLVED
    lasts = perf_counter() - begin
    draw = random.Random(44)
    told: list[list[str]] = []
    for _ in range(50):
        with pressed_after(draw.uniform(0.001, 0.9 * lasts)) as pressed:
            try:
                # Kept until the timer is off: whoever drops a planner takes it down, which lasts
                # long enough to be pressed, and is no part of what is promised.
                kept = work()
                signal.setitimer(signal.ITIMER_REAL, 0.0)
                assert not pressed
                del kept
            except (Stopped, Interrupted) as stop:
                told.append(stop._render_traceback_())
    assert all(len(lines) == 1 for lines in told)
    assert len(told) > 5
    _, plan = work()
    assert plan.status is OcpStatus.SOLVED


@pytest.mark.sampled
def test_an_error_of_the_one_who_looks_on_is_his(planner: Planner) -> None:
    def fail(moment: IterationReport) -> None:
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        planner.plan(progress=fail)
    assert planner.plan().status is OcpStatus.SOLVED


@pytest.mark.slow
def test_a_watched_plan_is_the_same_plan(planner: Planner, robot: Robot) -> None:
    silent = planner.plan(reach(robot))
    watched = planner.plan(reach(robot), progress=lambda moment: None)
    np.testing.assert_allclose(silent.trajectory.q, watched.trajectory.q, atol=1e-9)


@pytest.fixture
def stalled(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> Planner:
    """Whose solver by stages stalls where hardly anything is broken any more, so that IPOPT is
    tried.
    """
    iterate = sqp.StageSqp._iterate

    def stalls(
        self: sqp.StageSqp, merit: sqp.FilterMerit
    ) -> tuple[NlpStatus | None, sqp.FilterMerit]:
        status, merit = iterate(self, merit)
        return (NlpStatus.STALLED if self._worst < 1e-3 else status), merit

    monkeypatch.setattr(sqp.StageSqp, "_iterate", stalls)
    return Planner(reach(robot))


@needs_compiler
def test_a_stop_of_the_second_solver_ends_the_search_and_nothing_else_is_begun(
    stalled: Planner, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[object] = []

    def stop(moment: IterationReport) -> None:
        if "_by_ipopt" in vars(stalled):
            monkeypatch.setattr(diagnosis, "phase_one", lambda *given, **named: begun.append(given))
            raise KeyboardInterrupt

    plan = stalled.plan(progress=stop)
    assert "_by_ipopt" in vars(stalled)
    assert plan.status is OcpStatus.INTERRUPTED
    assert not begun


@needs_compiler
def test_a_stop_in_the_last_iteration_of_the_first_solver_begins_no_second_one(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    goal = TaskTerm(task=tool_goal(robot, reach(robot).start.q, (100.0, 0.0, 0.0)))
    first, last = reach(robot).levels
    planner = Planner(replace(reach(robot), levels=(replace(first, terms=(goal,)), last)))
    planner._nlp.options = replace(planner._nlp.options, anticipate=False)

    def stop(moment: IterationReport) -> None:
        if moment.iteration == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(sqp.StageSqp, "_iterate", lambda self, merit: (NlpStatus.STALLED, merit))
    planner.plan(progress=stop, diagnose=False)
    assert "_by_ipopt" not in vars(planner)


@needs_compiler
def test_ctrl_c_between_two_solves_ends_the_next_one_at_once(
    stalled: Planner, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = planning.program_for

    def press(plugin: str, whole: Transcription) -> object:
        os.kill(os.getpid(), signal.SIGINT)
        return made(plugin, whole)

    monkeypatch.setattr(planning, "program_for", press)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(Interrupted) as stop:
            stalled.plan(guess=hold_guess(stalled.problem))
    finally:
        signal.signal(signal.SIGINT, before)
    assert stop.value.result.status is OcpStatus.INTERRUPTED


@pytest.mark.sampled
@pytest.mark.parametrize("place", ["__init__", "parameters"])
def test_ctrl_c_while_a_first_guess_is_looked_for_ends_the_search_with_a_plan(
    place: str, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While what finds it is built, and in the first of its solves, after which there is one more,
    of the search itself.
    """
    planner = patient(reach(robot), "stagewise")
    calls = list[str]()
    found = getattr(Transcription, place)
    solve = Planner.solve

    def press(*given: object, **named: object) -> object:
        if not calls:
            os.kill(os.getpid(), signal.SIGINT)
        calls.append(place)
        return found(*given, **named)

    def solved(self: Planner, *given: object, **named: object) -> object:
        solves.append(self.problem.n_steps)
        return solve(self, *given, **named)  # type: ignore[arg-type]

    solves: list[int] = []
    monkeypatch.setattr(Transcription, place, press)
    monkeypatch.setattr(Planner, "solve", solved)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(Interrupted) as stop:
            planner.plan()
    finally:
        signal.signal(signal.SIGINT, before)
    assert stop.value.result.status is OcpStatus.INTERRUPTED
    assert solves == ([20] if place == "__init__" else [8, 20])


def test_time_that_others_take_for_their_turn_is_not_taken_from_the_time_limit(
    robot: Robot,
) -> None:
    problem = reach(robot)
    slow = patient(problem, "ipopt")
    hasty = Planner(
        problem, replace(slow.options, time_limit=30.0), transcription=slow.transcription
    )
    ends: list[float] = []
    planned = hasty._planned
    hasty._planned = lambda *given: ends.append(given[3]) or planned(*given)  # type: ignore[method-assign, func-returns-value]
    with slow.transcription.turn:
        thread = Thread(target=hasty.plan)
        thread.start()
        sleep(0.5)
        begin = perf_counter()
    thread.join()
    assert ends[0] >= begin + 30.0
