"""Files that earlier versions wrote are read by this one: each format has its version, and a stored
file of it.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from uvms_ocp.campaign import campaign_report, read_table
from uvms_ocp.campaign.campaign import kept_campaign
from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.record import Record

RECORDS = Path(__file__).parents[1] / "records"
LOADERS = {"run_v1.parquet": Record.from_parquet, "run_v1.mcap": Record.from_mcap}


@pytest.mark.parametrize("name", LOADERS)
def test_exported_files_of_version_1_hold_the_record_of_the_same_run(name: str) -> None:
    expected = Record.load(RECORDS / "run_v0_2.npz")
    loaded = LOADERS[name](RECORDS / name)
    assert loaded.meta == expected.meta
    assert loaded.series.keys() == expected.series.keys()
    for series, array in expected.series.items():
        assert loaded[series].dtype == array.dtype
        assert loaded[series].tobytes() == array.tobytes(), series


def test_a_folder_of_a_campaign_of_version_1_is_read_reported_and_its_runs_are_made_again() -> None:
    folder = RECORDS / "campaign_v1"
    table = read_table(folder)
    report = campaign_report(folder)
    assert table["run"].tolist() == list(range(6))
    assert (report["runs"], report["finished"]) == (6, 6)
    stored_campaign = kept_campaign(folder)
    assert stored_campaign.work.head(3) == {
        "seed": table["seed"][3],
        "start.x": table["start.x"][3],
    }
    row = stored_campaign.work.make(3).row
    assert row["path_length_m"] == pytest.approx(table["path_length_m"][3], rel=1e-6)


def test_a_version_that_is_not_known_yet_is_refused_by_its_number(tmp_path: Path) -> None:
    folder = tmp_path / "campaign"
    shutil.copytree(RECORDS / "campaign_v1", folder, copy_function=shutil.copyfile)
    manifest = json.loads((folder / "campaign.json").read_text())
    (folder / "campaign.json").write_text(json.dumps(manifest | {"version": 2}))
    with pytest.raises(InvalidInput, match="version"):
        read_table(folder)


def test_the_stored_record_is_one_of_a_moving_robot() -> None:
    assert np.ptp(Record.load(RECORDS / "run_v0_2.npz")["q"][:, 0]) > 0.0
