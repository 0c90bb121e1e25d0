"""Time and memory against size: ``python benchmarks/growth.py [--seconds S ...]``.

Runs a mission that does not end, with the robot of `new-robot`, noise and a current, by the command
line and in Python, checks the recording of each and identifies the robot from it; then the works of
`growing/works.py`: plans, hierarchies, campaigns, and ticks among obstacles and with arms. Writes
growth.csv, one row per work and size, and growth.md with the exponents, beside those of before any
of this was measured at length.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from os import environ, pathsep, wait4
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from growing import works
from growing.works import TICKS, WORKS
from recording.report import Report, Table, begin, parser_of
from recording.rows import column, rows_where

MISSION = """
from dataclasses import replace
from pathlib import Path

import uvms_ocp as uo
from uvms_ocp.scenario.own_code import own_code

def scenario(**options):
    load = own_code(str(Path(__file__).with_name("mission.py"))).load()
    finite = load(**{"noise": True, "current": (0.1, 0.05, 0.0), **options})
    approach, reach = finite.mission.phases
    never = replace(reach.transitions[0], when=(uo.Below(quantity="TP.position_error", limit=1e-9),))
    endless = replace(reach, transitions=(never,))
    mission = replace(finite.mission, phases=(approach, endless), abort=None)
    return replace(finite, mission=mission)
"""
IN_PYTHON = """
import sys
from uvms_ocp.scenario.own_code import own_code
scenario = own_code("endless.py").load()(duration=float(sys.argv[1]))
scenario.run(folder=sys.argv[2] if len(sys.argv) > 2 else None)
"""
LEARN = """
robot: robot
hull: [[-0.5, -0.3, -0.3], [0.5, 0.3, 0.3]]
learn:
  current: {prior: 0.2}
  added_mass: {prior: 0.5}
  linear_drag: {prior: 0.5}
  quadratic_drag: {prior: 0.5}
