"""Random missions: ``python benchmarks/random_missions.py [--missions N] [--jobs N]``.

What pre-flight refuses is run as well, to tell the refusals that were false. Writes
random_missions.csv, one row per mission of the study `random_missions`, and its sums to
random_missions.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from recording.progress import show_runs
from recording.report import Report, Row, Table, add_jobs_option, begin, parser_of
from recording.rows import column, known_values, rows_where
from studies.random_missions import random_missions
from studies.study import StudyResult

PROSE = """
Seeds {first} to {last}, {plant} plant, {rate:.0f} Hz; one row each in `random_missions.csv`. Drawn:
start, heading, target, way point, current, floor and, in {boulders} of them, a boulder beside the
way with the clearance task on (`random_mission` has the ranges). Clearance is that of the whole
robot, by coal: from floor and boulder while the minimum altitude is fully on, from the boulder over
the whole run.

What is accepted and completes lasts {shortest:.0f} to {longest:.0f} s; {collided} of the accepted
collide. Accepted but not completed: {failed}.

The {refused} refused missions were run all the same: {false} of them complete, refusals that were
false: {false_seeds}. Tasks whose goals were the cause of a refusal, and how often: {causes}.
"""


def sums(cases: Sequence[Row]) -> list[Row]:
    """One row for the missions without a boulder, with one, and for all."""
    return [
        _sum("open water", rows_where(cases, "boulder", False)),
        _sum("with a boulder", rows_where(cases, "boulder", True)),
        _sum("all", cases),
    ]


def _sum(name: str, rows: Sequence[Row]) -> Row:
    """Count how missions of one kind fared."""
    accepted = rows_where(rows, "accepted", True)
    refused = rows_where(rows, "accepted", False)
    clearances = known_values(accepted, "clearance_m")
    boulder_clearances = known_values(accepted, "boulder_clearance_m")
    return {
        "missions": name,
        "number": len(rows),
        "accepted": len(accepted),
        "completed": sum(column(accepted, "completed")),
        "smallest clearance [m]": min(clearances, default=None),
        "of them from the boulder [m]": min(boulder_clearances, default=None),
        "refused, but completed": sum(column(refused, "completed")),
    }


def prose(result: StudyResult) -> str:
    """Fill in the figures of the study."""
    cases = result.cases
    (total,) = result.table
    accepted = rows_where(cases, "accepted", True)
    refused = rows_where(cases, "accepted", False)
    durations = column(rows_where(accepted, "completed", True), "duration_s")
    false_seeds = list(map(str, column(rows_where(refused, "completed", True), "seed")))
    causes = Counter[str]()
    for refusal in column(refused, "refusal"):
        cause, _, _ = refusal.partition(":")
        causes[cause] += 1
    cause_texts = [f"{cause} {number}" for cause, number in sorted(causes.items())]
    return PROSE.format(
        first=cases[0]["seed"],
        last=cases[-1]["seed"],
        plant=cases[0]["plant"],
        rate=1 / cases[0]["dt"],
        boulders=sum(column(cases, "boulder")),
        shortest=min(durations, default=float("nan")),
        longest=max(durations, default=float("nan")),
        collided=total["collided"],
        failed=total["causes"] or "none",
        refused=len(refused),
        false=len(false_seeds),
        false_seeds=f"seeds {', '.join(false_seeds)}" if false_seeds else "none",
        causes=", ".join(cause_texts) or "none",
    )


def main() -> None:
    """Run the study."""
    parser = parser_of(__doc__)
    parser.add_argument("--missions", type=int, default=200, metavar="N")
    add_jobs_option(parser)
    arguments, run = begin(parser)
    if run.quick:
        # The mission of seed 1 is accepted; one that is refused runs until its time is over.
        study = random_missions(n=1, seed=1, plant="kinematic")
        jobs = 1
    else:
        study = random_missions(n=arguments.missions, force=True)
        jobs = arguments.jobs
    result = study.run(workers=jobs, progress=show_runs)
    run.write(
        Report(
            name="random_missions",
            title="Random missions",
            prose=prose(result),
            tables=[Table(rows=sums(result.cases))],
            data={"random_missions": result.cases},
        )
    )


if __name__ == "__main__":
    main()
