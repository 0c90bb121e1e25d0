"""Time and memory against size: ``python benchmarks/growth.py [--seconds S ...]``.

Runs a mission that does not end, with the robot of `new-robot`, noise and a current, by the command line and in Python, checks
the recording of each and identifies the robot from it; plans a reach in more and more steps, and solves hierarchies of more and
more unknowns. Writes growth.csv, one row per work and size, and growth.md with the exponents.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from os import environ, pathsep, wait4
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
LEARN = """
robot: robot
hull: [[-0.5, -0.3, -0.3], [0.5, 0.3, 0.3]]
learn:
  current: {prior: 0.2}
  added_mass: {prior: 0.5}
  linear_drag: {prior: 0.5}
  quadratic_drag: {prior: 0.5}
"""
PLAN = """
import sys, time
from pathlib import Path
from horizon.problems import tool_reach
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.trajectory import hold_guess
from uvms_ocp.solvers.nlp.level_solver import NlpOptions
planner = Planner(tool_reach(int(sys.argv[1])), NlpOptions(plugin="stagewise"), wait_for_compiler=True)
plans = []
for k in range(2):
    begin = time.process_time()
    plans.append(planner.plan(guess=hold_guess(planner.problem), diagnose=False))
    spent = time.process_time() - begin
assert plans[-1].status is OcpStatus.SOLVED, plans[-1].status
Path("spent").write_text(str(spent / plans[-1].iterations))
"""
HIERARCHY = """
import sys
from pathlib import Path
import numpy as np
from hierarchy_solvers import ours, problems
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
n = int(sys.argv[1])
sizes = (n, n // 7, n // 3, n // 5, n // 2, n)
sets = [problems.random_hierarchy(np.random.default_rng(seed), n, sizes) for seed in range(20)]
found = ours.solved(LexicographicActiveSet(), problems.Problem(name="random", warm=False, sets=sets))
Path("spent").write_text(str(float(np.median(found.seconds))))
"""
"""Each in a process of its own, which leaves there how long the work itself took."""
STAGES, UNKNOWNS = (20, 80, 320, 1000, 2000), (20, 40, 80, 160)
PLACES = {**environ, "PYTHONPATH": pathsep.join([str(Path(__file__).parent), *filter(None, [environ.get("PYTHONPATH")])])}
COMMAND = (sys.executable, "-m", "uvms_ocp")
PROSE = """
Each in a process of its own, after one that compiled; *peak_mb*: the most memory that a process held, what is mapped of files
included, of copies that draw figures the largest. The size of the first five is the length of the run [s]. *run*: `uvms-ocp
run`, with record, report, figures and scene; *loop, folder* and *loop, memory*: `Scenario.run` alone, with a folder for its rows
and without; *identify*: `uvms-ocp identify` of current, added mass and drag. *plan, an iteration*: the tool reach over so many
stages, the time of an iteration; *hierarchy*: random ones of so many unknowns, cold, from Python. The exponents are those of
power laws through all sizes: one where it is in proportion, nought where it is the same at any.
"""
COLUMNS = {"work": "", "size": ".0f", "time_s": ".3g", "peak_mb": ".0f", "disk_mb": ".0f"}


def measured(words: list[str], folder: Path) -> tuple[float, float]:
    """Time [s] and peak memory [MB] of a command and of what it starts. Raises `RuntimeError` for one that fails.

    The time is that of the whole process, or what it has written into `spent`.
    """
    begin, spent = time.perf_counter(), folder / "spent"
    spent.unlink(missing_ok=True)
    process = subprocess.Popen(words, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=PLACES)
    _, status, usage = wait4(process.pid, 0)
    if status >> 8 not in (0, 3):  # 3: the mission is not completed, as it never is
        raise RuntimeError(f"{' '.join(words)} ended with {status >> 8}")
    took = float(spent.read_text()) if spent.exists() else time.perf_counter() - begin
    return took, usage.ru_maxrss / 1e3


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
        "identify": [*COMMAND, "identify", "learn.yaml", f"rows{seconds:g}", "--out", f"learnt{seconds:g}"],
    }
    for work, words in each.items():
        took, peak = measured(words, folder)
        disk = record.stat().st_size / 1e6 if work == "run" else None
        yield {"work": work, "size": seconds, "time_s": took, "peak_mb": peak, "disk_mb": disk}


def others(folder: Path, quick: bool) -> Iterator[dict[str, Any]]:
    """A row for each plan and hierarchy."""
    for work, script, sizes in (("plan, an iteration", PLAN, STAGES), ("hierarchy", HIERARCHY, UNKNOWNS)):
        for size in sizes[:2] if quick else sizes:
            took, peak = measured([sys.executable, "-c", script, str(size)], folder)
            yield {"work": work, "size": size, "time_s": took, "peak_mb": peak, "disk_mb": None}


def exponents(rows: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Of time and peak memory, by work."""
    for work in dict.fromkeys(row["work"] for row in rows):
        own = [row for row in rows if row["work"] == work]
        size = np.log([row["size"] for row in own])
        slopes = [float(np.polyfit(size, np.log([row[name] for row in own]), 1)[0]) for name in ("time_s", "peak_mb")]
        yield {"work": work, "exponent of time": slopes[0], "exponent of memory": slopes[1]}


def main() -> None:
    """Measure every work at every length."""
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=float, nargs="+", default=[60.0, 300.0, 1200.0, 3600.0], help="lengths of the runs")
    given, run = begin(parser)
    lengths = [15.0, 30.0] if given.quick else given.seconds
    with TemporaryDirectory() as place:
        folder = Path(place)
        for words in (["new-robot", "robot"], ["new-mission", "mission.py", "--robot", "robot"]):
            measured([*COMMAND, *words], folder)
        for name, text in (("endless.py", MISSION), ("learn.yaml", LEARN)):
            (folder / name).write_text(text, encoding="utf-8")
        measured([*COMMAND, "run", "endless.py", "--force", "--duration", "1", "--out", "first"], folder)  # which compiles
        rows = [row for seconds in lengths for row in works(folder, seconds)] + [*others(folder, run.quick)]
    tables = [Table(rows=rows, columns=COLUMNS), Table(rows=[*exponents(rows)])]
    run.write(Report(name="growth", title="What size costs", prose=PROSE, tables=tables))


if __name__ == "__main__":
    main()
