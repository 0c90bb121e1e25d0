"""Table 2 of the paper, minimum altitude against the sea floor: ``python benchmarks/table2.py
[--seeds N] [--jobs N]``.

Writes table2.csv, one row per transit of the study `table2`, and its cells to table2.md.
"""

from __future__ import annotations

from collections.abc import Sequence

from recording.progress import show_runs
from recording.report import Report, Row, Table, add_jobs_option, begin, parser_of
from recording.rows import column
from studies.table2 import FLOORS, MARGIN, table2

from uvms_ocp.sim.rough_seafloor import RELIEFS

PROSE = """
{runs} transits of {length:g} m on the kinematic plant, {seeds} floors for each cell; each takes
{shortest:.0f} to {longest:.0f} s, and {completed} complete. Smallest and largest of the clearances
[m] of the whole robot in each cell, by coal against a mesh of the floor; contact counts as
{contact} or less, {margin:g} m as safe. Verdicts as in `studies.table2.verdict`.

{agree} cells of {cells} agree. The paper names its floors but does not measure them; ours have
protuberances of {reliefs} (`uvms_ocp.sim.rough_seafloor.RELIEFS`).
"""
FORMATS = {
    "floor": "",
    "threshold_m": "g",
    "smallest_clearance_m": ".2f",
    "largest_m": ".2f",
    "verdict": "",
    "paper": "",
    "agrees": "",
}


def prose(cases: Sequence[Row], cells: Sequence[Row], seeds: int) -> str:
    """Fill in the figures of the study."""
    durations = column(cases, "duration_s")
    reliefs = []
    for name, relief in RELIEFS.items():
        low, high = relief.height
        reliefs.append(f"{low:g} to {high:g} m ({FLOORS[name]})")
    return PROSE.format(
        runs=len(cases),
        length=cases[0]["length_m"],
        seeds=seeds,
        shortest=min(durations),
        longest=max(durations),
        completed=sum(column(cases, "completed")),
        contact=0,
        margin=MARGIN,
        agree=sum(column(cells, "agrees")),
        cells=len(cells),
        reliefs=", ".join(reliefs),
    )


def main() -> None:
    """Run the study."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=10, metavar="N", help="floors for each cell")
    add_jobs_option(parser)
    arguments, run = begin(parser)
    if run.quick:
        seeds = 1
        length = 2.0
        jobs = 1
    else:
        seeds = arguments.seeds
        length = 30.0
        jobs = arguments.jobs
    result = table2(seeds=seeds, length=length).run(workers=jobs, progress=show_runs)
    run.write(
        Report(
            name="table2",
            title="Table 2: minimum altitude against the sea floor",
            prose=prose(result.cases, result.table, seeds),
            tables=[Table(rows=result.table, columns=FORMATS)],
            data={"table2": result.cases},
        )
    )


if __name__ == "__main__":
    main()
