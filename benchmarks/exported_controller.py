"""The controller in C: ``python benchmarks/exported_controller.py [--scenarios NAME ...]``.

Exports the controller of each mission, builds it for this machine, with sanitizers and, where
Debian's cross compiler and qemu's user emulation are installed, for 64-bit ARM, and replays the
recorded run. Writes exported_controller.csv, one row per mission and build.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from typing import Any

from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import column, rows_where

from uvms_ocp.export import export_controller
from uvms_ocp.scenario.cases import SCENARIOS, case1
from uvms_ocp.scenario.scenario import Scenario

FAULTS = ("altimeter:frozen@8", "thruster3:dead@15", "joint2:jam@20")
MISSIONS: dict[str, Callable[..., Scenario]] = {
    "case1": SCENARIOS["case1"],
    "case2": SCENARIOS["case2"],
    "current_drift": SCENARIOS["current_drift"],
    "obstacle_field": SCENARIOS["obstacle_field"],
    "bluerov_inspection": SCENARIOS["bluerov_inspection"],
    "case1, faulty": lambda **options: case1(noise=True, faults=FAULTS, **options),
}
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off")
NAME = "controlled"
"""Name of every export."""
GENERATED = tuple(f"{NAME}_{part}.c" for part in ("controller", "initial", "functions", "solver"))
REPLAY = f"{NAME}_replay.c"
TARGETS = {
    "native": ("cc", ("-O2",), ()),
    "sanitized": ("cc", ("-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"), ()),
    "64-bit ARM, emulated": ("aarch64-linux-gnu-gcc", ("-O2", "-static"), ("qemu-aarch64",)),
}
PROSE = """
{missions} missions, {ticks} replayed ticks in all. *apart*: ticks on which a velocity, thrust,
torque, quantity or share has other bits than Python told, or a flag, phase or status is another.
Other robots and missions: `drawn_exports.md`. All files are compiled without a warning ({strict});
in hand-written ones unused parameters are refused too. *us_per_tick*: time of the processor,
reading of the record included; of emulated and sanitized programs it says little. {largest}
"""
COLUMNS = {
    "mission": "",
    "build": "",
    "build_s": ".1f",
    "code_kB": ".0f",
    "ticks": "",
    "apart": "",
    "largest_difference": ".2g",
    "us_per_tick": ".1f",
    "status": "",
}


def rows_of(name: str, scenario: Scenario, folder: Path, level: Sequence[str]) -> Iterator[Row]:
    """Yield a row for every build; level: options of optimisation in place of those of the build."""
    export_controller(scenario, folder, NAME)
    for target, (compiler, options, emulator) in TARGETS.items():
        row: Row = {"mission": name, "build": target}
        missing = [tool for tool in (compiler, *emulator) if shutil.which(tool) is None]
        if missing:
            yield {**row, "status": f"not installed: {', '.join(missing)}"}
            continue
        try:
            built_s = built(folder, compiler, (*options, *level))
            yield {**row, "build_s": built_s, **replayed(folder, emulator), "status": "ok"}
        except subprocess.CalledProcessError as error:
            program = Path(str(error.cmd[0])).name
            complaint = " ".join(str(error.stderr).split())[:200]
            yield {**row, "status": f"{program} failed: {complaint}"}


def built(folder: Path, compiler: str, options: Sequence[str]) -> float:
    """Build the program ``replay``; return the time of the processor [s]."""
    before = _children()
    for name in GENERATED:
        _call(folder, compiler, *STRICT, "-Wno-unused-parameter", *options, "-c", name)
    _call(folder, compiler, *STRICT, *options, "-c", REPLAY)
    objects = [Path(name).with_suffix(".o").name for name in (*GENERATED, REPLAY)]
    _call(folder, compiler, *options, *objects, "-lm", "-o", "replay")
    return _children() - before


def replayed(folder: Path, emulator: Sequence[str]) -> dict[str, Any]:
    """Replay the recorded run by the program, and read the figures that it prints."""
    before = _children()
    process = subprocess.run(
        [*emulator, "./replay", f"{NAME}_recorded.bin"], cwd=folder, capture_output=True, text=True
    )
    spent = _children() - before
    printed = process.stdout
    if process.returncode not in (0, 1):
        raise subprocess.CalledProcessError(process.returncode, ["replay"], stderr=process.stderr)
    ticks = int(printed.split()[0])
    apart = int(printed.split()[2])
    largest = float(printed.split("difference ")[1].split(",")[0])
    return {
        "code_kB": 1e-3 * os.path.getsize(folder / "replay"),
        "ticks": ticks,
        "apart": apart,
        "largest_difference": largest,
        "us_per_tick": 1e6 * spent / ticks,
    }


def _call(folder: Path, *words: str) -> None:
    """Call a program in a folder. Raises `CalledProcessError` where it fails."""
    subprocess.run(words, cwd=folder, check=True, capture_output=True, text=True)


def _children() -> float:
    """Return the time of the processor [s] of all programs that have ended."""
    used = getrusage(RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Export, build, replay and write."""
    parser = parser_of(__doc__)
    parser.add_argument(
        "--scenarios", nargs="*", default=list(MISSIONS), metavar="NAME", choices=list(MISSIONS)
    )
    arguments, run = begin(parser)
    names = arguments.scenarios
    short: dict[str, Any] = {}
    level = []
    if run.quick:
        names = ["case1"]
        short = {"duration": 1.0, "plant": "kinematic"}
        level = ["-O0"]
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as work:
        for k, name in enumerate(names):
            rows += rows_of(name, MISSIONS[name](**short), Path(work) / str(k), level)
    done = rows_where(rows, "status", "ok")
    largest = max(column(done, "largest_difference"), default=0.0)
    prose = PROSE.format(
        missions=len(names),
        ticks=sum(column(done, "ticks")),
        strict=" ".join(STRICT),
        largest=f"The largest difference of all is {largest:.2g}.",
    )
    run.write(
        Report(
            name="exported_controller",
            title="The controller in C",
            prose=prose,
            tables=[Table(rows=rows, columns=COLUMNS)],
            data={"exported_controller": rows},
        )
    )


if __name__ == "__main__":
    main()
