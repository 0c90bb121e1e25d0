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

from mutants.sample import Mutant, draw
from mutants.suite import BUDGET, SLOW, Suite, recorded
from mutants.tree import ROOT
from mutants.trials import KILLED, Trial, Trials
from recording.report import Report, Row, Table, begin, parser_of

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
    """Of a survivor."""

    verdict: str
    reason: str


def judgements(path: Path = JUDGED) -> dict[tuple[str, str, str], Judgement]:
    """By file, line before and line after."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {
        (row["file"], row["before"], row["after"]): Judgement(
            verdict=row["verdict"], reason=row["reason"]
        )
        for row in rows
    }


def row_of(mutant: Mutant, trial: Trial | None, judged: Judgement | None) -> Row:
    """Of the table of all mutants."""
    verdict = NOT_RUN if trial is None else trial.verdict
    if trial is not None and trial.verdict != KILLED and judged is not None:
        verdict = judged.verdict
    return {
        "room": mutant.file.split("/")[1],
        "file": mutant.file,
        "line": mutant.line,
        "operator": mutant.operator.removeprefix("core/"),
        "before": mutant.before,
        "after": mutant.after,
        "verdict": verdict,
        "by": "" if trial is None else trial.by,
        "reason": judged.reason if judged is not None and verdict != KILLED else "",
        "tests": None if trial is None else trial.n_tests,
        "seconds": None if trial is None else trial.seconds,
    }


def score(rows: Sequence[Row], room: str) -> Row:
    """How many of the mutants of a room ended in which way."""
    count = {
        verdict: sum(row["verdict"] == verdict for row in rows)
        for verdict in (KILLED, SURVIVED, EQUIVALENT, NOT_RUN)
    }
    judgeable = count[KILLED] + count[SURVIVED]
    share = 100.0 * count[KILLED] / judgeable if judgeable else None
    return {"room": room, "mutants": len(rows), **count, "noticed [%]": share}


def report(rows: Sequence[Row], suite: Suite, seed: int, tests: Sequence[str]) -> Report:
    """What is written."""
    rooms = [score([row for row in rows if row["room"] == room], room) for room in ROOMS]
    total = score(rows, "all")
    left = [row for row in rows if row["verdict"] == SURVIVED]
    left_out = [{"left out": name, "why": why} for name, why in sorted(suite.left_out.items())]
    of_survivors = dict.fromkeys(("file", "line", "before", "after", "by", "reason"), "")
    of_rooms = dict.fromkeys(total, "") | {"noticed [%]": ".1f"}
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
        tables=[
            Table(rows=[*(room for room in rooms if room["mutants"]), total], columns=of_rooms),
            *([Table(rows=left, columns=of_survivors)] if left else []),
            *([Table(rows=left_out)] if left_out else []),
        ],
        data={"mutation": rows},
        peers={"cosmic-ray": version("cosmic-ray")},
    )


def measured(
    work: Path, sample: Sequence[Mutant], suite: Suite, jobs: int, hours: float
) -> list[Row]:
    """One row per mutant."""
    trials: Mapping[str, Trial] = Trials(work, suite, jobs).run(sample, hours)
    judged = judgements()
    return [row_of(m, trials.get(m.key), judged.get((m.file, m.before, m.after))) for m in sample]


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
    given, run = begin(parser)
    files = given.files or source_files()
    tests = given.tests
    n = given.sample
    if run.quick:
        files = list(QUICK_FILES)
        tests = list(QUICK_TESTS)
        n = QUICK_SAMPLE
    with tempfile.TemporaryDirectory() as own:
        work = (given.work or Path(own)).resolve()
        work.mkdir(parents=True, exist_ok=True)
        suite = recorded(work, tests, given.jobs)
        sys.stderr.write(f"{len(suite.seconds)} tests recorded, {len(suite.left_out)} left out\n")
        rows = measured(work, draw(ROOT, files, n, given.seed), suite, given.jobs, given.hours)
        run.write(report(rows, suite, given.seed, tests))


def source_files() -> list[str]:
    """Below the repository, of all rooms."""
    found = (path for room in ROOMS for path in (ROOT / "uvms_ocp" / room).rglob("*.py"))
    return sorted(path.relative_to(ROOT).as_posix() for path in found)


if __name__ == "__main__":
    main()
