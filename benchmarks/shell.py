"""What commands take from the shell, start and files included: ``python benchmarks/shell.py [--runs
N]``.

Each begins with an empty cache of compiled code, once, and finds it filled afterwards. Writes
shell.csv, one row per command, and shell.md.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
import tempfile
from resource import RUSAGE_CHILDREN, getrusage
from statistics import median
from time import perf_counter
from typing import NamedTuple

from recording.processes import as_installed
from recording.report import Report, Row, Table, begin, parser_of

COMMANDS = (
    "--help",
    "list",
    "check",
    "run --plant kinematic",
    "run",
    "run obstacle_field",
    "run --noise",
)
QUICK = ("--help", "list")
PROSE = """
Every command in a process of its own and an empty folder, record, report, figures and scene
written, by the clock on the wall. *warm_s*: the median of {runs} runs that find what they need
compiled, and *warm_processor_s* what these take of all processors. *cold_s*: the first run, with an
empty cache of compiled code. *compiling_s*: how much longer that is.
"""
COLUMNS = {
    "command": "",
    "warm_s": ".2f",
    "warm_processor_s": ".2f",
    "cold_s": ".1f",
    "compiling_s": ".1f",
}


class Spent(NamedTuple):
    """Times of one command [s]."""

    wall: float
    processor: float


def main() -> None:
    """Measure all, and write."""
    parser = parser_of(__doc__)
    parser.add_argument(
        "--runs", type=int, default=5, metavar="N", help="warm ones of each command"
    )
    arguments, run = begin(parser)
    runs = 1 if run.quick else arguments.runs
    rows = [row_of(command, runs) for command in (QUICK if run.quick else COMMANDS)]
    table = Table(rows=rows, columns=COLUMNS)
    run.write(
        Report(
            name="shell",
            title="Commands from the shell",
            prose=PROSE.format(runs=runs),
            tables=[table],
        )
    )


def row_of(command: str, runs: int) -> Row:
    """Once from an empty cache, and so many times from the one that it leaves. Raises
    `CalledProcessError`.
    """
    with tempfile.TemporaryDirectory() as cache:
        cold = spent_by(command, cache)
        warm = [spent_by(command, cache) for _ in range(runs)]
    wall = median(spent.wall for spent in warm)
    return {
        "command": f"uvms-ocp {command}",
        "warm_s": wall,
        "warm_processor_s": median(spent.processor for spent in warm),
        "cold_s": cold.wall,
        "compiling_s": cold.wall - wall,
    }


def spent_by(command: str, cache: str) -> Spent:
    """Time the command with that cache. Raises `CalledProcessError`."""
    environment = as_installed(cache)
    words = [sys.executable, "-m", "uvms_ocp", *shlex.split(command)]
    with tempfile.TemporaryDirectory() as folder:
        began = perf_counter()
        processor = _of_children()
        subprocess.run(words, check=True, cwd=folder, env=environment, capture_output=True)
        return Spent(perf_counter() - began, _of_children() - processor)


def _of_children() -> float:
    """Time of the processors [s]."""
    usage = getrusage(RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


if __name__ == "__main__":
    main()
