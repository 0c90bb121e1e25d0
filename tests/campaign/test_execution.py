"""Every run becomes one row: what finishes, what raises, and what ends its process."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path

import pytest
from trivial_runs import TrivialRuns, cluster, identity_of

from uvms_ocp.campaign.cluster import run_jobs
from uvms_ocp.campaign.store import read_table
from uvms_ocp.campaign.time_limit import OverTime, time_limit
from uvms_ocp.errors import InvalidInput, OutputError

pytestmark = pytest.mark.filterwarnings(
    "ignore::DeprecationWarning", "ignore::ResourceWarning", "ignore::FutureWarning"
)


@pytest.mark.slow
def test_a_raising_run_is_a_row_with_its_text_and_a_deadly_one_too_and_none_else_is_blamed(
    tmp_path: Path,
) -> None:
    work = TrivialRuns(pause=0.4, deadly=frozenset({3}), broken=frozenset({5}))
    told = []
    run_jobs(
        tmp_path,
        identity_of(work, 10),
        work,
        workers=2,
        progress=lambda *numbers: told.append(numbers),
    )
    table = read_table(tmp_path).set_index("run")
    assert table.index.tolist() == list(range(10))
    assert table["outcome"][table["outcome"] != "completed"].to_dict() == {3: "killed", 5: "error"}
    assert table["cause"][5].startswith("ValueError: run 5 was never to be (trivial_runs.py:")
    assert "process of the run ended" in table["cause"][3]
    assert table["share"].tolist() == [run / 7.0 for run in range(10)]
    assert (told[0], told[-1]) == ((0, 0, 10), (10, 2, 10))


@pytest.mark.slow
def test_a_run_without_end_is_a_row_that_says_so_and_the_others_go_on(tmp_path: Path) -> None:
    work = TrivialRuns(endless=frozenset({2}), asleep=frozenset({4}))
    run_jobs(tmp_path, identity_of(work, 8), work, workers=1, limit=1.5)
    table = read_table(tmp_path).set_index("run")
    assert table.index.tolist() == list(range(8))
    assert table["outcome"][table["outcome"] != "completed"].to_dict() == {
        2: "time limit",
        4: "time limit",
    }
    assert table["cause"][2].startswith("not over after 1.5 s, and stopped")
    assert "trivial_runs.py:" in table["cause"][2]
    assert table["share"].tolist() == [run / 7.0 for run in range(8)]


def test_a_time_that_is_over_ends_the_block_whatever_it_catches_and_never_what_follows() -> None:
    for seconds in (0.0, 0.01, 0.1):
        with (
            pytest.raises(OverTime),
            time_limit(seconds, stuck=lambda: pytest.fail("it was not stuck")),
        ):
            while True:
                try:
                    time.sleep(0.001)
                except Exception:
                    continue
    for _ in range(200):  # ends at about the same time
        with suppress(OverTime), time_limit(0.002, stuck=lambda: pytest.fail("it was not stuck")):
            time.sleep(0.002)
    time.sleep(0.1)


@pytest.mark.slow
def test_short_runs_share_tasks_and_come_back_whole(tmp_path: Path) -> None:
    work = TrivialRuns()
    run_jobs(tmp_path, identity_of(work, 3000), work, workers=1)
    table = read_table(tmp_path)
    assert (table["square"] == table["run"] ** 2).all()
    assert len(table) == 3000
    assert len(list((tmp_path / "rows").iterdir())) == 1  # a campaign that is complete is one file


@pytest.mark.slow
def test_a_cluster_at_an_address_loses_a_worker_and_gets_another(tmp_path: Path) -> None:
    work = TrivialRuns(pause=0.05)
    with cluster(tmp_path) as processes:

        def kill_one(done: int, failed: int, total: int) -> None:
            if done > 20 and len(processes.workers) == 2:
                processes.workers[0].kill()
                processes.add_worker()

        out = tmp_path / "campaign"
        run_jobs(out, identity_of(work, 80), work, scheduler=processes.address, progress=kill_one)
    table = read_table(out)
    assert table["run"].tolist() == list(range(80))
    assert table["success"].all()
    assert len(processes.workers) == 3


@pytest.mark.slow
def test_on_a_cluster_of_others_only_the_run_that_ends_processes_by_itself_is_blamed(
    tmp_path: Path,
) -> None:
    work = TrivialRuns(pause=0.4, deadly=frozenset({2}))
    with cluster(tmp_path, workers=1) as processes:

        def replace_the_dead(done: int, failed: int, total: int) -> None:
            if all(worker.poll() is not None for worker in processes.workers):
                processes.add_worker()

        out = tmp_path / "campaign"
        run_jobs(
            out, identity_of(work, 5), work, scheduler=processes.address, progress=replace_the_dead
        )
    assert read_table(out)["outcome"].tolist() == [
        "completed",
        "completed",
        "killed",
        "completed",
        "completed",
    ]


def test_an_address_where_nobody_answers_is_an_error_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uvms_ocp.campaign.cluster._CONNECTION_TIMEOUT", 1.0)
    work = TrivialRuns()
    with pytest.raises(OutputError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        run_jobs(tmp_path / "out", identity_of(work, 3), work, scheduler="tcp://127.0.0.1:9")
    assert not (tmp_path / "out").exists()


def test_workers_are_not_for_a_cluster_of_others(tmp_path: Path) -> None:
    work = TrivialRuns()
    with pytest.raises(InvalidInput, match="a cluster has its own"):
        run_jobs(tmp_path, identity_of(work, 3), work, scheduler="tcp://127.0.0.1:9", workers=2)
