"""A campaign that is killed again and again: ``python benchmarks/campaign_resume.py [--runs N]
[--kills N]``.

Client or worker get SIGKILL at random moments; what is there in the end is compared with a campaign
that nobody disturbed. Writes campaign_resume.csv, one row per kill, and campaign_resume.md.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from campaigns.case1_runs import BRIEF, brief_case1
from recording.report import Report, Row, Table, begin, parser_of

from uvms_ocp.campaign import Campaign, read_table
from uvms_ocp.campaign.jobs import VARYING
from uvms_ocp.campaign.store import part_paths

PROSE = """
{runs} runs of the beginning of Case 1, killed {kills} times by SIGKILL at random moments, {workers}
of them one of its workers and else the client with all of them, then started again with the same
command. Rows that were on the disk before a kill and not after it: {lost}. The table equals that of
a campaign that nobody disturbed, time and place of the runs aside: {equal}.
"""


def campaign_of(runs: int) -> Campaign:
    """Make the campaign of so many runs, the same in every process."""
    return Campaign(scenario=brief_case1, variations=BRIEF, runs=runs)


def finished(folder: Path) -> set[int]:
    """Runs that are on the disk."""
    if not part_paths(folder):
        return set()
    return set(read_table(folder)["run"].tolist())


def killed(folder: Path, runs: int, draw: random.Random, *, workers: int, a_worker: bool) -> Row:
    """Start the client, wait for new rows and a random while, and kill; runs."""
    before = finished(folder)
    words = ["--child", str(folder), "--runs", str(runs), "--workers", str(workers)]
    client = subprocess.Popen([sys.executable, __file__, *words])
    while client.poll() is None and len(finished(folder)) <= len(before):
        time.sleep(0.2)
    time.sleep(draw.uniform(0.0, 3.0))
    if a_worker:
        for child in _workers(client.pid)[:1]:
            os.kill(child, signal.SIGKILL)
        time.sleep(draw.uniform(1.0, 5.0))
    if client.poll() is None:
        client.send_signal(signal.SIGKILL)
    client.wait()
    after = finished(folder)
    return {
        "killed": "worker, then client" if a_worker else "client",
        "before": len(before),
        "after": len(after),
        "lost": len(before - after),
    }


def _workers(pid: int) -> list[int]:
    """Children of a process that are workers."""
    workers = []
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        command = Path(f"/proc/{child}/cmdline").read_bytes()
        if b"spawn_main" in command:
            workers.append(int(child))
    return workers


def main() -> None:
    """Kill, go on, compare."""
    parser = parser_of(__doc__)
    parser.add_argument("--runs", type=int, default=400, metavar="N")
    parser.add_argument("--kills", type=int, default=10, metavar="N")
    parser.add_argument(
        "--workers", type=int, default=os.cpu_count() or 1, metavar="N", help="processes"
    )
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    arguments, run = begin(parser)
    runs = arguments.runs
    kills = arguments.kills
    workers = arguments.workers
    if arguments.child:
        campaign_of(runs).run(arguments.child, workers=workers)
        return
    if run.quick:
        runs = 6
        kills = 1
        workers = 1
    draw = random.Random(0)
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary, "killed")
        for kill in range(kills):
            rows.append(killed(folder, runs, draw, workers=workers, a_worker=kill % 3 == 1))
        table = campaign_of(runs).run(folder, workers=workers)
        whole = campaign_of(runs).run(Path(temporary, "whole"), workers=workers)
    equal = table.drop(columns=[*VARYING]).equals(whole.drop(columns=[*VARYING]))
    prose = PROSE.format(
        runs=runs,
        kills=kills,
        workers=sum(row["killed"] != "client" for row in rows),
        lost=sum(row["lost"] for row in rows),
        equal="yes" if equal else "NO",
    )
    run.write(
        Report(
            name="campaign_resume", title="Killed campaigns", prose=prose, tables=[Table(rows=rows)]
        )
    )


if __name__ == "__main__":
    main()
