"""The exported tick is complete C source that does what the tick in Python does."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from uvms_ocp.control.export import RecordedTick, RecordingSolver, write_tick
from uvms_ocp.control.velocity.levels import LevelsProblem
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.scenarios import SCENARIOS
from uvms_ocp.scenarios.case1 import case1
from uvms_ocp.solvers.hierarchy.active_set.codes import STATUSES
from uvms_ocp.solvers.hierarchy.active_set.solver import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.solution import Status

COMPILER = shutil.which("gcc") or shutil.which("cc") or ""
needs_compiler = pytest.mark.skipif(not COMPILER or sys.platform == "win32", reason="needs a C compiler")
DOUBLES = ctypes.POINTER(ctypes.c_double)
INPUTS = ("q", "velocity", "previous", "change", "altimeter_range", "parameters", "gates")
FILES = {"CMakeLists.txt", "active_set.c", "example.c", "levels.c", "tick.c", "tick.h", "ticks.h"}


@pytest.fixture(scope="module")
def ticks() -> list[RecordedTick]:
    scenario = case1(plant="kinematic")
    recording = RecordingSolver(solver=scenario.solver)
    replace(scenario, solver=recording).run()
    return recording.ticks


@pytest.fixture(scope="module")
def problem() -> LevelsProblem:
    return case1(plant="kinematic").kinematic_controller().problem


@pytest.fixture(scope="module")
def folder(problem: LevelsProblem, ticks: list[RecordedTick], tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("tick")
    write_tick(problem, ticks, target)
    return target


def compiled(sources: Sequence[Path], program: Path, *options: str) -> str:
    warnings = ["-Wall", "-Wextra", "-Wno-unused", "-Werror", "-ffp-contract=off"]
    files = [str(path) for path in sources]
    subprocess.run([COMPILER, "-std=c11", "-O0", *warnings, *options, *files, "-lm", "-o", str(program)], check=True)
    return str(program)


class ExportedTick:
    """The exported sources as a function: inputs in, status and velocity out; the active set is carried on."""

    def __init__(self, problem: LevelsProblem, folder: Path) -> None:
        dummy = [np.zeros(problem.function.numel_in(i)) for i in range(problem.function.n_in())]
        write_tick(problem, [RecordedTick(inputs=tuple(dummy), v=np.zeros(1), exact=True, start=True)], folder)
        sources = [folder / name for name in ("levels.c", "active_set.c", "tick.c")]
        self._tick = ctypes.CDLL(compiled(sources, folder / "tick.so", "-fPIC", "-shared")).tick
        self._active_set, self._n_v = np.zeros(sum(problem.sizes)), len(problem.step)
        self._quantities = np.zeros(max(1, len(problem.quantity_names)))

    def __call__(self, inputs: Sequence[np.ndarray]) -> tuple[Status, np.ndarray]:
        v, kept = np.zeros(self._n_v), [np.ascontiguousarray(value.ravel(order="F")) for value in inputs]
        given = (DOUBLES * len(kept))(*(pointer(value) for value in kept))
        status = self._tick(given, pointer(self._active_set), pointer(v), pointer(self._quantities))
        return STATUSES[status], v


def pointer(array: np.ndarray) -> object:
    return array.ctypes.data_as(DOUBLES)


def with_input(tick: RecordedTick, index: int, value: float) -> RecordedTick:
    inputs = list(tick.inputs)
    inputs[index] = np.full_like(inputs[index], value)
    return replace(tick, inputs=tuple(inputs))


def test_the_sources_are_complete_and_need_libm_only(folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} >= FILES
    sources = {path.name: path.read_text() for path in folder.iterdir()}
    included = set(re.findall(r"#include [<\"](.*)[>\"]", "\n".join(sources.values())))
    assert included <= {"math.h", "string.h", "stdio.h", "tick.h", "ticks.h"}
    assert "CASADI_SYMBOL_EXPORT int levels(" in sources["levels.c"]
    assert "int solve_levels(" in sources["active_set.c"]
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


@needs_compiler
def test_the_example_counts_and_explains_what_its_ticks_come_to(folder: Path, ticks: list[RecordedTick]) -> None:
    program = compiled(sorted(folder.glob("*.c")), folder / "example")
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert f"of {len(ticks)} ticks solved: {Status.SOLVED.advice}\n" in done.stdout
    assert sum(int(count) for count in re.findall(rf"(\d+) of {len(ticks)} ticks", done.stdout)) == len(ticks)


@needs_compiler
def test_the_example_tells_a_tick_that_is_not_solved_and_a_solved_one_that_differs(
    problem: LevelsProblem, ticks: list[RecordedTick], tmp_path: Path
) -> None:
    lost, other = with_input(ticks[0], 0, np.nan), replace(ticks[1], v=ticks[1].v + 1e-6)
    for wrong, code in ((lost, 0), (other, 1)):
        target = tmp_path / str(code)
        target.mkdir()
        write_tick(problem, [ticks[0], wrong], target)
        program = compiled(sorted(target.glob("*.c")), target / "example")
        done = subprocess.run([program], capture_output=True, text=True, check=False)
        assert done.returncode == code, done.stdout
        assert ("1 of 2 ticks invalid input: the levels contain NaN" in done.stdout) == (code == 0)


@needs_compiler
@pytest.mark.parametrize("mission", ["two_targets", "bluerov_inspection", "case1_unreachable"])
def test_on_other_missions_what_the_status_calls_solved_is_what_python_finds(
    mission: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uvms_ocp.control.export._WINDOW", 10**9)
    scenario = SCENARIOS[mission](plant="kinematic", dt=1 / 25, duration=40.0)
    recording = RecordingSolver(solver=scenario.solver)
    replace(scenario, solver=recording).run()
    tick = ExportedTick(scenario.kinematic_controller().problem, tmp_path)
    statuses = []
    for recorded in recording.ticks:
        status, v = tick(recorded.inputs)
        statuses.append(status)
        if status is Status.SOLVED:
            assert recorded.exact
            np.testing.assert_allclose(v, recorded.v, rtol=0.0, atol=1e-9)
    assert statuses.count(Status.SOLVED) > 0.99 * len(statuses)


@needs_compiler
def test_without_a_sound_input_the_tick_brakes_as_the_controller_does(
    problem: LevelsProblem, ticks: list[RecordedTick], tmp_path: Path
) -> None:
    tick, previous = ExportedTick(problem, tmp_path), np.linspace(-0.3, 0.3, len(problem.step))
    inputs = list(ticks[0].inputs)
    inputs[INPUTS.index("previous")] = previous
    inputs[INPUTS.index("parameters")] = np.full_like(inputs[INPUTS.index("parameters")], np.nan)
    assert not LexicographicActiveSet().bind(problem.function, problem.sizes)(*inputs).status.usable
    for _ in range(200):
        status, v = tick(inputs)
        assert status is Status.INVALID_INPUT
        expected = previous - np.clip(previous, -problem.step, problem.step)
        np.testing.assert_allclose(v, expected, rtol=0.0, atol=1e-15)
        inputs[INPUTS.index("previous")] = previous = v
    assert not v.any()
    assert tick(ticks[0].inputs)[0] is Status.SOLVED
    inputs[INPUTS.index("previous")] = np.full(len(previous), np.nan)
    np.testing.assert_array_equal(tick(inputs)[1], 0.0)


def test_an_export_without_ticks_is_refused(problem: LevelsProblem, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="no recorded tick"):
        write_tick(problem, [], tmp_path)
