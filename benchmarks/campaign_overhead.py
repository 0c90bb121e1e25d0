"""What the machinery of campaigns costs a run: ``python benchmarks/campaign_overhead.py [--runs
N]``.

Runs that do nothing, in processes of this machine; writes campaign_overhead.csv and
campaign_overhead.md.
"""

from __future__ import annotations

import os
import resource
import tempfile
from pathlib import Path
from time import perf_counter

from campaigns.trivial import Trivial, identity_of
from recording.report import Report, Row, Table, begin, parser_of

from uvms_ocp.campaign import read_table
from uvms_ocp.campaign.cluster import run_jobs

PROSE = """
{runs} runs that do nothing, of which every row goes to the disk. From the first row on, when
processes have started, a run takes {cost:.2f} ms with {workers} workers; {allowed:.0f} ms are
allowed. The client grew to {memory:.0f} MB at most.
"""
_ALLOWED = 3.0  # [ms]


def measured(runs: int, workers: int) -> Row:
    """Measure one campaign of so many runs on so many workers."""
    times: list[tuple[float, int]] = []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "campaign")
        work = Trivial()
        begun = perf_counter()
        run_jobs(
            out,
            identity_of(work, runs),
            work,
            workers=workers,
            progress=lambda done, failed, total: times.append((perf_counter() - begun, done)),
        )
        table = read_table(out)
    first, done = next((time, done) for time, done in times if done)
    last, _ = times[-1]
    return {
        "runs": runs,
        "workers": workers,
        "rows": len(table),
        "start [s]": first,
        "per run [ms]": 1e3 * (last - first) / max(runs - done, 1),
        "client [MB]": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
    }


def main() -> None:
    """Measure and write."""
    parser = parser_of(__doc__)
    parser.add_argument("--runs", type=int, default=10_000, metavar="N")
    arguments, run = begin(parser)
    workers = 1 if run.quick else os.cpu_count() or 1
    row = measured(300 if run.quick else arguments.runs, workers)
    prose = PROSE.format(
        runs=row["runs"],
        cost=row["per run [ms]"],
        workers=workers,
        allowed=_ALLOWED,
        memory=row["client [MB]"],
    )
    run.write(
        Report(
            name="campaign_overhead",
            title="Overhead of campaigns",
            prose=prose,
            tables=[Table(rows=[row])],
        )
    )


if __name__ == "__main__":
    main()
