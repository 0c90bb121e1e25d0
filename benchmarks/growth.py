"""Time and memory against length: ``python benchmarks/growth.py [--seconds S ...]``.

Runs a mission that does not end, with the robot of `new-robot`, noise and a current, by the command line and in Python, and
checks the recording of each. Writes growth.csv, one row per work and length, and growth.md with the exponents.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from os import environ, wait4
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from recording.report import Report, Table, begin, parser_of

MISSION = """
from dataclasses import replace
from pathlib import Path

import uvms_ocp as uo
from uvms_ocp.scenario.own_code import own_code

def scenario(**options):
    made = own_code(str(Path(__file__).with_name("mission.py"))).load()(**{"noise": True, "current": (0.1, 0.05, 0.0), **options})
    approach, reach = made.mission.phases
    never = replace(reach.transitions[0], when=(uo.Below(quantity="TP.position_error", limit=1e-9),))
    return replace(made, mission=replace(made.mission, phases=(approach, replace(reach, transitions=(never,))), abort=None))
"""
IN_PYTHON = """
import sys
from uvms_ocp.scenario.own_code import own_code
scenario = own_code("endless.py").load()(duration=float(sys.argv[1]))
scenario.run(folder=sys.argv[2] if len(sys.argv) > 2 else None)
"""
COMMAND = (sys.executable, "-m", "uvms_ocp")
PROSE = """
Each in a process of its own, after one that compiled; *peak_mb*: the most memory that a process held, what is mapped of files
included, of copies that draw figures the largest. *run*: `uvms-ocp run`, with record, report, figures and scene; *loop, folder*
and *loop, memory*: `Scenario.run` alone, with a folder for its rows and without. The exponents are those of power laws through
all lengths: one where it is in proportion to the length, nought where it is the same at any.
"""
COLUMNS = {"work": "", "simulated_s": ".0f", "time_s": ".1f", "peak_mb": ".0f", "disk_mb": ".0f"}


def measured(words: list[str], folder: Path) -> tuple[float, float]:
    """Time [s] and peak memory [MB] of a command and of what it starts. Raises `RuntimeError` for one that fails."""
    begin = time.perf_counter()
    process = subprocess.Popen(words, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environ)
    _, status, usage = wait4(process.pid, 0)
    if status >> 8 not in (0, 3):  # 3: the mission is not completed, as it never is
        raise RuntimeError(f"{' '.join(words)} ended with {status >> 8}")
    return time.perf_counter() - begin, usage.ru_maxrss / 1e3


def works(folder: Path, seconds: float) -> Iterator[dict[str, Any]]:
    """A row for each work at a length."""
    out, length = f"run{seconds:g}", f"{seconds:g}"
    run = [*COMMAND, "run", "endless.py", "--force", "--duration", length, "--out", out]
    record = folder / out / "record.npz"
    each = {
        "run": run,
        "check-recording": [*COMMAND, "check-recording", str(record)],
        "loop, folder": [sys.executable, "-c", IN_PYTHON, length, f"rows{seconds:g}"],
        "loop, memory": [sys.executable, "-c", IN_PYTHON, length],
    }
    for work, words in each.items():
        took, peak = measured(words, folder)
        disk = record.stat().st_size / 1e6 if work == "run" else None
        yield {"work": work, "simulated_s": seconds, "time_s": took, "peak_mb": peak, "disk_mb": disk}


def exponents(rows: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Of time and peak memory, by work."""
    for work in dict.fromkeys(row["work"] for row in rows):
        own = [row for row in rows if row["work"] == work]
        size = np.log([row["simulated_s"] for row in own])
        slopes = [float(np.polyfit(size, np.log([row[name] for row in own]), 1)[0]) for name in ("time_s", "peak_mb")]
        yield {"work": work, "exponent of time": slopes[0], "exponent of memory": slopes[1]}


def main() -> None:
    """Measure every work at every length."""
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=float, nargs="+", default=[60.0, 300.0, 1200.0, 3600.0], help="lengths of the runs")
    given, run = begin(parser)
    lengths = [1.0, 2.0] if given.quick else given.seconds
    with TemporaryDirectory() as place:
        folder = Path(place)
        for words in (["new-robot", "robot"], ["new-mission", "mission.py", "--robot", "robot"]):
            measured([*COMMAND, *words], folder)
        (folder / "endless.py").write_text(MISSION, encoding="utf-8")
        measured([*COMMAND, "run", "endless.py", "--force", "--duration", "1", "--out", "first"], folder)  # which compiles
        rows = [row for seconds in lengths for row in works(folder, seconds)]
    tables = [Table(rows=rows, columns=COLUMNS), Table(rows=[*exponents(rows)])]
    run.write(Report(name="growth", title="What the length of a run costs", prose=PROSE, tables=tables))


if __name__ == "__main__":
    main()
