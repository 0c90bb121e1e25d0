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
PLACES = {
    **environ,
    "PYTHONPATH": pathsep.join(
        [str(Path(__file__).parent), *filter(None, [environ.get("PYTHONPATH")])]
    ),
}
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
THEN: dict[str, dict[float, tuple[float, float]]] = {
    "run": {300: (np.nan, 600), 7200: (np.nan, 9000)},
    "check-recording": {300: (4, np.nan), 7200: (57, 6900)},
    "identify": {300: (163, 1200), 7200: (np.nan, np.nan)},
    "plan, an iteration": {
        n: (1e-6 * each * n, np.nan) for n, each in ((20, 155), (40, 173), (80, 221))
    },
    "hierarchy": {
        n: (1e-6 * us, np.nan) for n, us in ((20, 236), (40, 1416), (80, 25600), (160, 549115))
    },
    "hierarchy of a humanoid": {88: (9.8e-3, np.nan)},
    "cascade, control": {16: (14e-3, np.nan)},
    "campaign of short runs": {n: (0.35 * n, np.nan) for n in (10, 100, 1000)},
    "set-up of runs": {n: (0.30 * n, np.nan) for n in (10, 100, 1000)},
    "tick, obstacles": {
        n: (1e-6 * us, np.nan) for n, us in ((3, 165), (30, 194), (300, 273), (3000, 1060))
    },
    "tick, arms of seven joints": {
        n: (1e-6 * us, np.nan) for n, us in ((1, 159), (2, 239), (3, 390), (4, 572))
    },
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
    took = time.perf_counter() - begin
    own = json.loads(spent.read_text(encoding="utf-8")) if spent.exists() else {"time_s": took}
    return {**own, "peak_mb": usage.ru_maxrss / 1e3}


def lengths_of(folder: Path, seconds: float) -> Iterator[dict[str, Any]]:
    """A row for each work at a length."""
    out = f"run{seconds:g}"
    length = f"{seconds:g}"
    run = [*COMMAND, "run", "endless.py", "--force", "--duration", length, "--out", out]
    record = folder / out / "record.npz"
    each = {
        "run": run,
        "check-recording": [*COMMAND, "check-recording", str(record)],
        "loop, folder": [sys.executable, "-c", IN_PYTHON, length, f"rows{seconds:g}"],
        "loop, memory": [sys.executable, "-c", IN_PYTHON, length],
        "identify": [
            *COMMAND,
            "identify",
            "learn.yaml",
            f"rows{seconds:g}",
            "--out",
            f"learnt{seconds:g}",
        ],
    }
    for work, words in each.items():
        found = measured(words, folder)
        yield row_of(
            work,
            seconds,
            found | ({"disk_mb": record.stat().st_size / 1e6} if work == "run" else {}),
        )


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


def row_of(work: str, size: float, found: dict[str, Any]) -> dict[str, Any]:
    """All columns, and what it was then."""
    time_s, memory = THEN.get(work, {}).get(size, (np.nan, np.nan))
    then = {"then_s": time_s, "then_mb": memory}
    known = {
        "work": work,
        "size": size,
        **found,
        **{name: value for name, value in then.items() if np.isfinite(value)},
    }
    return {name: known.get(name) for name in COLUMNS}


def exponents(rows: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Of time and peak memory, by work."""
    for work in dict.fromkeys(row["work"] for row in rows):
        own = [row for row in rows if row["work"] == work]
        then = THEN.get(work, {})
        if len(own) < 2:
            continue
        sizes = [row["size"] for row in own]
        times, memories = zip(*then.values(), strict=True) if then else ((), ())
        yield {
            "work": work,
            "exponent of time": exponent(sizes, [row["time_s"] for row in own]),
            "time, then": exponent(list(then), times),
            "exponent of memory": exponent(sizes, [row["peak_mb"] for row in own]),
            "memory, then": exponent(list(then), memories),
        }


def exponent(sizes: Sequence[float], values: Sequence[float]) -> float | None:
    """Of the power law through values (n,) [any] that are known; `None` for fewer than two."""
    x, y = (
        np.array(
            [(size, value) for size, value in zip(sizes, values, strict=True) if np.isfinite(value)]
        )
        .reshape(-1, 2)
        .T
    )
    return float(np.polyfit(np.log(x), np.log(y), 1)[0]) if len(x) > 1 else None


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
    given, run = begin(parser)
    lengths = [15.0, 30.0] if given.quick else given.seconds
    with TemporaryDirectory() as place:
        folder = Path(place)
        for words in (["new-robot", "robot"], ["new-mission", "mission.py", "--robot", "robot"]):
            measured([*COMMAND, *words], folder)
        for name, text in (("endless.py", MISSION), ("learn.yaml", LEARN)):
            (folder / name).write_text(text, encoding="utf-8")
        measured(
            [*COMMAND, "run", "endless.py", "--force", "--duration", "1", "--out", "first"], folder
        )  # which compiles
        rows = [row for seconds in lengths for row in lengths_of(folder, seconds)] + [
            *others(folder, run.quick)
        ]
    tables = [Table(rows=rows, columns=COLUMNS), Table(rows=[*exponents(rows)])]
    run.write(
        Report(
            name="growth", title="What size costs", prose=PROSE.format(ticks=TICKS), tables=tables
        )
    )


if __name__ == "__main__":
    main()