"""
_PATHS = (str(Path(__file__).parent), environ.get("PYTHONPATH"))
PLACES = {**environ, "PYTHONPATH": pathsep.join(path for path in _PATHS if path)}
COMMAND = (sys.executable, "-m", "uvms_ocp")
PROSE = """
Each in a process of its own, after one that compiled; *peak_mb*: the most memory that a process
held, what is mapped of files included, of copies that draw figures the largest. The size of the
first five is the length of the run [s]. *run*: `uvms-ocp run`, with record, report, figures and
scene; *loop, folder* and *loop, memory*: `Scenario.run` alone, with a folder for its rows and
without; *identify*: `uvms-ocp identify` of current, added mass and drag. *plan, an iteration*: the
tool reach over so many stages, solved, processor time of an iteration, each of a stage in
*us_each*. *hierarchy*: random ones of so many unknowns, the median, cold, from Python; *of a
humanoid*: most unknowns with simple bounds; *cascade*: `LexicographicQp` with qpOASES, of
*problems* so many *inexact*, on rows that depend on each other, and on model predictive control
with twice as many inequalities. *campaign*: so many noisy runs of Case 1 of {ticks} ticks, each
made anew in one process; *set-up*: of such runs, until the first tick. *tick*: the layer of
velocities, its median, past so many spheres, and with so many arms, a goal for each. The exponents
are those of power laws through all sizes: one where it is in proportion, nought where it is the
same at any; *then*: before any of this was measured at length, on another machine, where it was
measured at all.
"""
COLUMNS = {"work": "", "size": ".0f", "time_s": ".3g", "peak_mb": ".0f", "disk_mb": ".0f"}
COLUMNS |= {
    "us_each": ".1f",
    "problems": ".0f",
    "inexact": ".0f",
    "then_s": ".3g",
    "then_mb": ".0f",
}


def _times_then(times_us: dict[float, float]) -> dict[float, tuple[float, float]]:
    """Time [s] and memory, which was not measured, from times [us] by size."""
    return {size: (1e-6 * time_us, np.nan) for size, time_us in times_us.items()}


THEN: dict[str, dict[float, tuple[float, float]]] = {
    "run": {300: (np.nan, 600), 7200: (np.nan, 9000)},
    "check-recording": {300: (4, np.nan), 7200: (57, 6900)},
    "identify": {300: (163, 1200), 7200: (np.nan, np.nan)},
    "plan, an iteration": _times_then({20: 155.0 * 20, 40: 173.0 * 40, 80: 221.0 * 80}),
    "hierarchy": _times_then({20: 236.0, 40: 1416.0, 80: 25600.0, 160: 549115.0}),
    "hierarchy of a humanoid": {88: (9.8e-3, np.nan)},
    "cascade, control": {16: (14e-3, np.nan)},
    "campaign of short runs": _times_then({10: 0.35e7, 100: 0.35e8, 1000: 0.35e9}),
    "set-up of runs": _times_then({10: 0.30e7, 100: 0.30e8, 1000: 0.30e9}),
    "tick, obstacles": _times_then({3: 165.0, 30: 194.0, 300: 273.0, 3000: 1060.0}),
    "tick, arms of seven joints": _times_then({1: 159.0, 2: 239.0, 3: 390.0, 4: 572.0}),
}
"""Time [s] and memory [MB] by work and size of then; NaN: not measured, of *identify* no end but an
error.
"""


def measured(words: list[str], folder: Path) -> dict[str, Any]:
    """Time [s] and peak memory [MB] of a command and of what it starts. Raises `RuntimeError` for
    one that fails.

    The time is that of the whole process, or what it has written into `spent`.
    """
    begin = time.perf_counter()
    spent = folder / "spent"
    spent.unlink(missing_ok=True)
    process = subprocess.Popen(
        words, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=PLACES
    )
    _, status, usage = wait4(process.pid, 0)
    if status >> 8 not in (0, 3):  # 3: the mission is not completed, as it never is
        raise RuntimeError(f"{' '.join(words)} ended with {status >> 8}")
    figures = {"time_s": time.perf_counter() - begin}
    if spent.exists():
        figures = json.loads(spent.read_text(encoding="utf-8"))
    return {**figures, "peak_mb": usage.ru_maxrss / 1e3}


def lengths_of(folder: Path, seconds: float) -> Iterator[dict[str, Any]]:
    """A row for each work at a length."""
    length = f"{seconds:g}"
    out = f"run{length}"
    rows = f"rows{length}"
    record = folder / out / "record.npz"
    run = [*COMMAND, "run", "endless.py", "--force", "--duration", length, "--out", out]
    figures = measured(run, folder)
    yield row_of("run", seconds, figures | {"disk_mb": record.stat().st_size / 1e6})
    words_of_work = {
        "check-recording": [*COMMAND, "check-recording", str(record)],
        "loop, folder": [sys.executable, "-c", IN_PYTHON, length, rows],
        "loop, memory": [sys.executable, "-c", IN_PYTHON, length],
        "identify": [*COMMAND, "identify", "learn.yaml", rows, "--out", f"learnt{length}"],
    }
    for work, words in words_of_work.items():
        yield row_of(work, seconds, measured(words, folder))


def others(folder: Path, quick: bool) -> Iterator[dict[str, Any]]:
    """A row for each of the other works and sizes, after one that compiled; quick: for the smallest
    size.
    """
    for work, (_, sizes) in WORKS.items():
        for size in sizes[:1] if quick else sizes:
            words = [sys.executable, str(Path(works.__file__)), work, str(size)]
            if not quick:
                measured(words, folder)
            yield row_of(work, size, measured(words, folder))


def row_of(work: str, size: float, figures: dict[str, Any]) -> dict[str, Any]:
    """All columns, and what it was then."""
    row = {"work": work, "size": size, **figures}
    time_s, memory_mb = THEN.get(work, {}).get(size, (np.nan, np.nan))
    if np.isfinite(time_s):
        row["then_s"] = time_s
    if np.isfinite(memory_mb):
        row["then_mb"] = memory_mb
    return {name: row.get(name) for name in COLUMNS}


def exponents(rows: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Fit the exponents of time and peak memory, by work."""
    for work in dict.fromkeys(column(rows, "work")):
        rows_of_work = rows_where(rows, "work", work)
        if len(rows_of_work) < 2:
            continue
        sizes = column(rows_of_work, "size")
        then = THEN.get(work, {})
        yield {
            "work": work,
            "exponent of time": exponent(sizes, column(rows_of_work, "time_s")),
            "time, then": exponent(list(then), [time_s for time_s, _ in then.values()]),
            "exponent of memory": exponent(sizes, column(rows_of_work, "peak_mb")),
            "memory, then": exponent(list(then), [memory_mb for _, memory_mb in then.values()]),
        }


def exponent(sizes: Sequence[float], values: Sequence[float]) -> float | None:
    """Fit the exponent of the power law through values (n,) [any] that are known; `None` for fewer
    than two.
    """
    is_known = np.isfinite(values)
    if np.count_nonzero(is_known) < 2:
        return None
    x = np.array(sizes, dtype=float)[is_known]
    y = np.array(values, dtype=float)[is_known]
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def main() -> None:
    """Measure every work at every length."""
    parser = parser_of(__doc__)
    parser.add_argument(
        "--seconds",
        type=float,
        nargs="+",
        default=[60.0, 300.0, 1200.0, 3600.0],
        help="lengths of the runs",
    )
    arguments, run = begin(parser)
    lengths = [15.0, 30.0] if run.quick else arguments.seconds
    with TemporaryDirectory() as place:
        folder = Path(place)
        measured([*COMMAND, "new-robot", "robot"], folder)
        measured([*COMMAND, "new-mission", "mission.py", "--robot", "robot"], folder)
        (folder / "endless.py").write_text(MISSION, encoding="utf-8")
        (folder / "learn.yaml").write_text(LEARN, encoding="utf-8")
        first = [*COMMAND, "run", "endless.py", "--force", "--duration", "1", "--out", "first"]
        measured(first, folder)  # which compiles
        rows = list[dict[str, Any]]()
        for seconds in lengths:
            rows += lengths_of(folder, seconds)
        rows += others(folder, run.quick)
    tables = [Table(rows=rows, columns=COLUMNS), Table(rows=[*exponents(rows)])]
    run.write(
        Report(
            name="growth", title="What size costs", prose=PROSE.format(ticks=TICKS), tables=tables
        )
    )


if __name__ == "__main__":
    main()
