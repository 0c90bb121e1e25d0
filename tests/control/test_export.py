"""The exported tick is complete C source that does what the tick in Python does."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from uvms_ocp.control.export import RecordedTick, RecordingSolver, write_tick
from uvms_ocp.control.velocity.levels import LevelsProblem
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.scenarios.case1 import case1
from uvms_ocp.solvers.hierarchy.active_set.solver import LexicographicActiveSet

FILES = {"CMakeLists.txt", "active_set.c", "example.c", "levels.c", "tick.c", "tick.h", "ticks.h"}


@pytest.fixture(scope="module")
def ticks() -> list[RecordedTick]:
    scenario = case1(plant="kinematic")
    recording = RecordingSolver(solver=scenario.solver)
    replace(scenario, solver=recording).run()
    return recording.ticks


@pytest.fixture(scope="module")
def problem() -> LevelsProblem:
    return case1(plant="kinematic").controller().problem


@pytest.fixture(scope="module")
def folder(problem: LevelsProblem, ticks: list[RecordedTick], tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("tick")
    write_tick(problem, ticks, target)
    return target


def test_the_sources_are_complete_and_need_libm_only(folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} == FILES
    sources = {path.name: path.read_text() for path in folder.iterdir()}
    included = set(re.findall(r"#include [<\"](.*)[>\"]", "\n".join(sources.values())))
    assert included <= {"math.h", "string.h", "stdio.h", "tick.h", "ticks.h"}
    assert "CASADI_SYMBOL_EXPORT int levels(" in sources["levels.c"]
    assert "int lexls(" in sources["active_set.c"]
    for source in re.findall(r"\w+\.c\b", sources["CMakeLists.txt"]):
        assert source in sources


def test_the_header_tells_sizes_and_order_of_the_inputs(folder: Path, problem: LevelsProblem) -> None:
    header = (folder / "tick.h").read_text()
    assert f"#define TICK_N_ROWS {sum(problem.sizes)}\n" in header
    assert "in: q (14), velocity (13), previous (13), change (13), altimeter_range (1)" in header


def test_ticks_of_every_phase_are_recorded(ticks: list[RecordedTick]) -> None:
    assert sum(tick.start for tick in ticks) >= 4
    assert len(ticks) >= 80


def test_the_recorded_ticks_are_reproduced(folder: Path, problem: LevelsProblem, ticks: list[RecordedTick]) -> None:
    replay = LexicographicActiveSet(compiled=False).bind(problem.function, problem.sizes)
    for tick in ticks:
        # At the start of the last phase rows are dependent up to 1e-6, which takes digits from both.
        np.testing.assert_allclose(replay(*tick.inputs).v, tick.v, atol=1e-6)
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None or sys.platform == "win32":
        return
    sources = [str(path) for path in sorted(folder.glob("*.c"))]
    warnings = ["-Wall", "-Wextra", "-Wno-unused", "-Werror"]
    program = str(folder / "example")
    subprocess.run(
        [compiler, "-std=c11", "-O2", "-ffp-contract=off", *warnings, *sources, "-lm", "-o", program], check=True
    )
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert done.stdout.startswith(f"{len(ticks)} ticks")


def test_an_export_without_ticks_is_refused(problem: LevelsProblem, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="no recorded tick"):
        write_tick(problem, [], tmp_path)
