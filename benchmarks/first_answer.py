"""Time from an empty cache to the first answer: ``python benchmarks/first_answer.py``.

Writes first_answer.csv, one row per step, each in a process of its own, first_answer_planners.csv,
all in one, and first_answer.md.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from time import perf_counter, sleep

from recording.processes import as_installed, run_script
from recording.report import Report, Row, Table, begin, parser_of

from uvms_ocp.codegen.cache import HALF_MADE

GOAL = (12.2, 37.4, -39.5)  # [m] of the tool
START = (11.0, 37.0, -38.5)  # [m] of the vehicle
TURN = (0.0, 0.0, 0.5)  # [rad] of the tool, where its attitude is a goal, too
SPHERES = ("11.8,37.2,-38.9,0.1", "10.2,36.2,-38.0,0.2")
STEPS = 40
FEW = 10
QUIET = 3.0  # [s], longer than a process takes to start
PROSE = """
Each row is a command in a process of its own, with byte code as an installed package has it; the
rows of one `group` share a cache that is empty at first. *wall_s*: the whole command, from imports
to figures; *solve_s*: of that the search itself; *behind_s*: for how long after its end a process
behind all others compiles what the command did not wait for, which the next row finds; *libraries*:
how many were compiled, with *size_MB* of machine code. A reach of `girona_maris7_full` in water,
{steps} steps, around a sphere; then around two, then with an attitude at the goal, then the same
again. A robot and a mission of one's own: the first run, again, and after the hold at the goal was
made longer.

Below, the same reaches in one process, imports left out, from a cache that is empty at first:
*build_s* is `Planner(problem)`, of which *build_processor_s* in this process, *solve_s* is
`Planner.plan` from the start held still; then *behind_s* until all is compiled that nobody waited
for, after which the next is asked. A term of one's own is a constraint that no robot had before.
"""
PLANNERS = {
    "step": "",
    "status": "",
    "build_s": ".2f",
    "build_processor_s": ".2f",
    "solve_s": ".2f",
    "behind_s": ".1f",
    "libraries": "",
}
FORMATS = {
    "group": "",
    "step": "",
    "status": "",
    "wall_s": ".1f",
    "solve_s": ".2f",
    "behind_s": ".1f",
    "libraries": "",
    "size_MB": ".2f",
}


def timed_command(words: tuple[str, ...], folder: Path, cache: Path) -> dict[str, float]:
    """Measure what a command takes, and what it adds to the cache."""
    before = set(cache.glob("*.so"))
    environment = as_installed(cache)
    start = perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "uvms_ocp", *words],
        cwd=folder,
        env=environment,
        check=False,
        capture_output=True,
        text=True,
    )
    if done.returncode not in {0, 1}:  # 1: an answer, but not what was wanted
        raise RuntimeError(f"{' '.join(words)}: {done.stderr[-500:]}")
    wall = perf_counter() - start
    behind = seconds_until_quiet(cache)
    libraries = set(cache.glob("*.so")) - before
    return {
        "wall_s": wall,
        "behind_s": behind,
        "libraries": len(libraries),
        "size_MB": sum(path.stat().st_size for path in libraries) / 1e6,
    }


def seconds_until_quiet(cache: Path) -> float:
    """Wait until nothing has been compiled for some seconds, and return when that began."""
    start = last = perf_counter()
    while perf_counter() - last < QUIET:
        if any(cache.glob(f"{HALF_MADE}*")):
            last = perf_counter()
        sleep(0.05)
    return last - start


def plan_rows(plugin: str | None, steps: int) -> Iterator[Row]:
    """Reaches one after the other, from an empty cache, by the default solver or another."""
    solver = () if plugin is None else ("--nlp", plugin)
    one_sphere = ("--sphere", SPHERES[0])
    two_spheres = (*one_sphere, "--sphere", SPHERES[1])
    problems = {
        "first problem of the robot": one_sphere,
        "one more sphere": two_spheres,
        "another term": (*two_spheres, "--tool-rpy", *map(str, TURN)),
        "the same again": (*two_spheres, "--tool-rpy", *map(str, TURN)),
    }
    reach = ("--tool", *map(str, GOAL), "--position", *map(str, START))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cache = Path(name) / "cache"
        cache.mkdir(mode=0o700)
        for step, more in problems.items():
            words = ("plan", "ocp", *reach, *more, "--steps", str(steps), *solver, "--out", "plan")
            figures = timed_command(words, folder, cache)
            report = json.loads((folder / "plan" / "report.json").read_text(encoding="utf-8"))
            yield {
                "group": " ".join(("plan ocp", *solver)),
                "step": step,
                "status": report["status"],
                **figures,
                "solve_s": report["solve_time_s"],
            }


def planner_rows(steps: int) -> list[Row]:
    """All in one process."""
    with tempfile.TemporaryDirectory() as name:
        cache = Path(name) / "cache"
        result = Path(name) / "rows.json"
        cache.mkdir(mode=0o700)
        script = Path(__file__).parent / "horizon" / "first_planners.py"
        run_script(sys.executable, script, steps, result, cache=cache)
        return list(json.loads(result.read_text(encoding="utf-8")))


def run_rows() -> Iterator[Row]:
    """A robot and a mission of one's own."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cache = Path(name) / "cache"
        timed_command(("new-robot", "my_robot"), folder, cache)
        timed_command(("new-mission", "my_mission.py", "--robot", "my_robot"), folder, cache)
        mission = folder / "my_mission.py"
        for step in ("first run", "again", "mission changed"):
            if step == "mission changed":
                mission.write_text(changed(mission.read_text(encoding="utf-8")), encoding="utf-8")
            figures = timed_command(("run", "my_mission.py", "--out", "run"), folder, cache)
            yield {
                "group": "run my_mission.py",
                "step": step,
                "status": "",
                **figures,
                "solve_s": None,
            }


def changed(mission: str) -> str:
    """The mission with a longer hold at the goal."""
    short = "hold=1.0),),\n"
    long = "hold=1.5),),\n"
    if short not in mission:
        raise LookupError(f"{short!r} is not in the mission that new-mission writes")
    return mission.replace(short, long)


def main() -> None:
    """Measure, and write the files."""
    _, run = begin(parser_of(__doc__))
    steps = FEW if run.quick else STEPS
    if run.quick:
        rows = list(islice(plan_rows(None, steps), 1))
    else:
        rows = [*plan_rows(None, steps), *plan_rows("ipopt", steps), *run_rows()]
    planners = planner_rows(steps)
    run.write(
        Report(
            name="first_answer",
            title="From an empty cache to the first answer",
            prose=PROSE.format(steps=steps),
            tables=[Table(rows=rows, columns=FORMATS), Table(rows=planners, columns=PLANNERS)],
            data={"first_answer": rows, "first_answer_planners": planners},
        )
    )


if __name__ == "__main__":
    main()
