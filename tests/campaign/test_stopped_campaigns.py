"""Ctrl-C ends a campaign with one error, whenever it comes, and the table so far."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from uvms_ocp.campaign import Campaign, Uniform, Variation, cluster
from uvms_ocp.interrupts import Interrupted

PROGRAM = """
import sys
from pathlib import Path

if __name__ == "__main__":
    from uvms_ocp.campaign import Campaign, Uniform, Variation

    masses = Variation("payload.mass", Uniform(0.0, 2.0))
    campaign = Campaign(scenario="case1", variations=[masses], runs=500)
    print("begins", flush=True)
    campaign.run(Path(sys.argv[1]), workers=2)
"""


def stopped_with(folder: Path, monkeypatch: pytest.MonkeyPatch, run_jobs: Any) -> Interrupted:
    monkeypatch.setattr(cluster, "run_jobs", run_jobs)
    masses = Variation("payload.mass", Uniform(0.0, 2.0))
    campaign = Campaign(scenario="case1", variations=[masses], runs=4)
    with pytest.raises(Interrupted) as stop:
        campaign.run(folder)
    return stop.value


def test_a_stop_before_there_is_a_folder_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*arguments: Any, **options: Any) -> None:
        raise KeyboardInterrupt

    stop = stopped_with(tmp_path / "loads", monkeypatch, stopped)
    assert str(stop).startswith("stopped with 0 of 4 runs in ")
    assert stop.result is None


def test_a_stop_gives_the_table_so_far(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(out: Path, identity: Any, work: Any, sources: Any, **options: Any) -> None:
        with cluster.opened(out, identity, sources):
            raise KeyboardInterrupt

    stop = stopped_with(tmp_path / "loads", monkeypatch, stopped)
    assert len(stop.result) == 0
    assert "payload.mass" in stop.result.columns


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "killpg"), reason="a terminal's Ctrl-C goes to a process group")
@pytest.mark.parametrize("after", [0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0])
def test_one_error_is_told_whenever_the_stop_comes(after: float, tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    process = subprocess.Popen(
        [sys.executable, str(program), str(tmp_path / "loads")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "begins\n"
    time.sleep(after)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate()
    assert said.count("Traceback") == 1, said
    assert "the same call goes on with the rest" in said.splitlines()[-1]
