"""The folder of a campaign: rows once on the disk stay, each once, and only of this campaign."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from trivial_runs import TrivialRuns, identity_of

from uvms_ocp.campaign import store as parts_module
from uvms_ocp.campaign.jobs import attempt_job
from uvms_ocp.campaign.manifest import read_manifest
from uvms_ocp.campaign.sampling_design import GROWING, Design
from uvms_ocp.campaign.store import opened, read_table
from uvms_ocp.errors import InvalidInput, OutputError

WORK = TrivialRuns()


def made(folder: Path, runs: list[int], total: int = 20, work: TrivialRuns = WORK) -> None:
    with opened(folder, identity_of(WORK, total), {"scenario/a.txt": b"copy"}) as campaign:
        for run in runs:
            campaign.add(attempt_job(work, run, "here"))


def test_rows_are_there_by_run_number_whatever_their_order(tmp_path: Path) -> None:
    made(tmp_path, [7, 3])
    made(tmp_path, [11, 0])
    assert read_table(tmp_path)["run"].tolist() == [0, 3, 7, 11]


def test_what_is_finished_is_known_and_is_not_kept_twice(tmp_path: Path) -> None:
    made(tmp_path, [4, 5])
    with opened(tmp_path, identity_of(WORK, 20), {}) as campaign:
        assert 4 not in campaign.left
        assert len(campaign.left) == 18
        campaign.add(attempt_job(TrivialRuns(broken=frozenset({4})), 4, "there"))
    assert read_table(tmp_path)["outcome"].tolist() == ["completed", "completed"]


def test_rows_are_on_the_disk_when_the_block_ends_in_an_interrupt(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), opened(tmp_path, identity_of(WORK, 20), {}) as campaign:
        campaign.add(attempt_job(WORK, 2, "here"))
        raise KeyboardInterrupt
    assert read_table(tmp_path)["run"].tolist() == [2]


def test_rows_that_have_waited_go_to_the_disk_by_themselves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uvms_ocp.campaign.store._BATCH_AGE", 0.0)
    with opened(tmp_path, identity_of(WORK, 20), {}) as campaign:
        campaign.add(attempt_job(WORK, 2, "here"))
        campaign.flush()
        assert read_table(tmp_path)["run"].tolist() == [2]


def test_a_campaign_grows_in_its_folder_and_no_run_is_made_twice(tmp_path: Path) -> None:
    made(tmp_path, list(range(20)))
    with opened(tmp_path, identity_of(WORK, 30, sampler="random"), {}) as campaign:
        assert campaign.left.tolist() == list(range(20, 30))
        campaign.add(attempt_job(WORK, 25, "here"))
    assert read_manifest(tmp_path).runs == 30
    assert read_table(tmp_path)["run"].tolist() == [*range(20), 25]


@pytest.mark.parametrize("sampler", GROWING)
def test_more_runs_of_a_campaign_begin_with_the_same(sampler: str) -> None:
    small_design, large_design = (
        Design(sampler=sampler, runs=runs, parameters=3, seed=7) for runs in (13, 100)
    )
    for run in range(13):
        np.testing.assert_array_equal(small_design.row(run), large_design.row(run))
        assert small_design.seed_of(run) == large_design.seed_of(run)


def test_a_hypercube_cannot_grow(tmp_path: Path) -> None:
    with opened(tmp_path, identity_of(WORK, 20, sampler="latin"), {}):
        pass
    with (
        pytest.raises(InvalidInput, match=r"not the same: runs \(20, now 21\)"),
        opened(tmp_path, identity_of(WORK, 21, sampler="latin"), {}),
    ):
        pass


@pytest.mark.parametrize(
    "change", [{"runs": 19}, {"seed": 1}, {"package": "0"}, {"parameters": {"a": "Uniform(0, 1)"}}]
)
def test_another_campaign_is_refused_and_what_differs_is_named(
    tmp_path: Path, change: dict[str, object]
) -> None:
    made(tmp_path, [1])
    with (
        pytest.raises(
            InvalidInput, match=f"another campaign is there; not the same: {next(iter(change))}"
        ),
        opened(tmp_path, identity_of(WORK, **({"runs": 20} | change)), {}),
    ):
        pass


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("all of it")
    with pytest.raises(InvalidInput, match=r"holds thesis.txt and no campaign"):
        made(tmp_path, [1])


def test_sources_that_cannot_be_kept_are_told_in_one_line(tmp_path: Path) -> None:
    made(tmp_path, [1])
    shutil.rmtree(tmp_path / "sources")
    (tmp_path / "sources").write_text("a file where a folder is wanted")
    with (
        pytest.raises(OutputError, match="cannot write there"),
        opened(tmp_path, identity_of(WORK, 20), {"mission.py": b"x = 1"}),
    ):
        pass


def test_one_process_at_a_time(tmp_path: Path) -> None:
    with (
        opened(tmp_path, identity_of(WORK, 20), {}),
        pytest.raises(OutputError, match="another command writes there"),
    ):
        made(tmp_path, [1])


def test_a_file_cut_short_does_not_count_and_is_removed(tmp_path: Path) -> None:
    made(tmp_path, [1])
    (tmp_path / "rows" / "part-00000009.tmp").write_bytes(b"PAR1 half")
    made(tmp_path, [2])
    assert read_table(tmp_path)["run"].tolist() == [1, 2]
    assert not list((tmp_path / "rows").glob("*.tmp"))


def test_a_damaged_part_is_named(tmp_path: Path) -> None:
    made(tmp_path, [1])
    (part,) = (tmp_path / "rows").iterdir()
    part.write_bytes(b"PAR1 and no more")
    with pytest.raises(InvalidInput, match=r"part-00000000.parquet: damaged"):
        read_table(tmp_path)


def test_parts_are_joined_and_cut_off_meanwhile_each_row_still_counts_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for run in range(4):
        made(tmp_path, [run])
    before = read_table(tmp_path)
    monkeypatch.setattr(
        Path, "unlink", lambda self, **_: None
    )  # killed before the old ones are gone
    with opened(tmp_path, identity_of(WORK, 20), {}) as campaign:
        campaign._join()
    monkeypatch.undo()
    assert len(list((tmp_path / "rows").iterdir())) == 5
    assert read_table(tmp_path).equals(before)


def test_many_parts_do_not_pile_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts_module, "_MAX_PARTS", 3)
    for run in range(10):
        made(tmp_path, [run])
    assert len(list((tmp_path / "rows").iterdir())) <= 3
    assert read_table(tmp_path)["run"].tolist() == list(range(10))


def test_records_and_copies_are_kept_whole(tmp_path: Path) -> None:
    made(tmp_path, [3], work=TrivialRuns(kept=True))
    assert (tmp_path / "records" / "run-00000003.npz").read_bytes() == b"whole"
    assert (tmp_path / "sources" / "scenario" / "a.txt").read_bytes() == b"copy"
    assert not [
        name for _, _, names in os.walk(tmp_path) for name in names if name.endswith(".tmp")
    ]


def test_what_is_no_campaign_is_told(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="no campaign is there"):
        read_manifest(tmp_path)
