"""Bars tell how far long work is where somebody looks, and nowhere else."""

from __future__ import annotations

import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from compiler import needs_compiler
from tqdm.auto import tqdm

import uvms_ocp as uo
from uvms_ocp.cli.printing import busy, console_of
from uvms_ocp.codegen import compile as building
from uvms_ocp.ocp import OcpLevel, Planner, TaskTerm, single_phase
from uvms_ocp.progress import progress_bar
from uvms_ocp.robot import State
from uvms_ocp.scenario import case1
from uvms_ocp.tasks import ToolPosition

SHORT = replace(case1(), duration=1.0)


@pytest.fixture(autouse=True)
def _wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TQDM_DISABLE", raising=False)


class Terminal(StringIO):
    def isatty(self) -> bool:
        return True


def shown_by_a_run(monkeypatch: pytest.MonkeyPatch, silent: float) -> str:
    monkeypatch.setattr("uvms_ocp.scenario.scenario_run.SILENT", silent)
    monkeypatch.setattr("tqdm.auto.tqdm", partial(tqdm, mininterval=0.0))  # however fast the run is
    with redirect_stderr(Terminal()) as terminal:
        assert len(SHORT.run()["t"]) > 100
    return terminal.getvalue()


def test_a_run_shows_its_phase_and_what_that_waits_for_and_nothing_stays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shown = shown_by_a_run(monkeypatch, silent=0.0)
    assert SHORT.mission.phases[0].name in shown
    assert " not < " in shown
    assert shown.endswith("\r")
    assert shown.split("\r")[-2].strip() == ""


def test_a_run_that_is_over_soon_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    assert shown_by_a_run(monkeypatch, silent=60.0) == ""


def solve_plan(**options: Any) -> bool:
    robot = uo.load_robot("planar5")
    q = robot.configuration()
    goal = uo.Kinematics(robot, q).pose(robot.tools[0])
    goal.translation[0] += 0.1
    problem = single_phase(
        robot=robot,
        start=State(q=q, v=np.zeros(robot.n_v)),
        duration=2.0,
        n_steps=6,
        levels=(
            OcpLevel(
                name="tool", terms=(TaskTerm(task=ToolPosition(frame=robot.tools[0], goal=goal)),)
            ),
        ),
    )
    return Planner(problem).plan(**options).status.usable


def shown_by_a_plan(monkeypatch: pytest.MonkeyPatch, silent: float, **options: Any) -> str:
    monkeypatch.setattr("uvms_ocp.ocp.planner.SILENT", silent)
    monkeypatch.setattr("tqdm.auto.tqdm", partial(tqdm, mininterval=0.0))
    with redirect_stderr(Terminal()) as terminal:
        assert solve_plan(**options)
    return terminal.getvalue()


def test_a_plan_shows_level_and_iteration_and_nothing_stays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shown = shown_by_a_plan(monkeypatch, silent=0.0)
    assert "planning: level 'tool', iteration " in shown
    assert shown.split("\r")[-2].strip() == ""
    assert shown_by_a_plan(monkeypatch, silent=60.0) == ""
    assert shown_by_a_plan(monkeypatch, silent=0.0, progress=lambda moment: None) == ""


def test_who_is_given_every_tick_shows_it_alone() -> None:
    ticks = list[float]()
    with redirect_stderr(Terminal()) as terminal:
        SHORT.run(lambda t, _: ticks.append(t))
    assert len(ticks) > 100
    assert terminal.getvalue() == ""


@needs_compiler
def test_it_is_shown_how_many_functions_are_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UVMS_OCP_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(building, "LONG", 0.0)
    monkeypatch.setattr("tqdm.auto.tqdm", partial(tqdm, mininterval=0.0))
    x = ca.SX.sym("x")
    with redirect_stderr(Terminal()) as terminal:
        begun = [
            building.start_compiling(ca.Function(f"f{k}", [x], [x + k * ca.sin(x)]))
            for k in range(3)
        ]
        building.finish_compiling()
    assert len(begun) == 3
    assert "compiling" in terminal.getvalue()
    assert " 2/3 " in terminal.getvalue()
    assert terminal.getvalue().split("\r")[-2].strip() == ""


def test_one_call_turns_bars_off_and_on(monkeypatch: pytest.MonkeyPatch) -> None:
    try:
        uo.show_progress(False)
        assert shown_by_a_run(monkeypatch, silent=0.0) == ""
    finally:
        uo.show_progress()
    assert shown_by_a_run(monkeypatch, silent=0.0)


def test_so_does_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TQDM_DISABLE", "1")
    assert shown_by_a_run(monkeypatch, silent=0.0) == ""


def test_beside_a_line_of_a_command_there_is_none() -> None:
    with redirect_stdout(Terminal()), redirect_stderr(Terminal()):
        with busy(console_of(), "working"):
            assert progress_bar().disable
        assert not progress_bar().disable


@pytest.mark.parametrize("stream", [StringIO(), None], ids=["file", "none"])
def test_where_output_is_redirected_there_is_none(
    stream: StringIO | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", stream)
    assert progress_bar().disable
