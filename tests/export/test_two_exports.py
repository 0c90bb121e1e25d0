"""Controllers of two robots in one program, each under its own name: as objects, as archives, as
parts of a CMake project, stepped by two threads.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from compiler import COMPILER, needs_compiler
from two_flights import GENERATED, ROBOTS, run, scenario_of_flight, write_unit

from uvms_ocp.errors import InvalidInput
from uvms_ocp.export import export_controller, exported_controller
from uvms_ocp.scenario.scenario import Scenario

pytestmark = [needs_compiler, pytest.mark.slow]
MAIN = """#include <pthread.h>
#include "first_controller.h"
#include "second_controller.h"
int fly_first(const char *), fly_second(const char *);
typedef struct { int (*fly)(const char *); const char *recorded; int failed; } Flight;
static void *again(void *given) {
  Flight *flight = given;
  for (int k = 0; k < 20; k++) flight->failed |= flight->fly(flight->recorded);
  return 0;
}
int main(int argc, char **argv) {
  Flight flights[2] = {{fly_first, argv[1], 0}, {fly_second, argv[2], 0}};
  pthread_t threads[2];
  if (argc != 3 || first_CONTROLLER_SIZES[0] != sizeof(first_Controller)) return 9;
  if (second_CONTROLLER_SIZES[0] != sizeof(second_Controller)) return 9;
  for (int k = 0; k < 2; k++) pthread_create(&threads[k], 0, again, &flights[k]);
  for (int k = 0; k < 2; k++) pthread_join(threads[k], 0);
  return flights[0].failed + 2 * flights[1].failed;
}
"""
PROJECT = """cmake_minimum_required(VERSION 3.10)
project(both C)
enable_testing()
add_subdirectory(first)
add_subdirectory(second)
add_executable(both main.c first.c second.c)
target_link_libraries(both first_controller second_controller pthread)
"""


def flight_of(name: str) -> Scenario:
    return replace(scenario_of_flight(name), name=f"the {name}")


@pytest.fixture(scope="module")
def exports(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two exports, and the files of a program of both."""
    folder = tmp_path_factory.mktemp("two")
    for name in ROBOTS:
        export_controller(flight_of(name), folder / name, name)
        write_unit(folder, name, name)
    (folder / "main.c").write_text(MAIN)
    (folder / "CMakeLists.txt").write_text(PROJECT)
    return folder


def call(folder: Path, *words: object) -> str:
    process = run(folder, *words)
    assert process.returncode == 0, process.stdout + process.stderr
    return process.stdout


def objects_of(folder: Path, name: str) -> list[str]:
    """The objects of an export, compiled once."""
    objects = [f"{name}/{name}_{part}.o" for part in GENERATED]
    for file in objects:
        if not (folder / file).exists():
            call(folder, COMPILER, "-O1", "-c", file.replace(".o", ".c"), "-o", file)
    return objects


def fly_both(folder: Path, program: str) -> None:
    """Each thread repeats the recorded run of its robot."""
    output = call(folder, program, *(f"{name}/{name}_recorded.bin" for name in ROBOTS))
    assert output.count(", 0 apart, ") == 40


def link(folder: Path, program: str, libraries: Sequence[str]) -> None:
    includes = [f"-I{name}" for name in ROBOTS]
    sources = ["main.c", *(f"{name}.c" for name in ROBOTS)]
    call(
        folder, COMPILER, "-O1", *includes, *sources, *libraries, "-lm", "-lpthread", "-o", program
    )


def test_objects_of_two_exports_are_one_program(exports: Path) -> None:
    link(exports, "objects", [part for name in ROBOTS for part in objects_of(exports, name)])
    fly_both(exports, "./objects")


@pytest.mark.parametrize("order", [("first", "second"), ("second", "first")])
def test_archives_of_two_exports_are_one_program(exports: Path, order: tuple[str, str]) -> None:
    if shutil.which("ar") is None:
        pytest.skip("needs ar: install binutils")
    for name in order:
        call(exports, "ar", "rcs", f"lib{name}.a", *objects_of(exports, name))
    link(exports, "archives", [f"lib{name}.a" for name in order])
    fly_both(exports, "./archives")


def test_two_exports_are_parts_of_one_cmake_project(exports: Path) -> None:
    if shutil.which("cmake") is None:
        pytest.skip("needs cmake: pip install cmake")
    call(exports, "cmake", "-S", ".", "-B", "build")
    call(exports, "cmake", "--build", "build")
    fly_both(exports, "build/both")
    output = call(exports, "ctest", "--test-dir", "build")
    assert "100% tests passed, 0 tests failed out of 2" in output


@pytest.mark.parametrize("name", ROBOTS)
def test_all_that_other_files_can_see_begins_with_the_name(exports: Path, name: str) -> None:
    if shutil.which("nm") is None:
        pytest.skip("needs nm: install binutils")
    objects = objects_of(exports, name)
    symbols = call(exports, "nm", "-g", "--defined-only", "-P", *objects)
    lines = [line.split() for line in symbols.splitlines()]
    defined = {words[0].removeprefix("_") for words in lines if len(words) > 2}
    assert len(defined) > 100
    digest = re.compile(rf"{name}_[0-9a-f]{{12}}_")
    (twice,) = {symbol for symbol in defined if not digest.match(symbol)}
    assert twice == f"{name}_IS_TAKEN_TWICE_EXPORT_ONE_ANEW_WITH_ANOTHER_NAME"
    assert len({symbol[: len(name) + 13] for symbol in defined - {twice}}) == 1
    files = {path.name for path in (exports / name).iterdir() if path.is_file()}
    assert {file for file in files if not file.startswith(f"{name}_")} == {
        "CMakeLists.txt",
        "README.md",
    }


def test_two_exports_in_one_folder_are_told_apart_by_name(exports: Path, tmp_path: Path) -> None:
    for name in ROBOTS:
        for file in (exports / name).glob(f"{name}_*.[ch]"):
            shutil.copy(file, tmp_path)
    exported = replace(flight_of("first"), controller=exported_controller(tmp_path))
    with pytest.raises(
        InvalidInput, match="has 2 controllers; give the name of one: first, second"
    ):
        exported.run()
    with pytest.raises(InvalidInput, match="has no controller third: No such file"):
        replace(exported, controller=exported_controller(tmp_path, "third")).run()
    for name in ROBOTS:
        flight = flight_of(name)
        flown = replace(flight, controller=exported_controller(tmp_path, name)).run()
        np.testing.assert_array_equal(flown["q"], flight.run()["q"])
