"""The solver in C is one function of C99, which keeps what it promises for any numbers."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from compiler import COMPILER, needs_compiler

from uvms_ocp.errors import InvalidInput
from uvms_ocp.solvers.hierarchy.active_set import core_source, solver_source
from uvms_ocp.solvers.hierarchy.core import STATUSES
from uvms_ocp.solvers.hierarchy.icat import Icat
from uvms_ocp.solvers.hierarchy.solution import Status
from uvms_ocp.solvers.stage_qp.compiled import core_source as stagewise_source

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
SANITIZED = ("-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
STRUCTURES = [(1, (1,)), (3, (1, 0, 2)), (13, (13, 3, 6, 1, 1, 6, 4, 6, 3, 3, 13))]
RANDOM_ROWS = Path(__file__).with_name("random_rows.c")


def _symbols(built: Path) -> list[list[str]]:
    """Kind and name."""
    symbols = subprocess.run(["nm", str(built)], capture_output=True, text=True, check=True).stdout
    return [line.split()[-2:] for line in symbols.splitlines()]


def _compiled(source: str, folder: Path, *options: str) -> Path:
    code = folder / "source.c"
    built = folder / "built"
    code.write_text(source)
    subprocess.run([COMPILER, *STRICT, *options, str(code), "-o", str(built), "-lm"], check=True)
    return built


CHOICE = {"_GLOBAL_OFFSET_TABLE_", "__cpu_indicator_init", "__cpu_model"}
"""Of the registers to use, when it is loaded."""


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("level", ["-O0", "-O3"])
@pytest.mark.parametrize(("n", "sizes"), STRUCTURES)
def test_it_compiles_without_a_warning(
    n: int, sizes: tuple[int, ...], level: str, tmp_path: Path
) -> None:
    for source in (solver_source, core_source, Icat().core_source):
        _compiled(source(n, sizes), tmp_path, level, "-fPIC", "-c")


@pytest.mark.slow
@needs_compiler
@pytest.mark.skipif(shutil.which("nm") is None, reason="needs nm: install binutils")
def test_it_defines_one_function_and_takes_what_libm_and_memory_calls_give(tmp_path: Path) -> None:
    built = _compiled(solver_source(13, STRUCTURES[-1][1]), tmp_path, "-O2", "-c")
    symbols = _symbols(built)
    assert [name for kind, name in symbols if kind.isupper() and kind not in "UR"] == [
        "solve_levels"
    ]
    needed = {name for kind, name in symbols if kind == "U"}
    assert (
        needed
        <= {
            "sqrt",
            "frexp",
            "ldexp",
            "fmax",
            "fmin",
            "memset",
            "memcpy",
            "memmove",
            "__stack_chk_fail",
        }
        | CHOICE
    )
    assert not any(kind in "bdBD" for kind, _ in symbols)  # nothing is kept between calls


@pytest.mark.slow
@needs_compiler
@pytest.mark.skipif(shutil.which("nm") is None, reason="needs nm: install binutils")
def test_the_solver_of_stages_is_five_functions_that_allocate_nothing(tmp_path: Path) -> None:
    symbols = _symbols(_compiled(stagewise_source(), tmp_path, "-O2", "-c"))
    functions = ["products", "solve_qp", "solve_whole", "stationarity", "steepest"]
    assert [name for kind, name in symbols if kind.isupper() and kind not in "UR"] == functions
    needed = {name for kind, name in symbols if kind == "U"}
    assert needed <= {"sqrt", "memset", "memcpy", "__stack_chk_fail"} | CHOICE


@pytest.mark.slow
@needs_compiler
def test_it_keeps_its_promises_for_random_numbers_under_the_sanitizers(tmp_path: Path) -> None:
    source = solver_source(5, (5, 2, 3, 1, 5)) + RANDOM_ROWS.read_text()
    try:
        program = _compiled(source, tmp_path, *SANITIZED)
    except subprocess.CalledProcessError:
        pytest.skip("needs the compiler's sanitizers: install libasan and libubsan")
    done = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    *counts, largest, allowed = map(int, done.stdout.split())
    count = dict(zip(STATUSES, counts, strict=False))
    assert sum(counts) == 10_000
    assert largest <= allowed
    assert all(count[status] > 100 for status in Status if status is not Status.REGULARISED)


def test_levels_without_a_row_have_no_source() -> None:
    with pytest.raises(InvalidInput, match=r"sizes = \[0, 0\] of levels; give at least one row"):
        solver_source(3, (0, 0))
