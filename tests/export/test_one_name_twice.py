"""Two exports of one name in one program: refused in words that say what to do, or each robot is
driven by its own code; never by that of the other.
"""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from compiler import COMPILER, needs_compiler
from two_flights import GENERATED, ROBOTS, run, scenario_of_flight, write_unit

from uvms_ocp.export import export_controller

pytestmark = [needs_compiler, pytest.mark.slow]
MAIN = """int fly_first(const char *), fly_second(const char *);
int main(int argc, char **argv) { return argc != 3 || fly_first(argv[1]) || fly_second(argv[2]); }
"""
PROJECT = """cmake_minimum_required(VERSION 3.10)
project(both C)
add_subdirectory(first)
add_subdirectory(second)
"""
TWICE = "same_IS_TAKEN_TWICE_EXPORT_ONE_ANEW_WITH_ANOTHER_NAME"


@pytest.fixture(scope="module")
def exports(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two exports of one name, the objects of each, and those of a program that flies
    both: what knows one robot is compiled with the header of that robot.
    """
    folder = tmp_path_factory.mktemp("same")
    for flight in ROBOTS:
        export_controller(replace(scenario_of_flight(flight), name="same"), folder / flight)
        write_unit(folder, flight, "same")
        compile_object(folder, f"{flight}.c", f"-I{flight}")
        for part in GENERATED:
            compile_object(folder, f"{flight}/same_{part}.c")
    (folder / "main.c").write_text(MAIN)
    compile_object(folder, "main.c")
    (folder / "CMakeLists.txt").write_text(PROJECT)
    return folder


def compile_object(folder: Path, source: str, *options: str) -> None:
    target = source.removesuffix(".c") + ".o"
    process = run(folder, COMPILER, "-O0", "-fPIC", *options, "-c", source, "-o", target)
    assert process.returncode == 0, process.stderr


def objects_of(flight: str) -> list[str]:
    return [f"{flight}/same_{part}.o" for part in GENERATED]


def link(folder: Path, program: str, *libraries: str) -> subprocess.CompletedProcess[str]:
    objects = ("main.o", "first.o", "second.o")
    return run(folder, COMPILER, *objects, *libraries, "-lm", "-o", program)


def test_objects_are_refused(exports: Path) -> None:
    process = link(exports, "objects", *objects_of("first"), *objects_of("second"))
    assert process.returncode != 0
    assert TWICE in process.stderr


@pytest.mark.parametrize("order", [("first", "second"), ("second", "first")])
def test_archives_are_refused(exports: Path, order: tuple[str, str]) -> None:
    """Of archives that have one symbol linkers take the first, without a word."""
    if shutil.which("ar") is None:
        pytest.skip("needs ar: install binutils")
    for flight in order:
        run(exports, "ar", "rcs", f"lib{flight}.a", *objects_of(flight))
    process = link(exports, "archives", *(f"lib{flight}.a" for flight in order))
    assert process.returncode != 0
    assert TWICE in process.stderr


@pytest.mark.parametrize("flight", ROBOTS)
def test_what_is_compiled_with_one_header_is_not_linked_to_the_other_controller(
    exports: Path, flight: str
) -> None:
    (other,) = set(ROBOTS) - {flight}
    (exports / "alone.c").write_text(f"int fly_{other}(const char *x) {{ return !x; }}\n")
    compile_object(exports, "alone.c")
    objects = ("main.o", f"{flight}.o", "alone.o")
    process = run(exports, COMPILER, *objects, *objects_of(other), "-lm", "-o", "alone")
    assert process.returncode != 0
    assert "controller_step" in process.stderr
    process = run(exports, COMPILER, *objects, *objects_of(flight), "-lm", "-o", "alone")
    assert process.returncode == 0, process.stderr


@pytest.mark.parametrize("order", [("first", "second"), ("second", "first")])
def test_from_shared_libraries_each_robot_is_driven_by_its_own_code(
    exports: Path, order: tuple[str, str]
) -> None:
    libraries = []
    for flight in order:
        name = f"lib{flight}.so"
        process = run(exports, COMPILER, "-shared", *objects_of(flight), "-lm", "-o", name)
        assert process.returncode == 0, process.stderr
        libraries.append(str(exports / name))
    process = link(exports, "shared", *libraries)
    assert process.returncode == 0, process.stderr
    recorded = [f"{flight}/same_recorded.bin" for flight in ROBOTS]
    process = run(exports, "./shared", *recorded)
    assert process.returncode == 0, process.stdout
    assert process.stdout.count(", 0 apart, ") == 2


def test_two_headers_in_one_file_are_refused(exports: Path) -> None:
    lines = [f'#include "{flight}/same_controller.h"' for flight in ROBOTS]
    (exports / "headers.c").write_text("\n".join([*lines, ""]))
    process = run(exports, COMPILER, "-fsyntax-only", "headers.c")
    assert process.returncode != 0
    assert "export one of them anew with another --name" in process.stderr
    (exports / "headers.c").write_text(f"{lines[0]}\n{lines[0]}\n")
    assert run(exports, COMPILER, "-fsyntax-only", "headers.c").returncode == 0


def test_parts_of_one_cmake_project_are_refused(exports: Path) -> None:
    if shutil.which("cmake") is None:
        pytest.skip("needs cmake: pip install cmake")
    process = run(exports, "cmake", "-S", ".", "-B", "build")
    assert process.returncode != 0
    words = " ".join(process.stderr.split())  # CMake breaks its lines
    assert "export one of them anew with another --name" in words
