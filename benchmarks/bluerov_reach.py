"""Reaching with a small vehicle under published sets of drag: ``python benchmarks/bluerov_reach.py
[--seeds N] [--jobs N]``.

The controller keeps the nominal set; the plant gets each of them, with sensor noise. Writes
bluerov_reach.csv, one row per mission, and bluerov_reach.md: how many complete, and why the others
do not.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product

from recording.report import Report, Row, Table, add_jobs_option, begin, parser_of
from recording.rows import column, rows_where

from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.loading import list_variants
from uvms_ocp.scenario.cases.bluerov import reach

ROBOT = "bluerov2_alpha5"
NOMINAL = "nominal"
PROSE = """
{runs} missions of the scenario `reach` with noisy sensors, seeds {first} to {last}: {completed}
complete. The largest error of the tool where they do: {worst}. Not completed: {causes}.
"""


def attempt(job: tuple[int, str, float | None]) -> Row:
    """One mission of a seed under a set of drag; a duration [s] ends it early."""
    seed, drag, duration = job
    variant = None if drag == NOMINAL else drag
    scenario = reach(robot=ROBOT, seed=seed, variant=variant, noise=True, duration=duration)
    report = summarize(scenario.run())
    return {
        "seed": seed,
        "drag": drag,
        "completed": report["completed"],
        "simulated_s": round(report["simulated_s"], 2),
        "tool_error_mm": round(1e3 * report["tool_position_error_m"], 2),
        "cause": report["pending"],
    }


def sums(rows: Sequence[Row]) -> list[Row]:
    """One row per set of drag."""
    table: list[Row] = []
    for drag in dict.fromkeys(column(rows, "drag")):
        missions = rows_where(rows, "drag", drag)
        table.append(
            {
                "drag": drag,
                "missions": len(missions),
                "completed": sum(column(missions, "completed")),
                "longest [s]": max(column(missions, "simulated_s")),
                "largest tool error [mm]": max(column(missions, "tool_error_mm")),
            }
        )
    return table


def prose(rows: Sequence[Row]) -> str:
    """Fill in the figures of all missions."""
    done = [row["tool_error_mm"] for row in rows if row["completed"]]
    failed = [row for row in rows if not row["completed"]]
    causes = [f"seed {row['seed']}, {row['drag']}: {row['cause']}" for row in failed]
    return PROSE.format(
        runs=len(rows),
        first=rows[0]["seed"],
        last=rows[-1]["seed"],
        completed=len(done),
        worst=f"{max(done):.1f} mm" if done else "none",
        causes="; ".join(causes) or "none",
    )


def attempts(jobs: Iterable[tuple[int, str, float | None]], processes: int) -> list[Row]:
    """Run all missions in so many processes."""
    with ProcessPoolExecutor(max_workers=processes) as pool:
        return list(pool.map(attempt, jobs))


def main() -> None:
    """Run all missions."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=20, metavar="N")
    add_jobs_option(parser)
    arguments, run = begin(parser)
    drags = (NOMINAL, *list_variants(ROBOT))
    if run.quick:
        rows = [attempt((0, drags[-1], 1.0))]
    else:
        rows = attempts(product(range(arguments.seeds), drags, [None]), arguments.jobs)
    run.write(
        Report(
            name="bluerov_reach",
            title="Reaching under other drag",
            prose=prose(rows),
            tables=[Table(rows=sums(rows))],
            data={"bluerov_reach": rows},
        )
    )


if __name__ == "__main__":
    main()
