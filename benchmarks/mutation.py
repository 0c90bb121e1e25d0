"""Which small errors in the source the tests notice: ``python benchmarks/mutation.py --work FOLDER
--jobs 2``.

Writes mutation.csv and mutation.md, one row per mutant. Needs ``pip install -e ".[mutation]"``. The
folder keeps what is known, so that an interrupted run goes on where it was, and a run with better
tests tries the survivors only. `mutants/judged.csv` says of survivors which change nothing that can
be observed, and why the others are still there.
"""

from __future__ import annotations

import csv
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from mutants.sample import Mutant, draw
from mutants.suite import BUDGET, SLOW, Suite, recorded
from mutants.tree import ROOT
from mutants.trials import KILLED, Trial, Trials
from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import count_where, rows_where

ROOMS = ("tasks", "control", "sim", "solvers", "mission", "ocp")
JUDGED = Path(__file__).parent / "mutants" / "judged.csv"
EQUIVALENT = "equivalent"
SURVIVED = "survived"
NOT_RUN = "not run"
QUICK_FILES = ("uvms_ocp/codegen/elementwise.py",)
QUICK_TESTS = ("tests/solvers/test_intervals.py",)
QUICK_SAMPLE = 3
PROSE = """
{n} changes of one operator, number, condition, loop or exception each, by the operators of
cosmic-ray, in the Python source of {rooms}: places drawn with seed {seed}, then one change of each.
Of {judgeable} that change something, the tests notice **{killed} ({share:.1f} %)**; {equivalent}
are equivalent.

Annotations, decorators and ``zip(strict=...)`` are left as they are. A mutant meets the tests that
run its line, the quick ones first, then the others of their files, until one fails or {budget:.0f}
s of tests have passed; a crash, or three times the usual time, counts as noticed. Compiled code
comes from the cache; what a mutant changes is not compiled. {left_out} tests are left out: they
take more than {slow:.0f} s, or do not pass without a compiler. Tests that start other processes are
left out too. The C source is not mutated. Run were those of {tests}; mutants that others had
noticed before are kept as noticed.
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class Judgement:
    """What somebody found about a survivor."""

    verdict: str
    reason: str


def judgements(path: Path = JUDGED) -> dict[tuple[str, str, str], Judgement]:
    """Read the judgements, by file, line before and line after."""
    judged = {}
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            change = (row["file"], row["before"], row["after"])
            judged[change] = Judgement(verdict=row["verdict"], reason=row["reason"])
    return judged


def row_of(mutant: Mutant, trial: Trial | None, judged: Judgement | None) -> Row:
    """Make the row of a mutant."""
    row: dict[str, Any] = {
        "room": mutant.file.split("/")[1],
        "file": mutant.file,
        "line": mutant.line,
        "operator": mutant.operator.removeprefix("core/"),
        "before": mutant.before,
        "after": mutant.after,
        "verdict": NOT_RUN,
        "by": "",
        "reason": "",
        "tests": None,
        "seconds": None,
    }
    if trial is not None:
        row |= {"verdict": trial.verdict, "by": trial.by}
        row |= {"tests": trial.n_tests, "seconds": trial.seconds}
    if judged is not None and row["verdict"] != KILLED:
        row["reason"] = judged.reason
        if trial is not None:
            row["verdict"] = judged.verdict
    return row


def score(rows: Sequence[Row], room: str) -> Row:
    """How many of the mutants of a room ended in which way."""
    count = {}
    for verdict in (KILLED, SURVIVED, EQUIVALENT, NOT_RUN):
        count[verdict] = count_where(rows, "verdict", verdict)
    judgeable = count[KILLED] + count[SURVIVED]
    share = 100.0 * count[KILLED] / judgeable if judgeable else None
    return {"room": room, "mutants": len(rows), **count, "noticed [%]": share}


def report(rows: Sequence[Row], suite: Suite, seed: int, tests: Sequence[str]) -> Report:
    """Make the report of all mutants."""
    scores = [score(rows_where(rows, "room", room), room) for room in ROOMS]
    total = score(rows, "all")
    survivors = rows_where(rows, "verdict", SURVIVED)
    left_out = [{"left out": name, "why": why} for name, why in sorted(suite.left_out.items())]
    of_survivors = dict.fromkeys(("file", "line", "before", "after", "by", "reason"), "")
    of_rooms = dict.fromkeys(total, "") | {"noticed [%]": ".1f"}
    mutated = [row for row in scores if row["mutants"]]
    tables = [Table(rows=[*mutated, total], columns=of_rooms)]
    if survivors:
        tables.append(Table(rows=survivors, columns=of_survivors))
    if left_out:
        tables.append(Table(rows=left_out))
    return Report(
        name="mutation",
        title="Errors that the tests notice",
        prose=PROSE.format(
            n=len(rows),
            rooms=", ".join(f"`{room}`" for room in ROOMS),
            seed=seed,
            judgeable=total[KILLED] + total[SURVIVED],
            killed=total[KILLED],
            share=total["noticed [%]"] or 0.0,
            equivalent=total[EQUIVALENT],
            budget=BUDGET,
            left_out=len(suite.left_out),
            slow=SLOW,
            tests=", ".join(f"`{path}`" for path in tests),
        ),
        tables=tables,
        data={"mutation": rows},
        peers={"cosmic-ray": version("cosmic-ray")},
    )


def measured(
    work: Path, sample: Sequence[Mutant], suite: Suite, jobs: int, hours: float
) -> list[Row]:
    """One row per mutant."""
    trials: Mapping[str, Trial] = Trials(work, suite, jobs).run(sample, hours)
    judged = judgements()
    rows = []
    for mutant in sample:
        change = (mutant.file, mutant.before, mutant.after)
        rows.append(row_of(mutant, trials.get(mutant.key), judged.get(change)))
    return rows


def main() -> None:
    """Draw, run what is not known yet, and write."""
    parser = parser_of(__doc__)
    parser.add_argument("--sample", type=int, default=240, metavar="N", help="mutants")
    parser.add_argument("--seed", type=int, default=0, help="of the draw")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes")
    parser.add_argument(
        "--hours", type=float, default=4.0, metavar="H", help="after which no mutant is begun"
    )
    parser.add_argument(
        "--work", type=Path, metavar="FOLDER", help="where copies and what is known are kept"
    )
    parser.add_argument("--files", nargs="*", metavar="FILE", help="to mutate instead of all rooms")
    parser.add_argument(
        "--tests", nargs="*", default=["tests"], metavar="PATH", help="to run instead of all"
    )
    arguments, run = begin(parser)
    files = arguments.files or source_files()
    tests = arguments.tests
    n = arguments.sample
    if run.quick:
        files = list(QUICK_FILES)
        tests = list(QUICK_TESTS)
        n = QUICK_SAMPLE
    with tempfile.TemporaryDirectory() as temporary:
        work = (arguments.work or Path(temporary)).resolve()
        work.mkdir(parents=True, exist_ok=True)
        suite = recorded(work, tests, arguments.jobs)
        sys.stderr.write(f"{len(suite.seconds)} tests recorded, {len(suite.left_out)} left out\n")
        rows = measured(
            work, draw(ROOT, files, n, arguments.seed), suite, arguments.jobs, arguments.hours
        )
        run.write(report(rows, suite, arguments.seed, tests))


def source_files() -> list[str]:
    """List the source files of all rooms, below the repository."""
    files = []
    for room in ROOMS:
        paths = (ROOT / "uvms_ocp" / room).rglob("*.py")
        files += [path.relative_to(ROOT).as_posix() for path in paths]
    return sorted(files)


if __name__ == "__main__":
    main()
