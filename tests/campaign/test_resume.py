"""Killed at any moment and started again, a campaign loses nothing that was on the disk, and
repeats nothing of it.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from compiler import long_without_compiler
from trivial_runs import Cluster, cluster

from uvms_ocp.campaign.campaign import Campaign
from uvms_ocp.campaign.jobs import VARYING
from uvms_ocp.campaign.store import part_paths, read_table

pytestmark = [
    pytest.mark.filterwarnings(
        "ignore::DeprecationWarning", "ignore::ResourceWarning", "ignore::FutureWarning"
    ),
    pytest.mark.slow,
]
RUNS = 40
KILLS = 2
# that are written before a kill; then runs wait, so that no campaign ends before it is killed
PARTS = 2
MISSION = """
import uvms_ocp as uo

def scenario(**options):
    return uo.scenario.reach(**{"plant": "kinematic", "duration": 0.3, "dt": 0.02, **options})
"""
VARIATIONS = """
import time
from dataclasses import dataclass
from pathlib import Path

from uvms_ocp.campaign import Normal, Uniform, Variation

FOLDER = Path(__file__).parent

def limit():
    try:
        return int((FOLDER / "limit").read_text())
    except FileNotFoundError:
        return None

@dataclass(frozen=True)
class Held(Normal):
    def quantile(self, u):
        if limit() is not None:
            time.sleep(0.2)
        while (parts := limit()) is not None and len(list((FOLDER / "killed" / "rows").glob("part-*"))) >= parts:
            time.sleep(0.05)
        return super().quantile(u)

variations = [Variation("start.x", Held(0.0, 0.1)), Variation("goals.TP.x", Uniform(-0.05, 0.05))]
"""


@contextmanager
def client(folder: Path, *cluster: str, **options: bool) -> Iterator[subprocess.Popen[str]]:
    """The command in a process of its own, which ends with the block."""
    words = ["campaign", "mission.py", "--vary", "variations.py", "--runs", str(RUNS), "--force"]
    command = [sys.executable, "-m", "uvms_ocp", *words, "--out", "killed", *cluster]
    told = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    with subprocess.Popen(command, cwd=folder, **told, **options) as process:
        try:
            yield process
        finally:
            process.kill()


def finished(folder: Path) -> set[int]:
    return set(read_table(folder)["run"]) if part_paths(folder) else set()


def write_files(folder: Path) -> None:
    (folder / "mission.py").write_text(MISSION)
    (folder / "variations.py").write_text(VARIATIONS)


@long_without_compiler
def test_a_campaign_killed_again_and_again_equals_one_that_was_not(tmp_path: Path) -> None:
    write_files(tmp_path)
    draw = random.Random(16)
    finished_runs = set[int]()
    with cluster(tmp_path) as processes:
        for kill in range(KILLS):
            (tmp_path / "next").write_text(str(len(part_paths(tmp_path / "killed")) + PARTS))
            (tmp_path / "next").replace(tmp_path / "limit")  # whole whenever it is read
            with client(tmp_path, "--scheduler", processes.address) as process:
                finished_runs = _killed(
                    process, processes, tmp_path / "killed", finished_runs, draw, worker=kill == 1
                )
        (tmp_path / "limit").unlink()
        with client(tmp_path, "--scheduler", processes.address) as last:
            told, _ = last.communicate(timeout=300)
        assert last.returncode == 0, told
    whole = Campaign(
        scenario=str(tmp_path / "mission.py"), variations=str(tmp_path / "variations.py"), runs=RUNS
    ).run(tmp_path / "whole", workers=1)
    table = read_table(tmp_path / "killed")
    assert table["run"].tolist() == list(range(RUNS))
    assert table.drop(columns=[*VARYING]).equals(whole.drop(columns=[*VARYING]))
    assert table["start.x"].std() > 0.05


def _killed(
    process: subprocess.Popen[str],
    processes: Cluster,
    folder: Path,
    known: set[int],
    draw: random.Random,
    *,
    worker: bool,
) -> set[int]:
    """Runs that are on the disk after the client was killed, at some moment after more of them got
    there.
    """
    while process.poll() is None and len(finished(folder)) < len(known) + 1:
        time.sleep(0.2)
    if worker:
        processes.workers[0].kill()
        processes.add_worker()
    time.sleep(draw.uniform(0.0, 0.3))
    assert process.poll() is None, "the campaign was over before it could be killed"
    process.kill()
    process.communicate()
    after = finished(folder)
    assert known < after
    return after


def test_an_interrupt_of_the_whole_terminal_ends_the_command_cleanly_and_says_how_to_go_on(
    tmp_path: Path,
) -> None:
    write_files(tmp_path)
    with client(
        tmp_path, "--workers", "1", "--runs", "3000", start_new_session=True
    ) as process:  # far from its end
        while process.poll() is None and not finished(tmp_path / "killed"):
            time.sleep(0.2)
        os.killpg(process.pid, signal.SIGINT)
        told, _ = process.communicate(timeout=300)
    assert process.returncode == 130, told
    assert "the same command goes on" in told.replace("\n", " ")
    assert "Traceback" not in told
