"""Files of our own need no mapping, those of others say that they do, and a command shows what is
in either.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from motions import DOWN, recorded
from typer.testing import CliRunner

from uvms_ocp.cli.commands import app
from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.channel_mapping import read_mapping
from uvms_ocp.identification.reading import read_recording
from uvms_ocp.identification.tables import write_columns, write_recording
from uvms_ocp.record.record import Record
from uvms_ocp.scenario.cases.case1 import case1

GOOD = recorded()
PLAN = Path(__file__).parents[1] / "records" / "plan_curve_v0_1.npz"
NEEDS = {".parquet": "pyarrow", ".mcap": "mcap"}
MAPPING = "channels: {{linear_velocity: {{{where}, time: t, columns: [a, b, c]}}}}"


@pytest.fixture(scope="module")
def run() -> Record:
    return case1(noise=True, dt=0.02, duration=0.5).run()


@pytest.mark.sampled
@pytest.mark.parametrize("ending", [".npz", ".parquet", ".mcap"])
def test_a_record_of_a_run_is_a_recording_of_what_was_measured(
    ending: str, run: Record, tmp_path: Path
) -> None:
    if ending in NEEDS:
        pytest.importorskip(NEEDS[ending], reason='needs pip install "uvms-ocp[identify,mcap]"')
    path = tmp_path / f"dive{ending}"
    {".npz": run.save, ".parquet": run.to_parquet, ".mcap": run.to_mcap}[ending](path)
    recording = read_recording(path)
    assert recording.name == "dive"
    for name in ("position", "angular_velocity"):
        new = run[f"measured_{name}"][np.isfinite(run[f"measured_{name}"]).all(axis=1)]
        np.testing.assert_array_equal(recording.channels[name].t, new[:, 3])
        np.testing.assert_array_equal(recording.channels[name].values, new[:, :3])
    for name, values in {
        "joint_positions": run["q_estimated"][:, 7:],
        "current": run["current"],
    }.items():
        np.testing.assert_array_equal(recording.channels[name].t, run["t"])
        np.testing.assert_array_equal(recording.channels[name].values, values)
    np.testing.assert_array_equal(recording.channels["thrust"].t[1:], run["t"])
    np.testing.assert_array_equal(recording.channels["thrust"].values[1:], run["asked_thrust"])


def test_a_recording_of_ours_is_read_by_its_ending(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason='needs pip install "uvms-ocp[identify]"')
    for ending in (".csv", ".parquet"):
        write_recording(GOOD, tmp_path / f"a{ending}")
        assert set(read_recording(tmp_path / f"a{ending}").channels) == set(GOOD.channels)


def test_the_record_of_a_plan_is_none() -> None:
    with pytest.raises(InvalidInput, match="this record is of a plan"):
        read_recording(PLAN)


def test_messages_of_others_need_a_mapping_and_say_of_which_topics(tmp_path: Path) -> None:
    writer = pytest.importorskip("mcap.writer", reason='needs pip install "uvms-ocp[mcap]"')
    with (tmp_path / "a.mcap").open("wb") as file:
        made = writer.Writer(file)
        made.start()
        channel = made.register_channel("/state", "json", 0)
        for k in range(3):
            made.add_message(
                channel, k, json.dumps({"t": k, "a": 1.0, "b": 2.0, "c": k}).encode(), k
            )
        made.finish()
    with pytest.raises(
        InvalidInput, match=r"a\.mcap: no record of ours; give a mapping of its topics: /state"
    ):
        read_recording(tmp_path / "a.mcap")
    (tmp_path / "map.yaml").write_text(MAPPING.format(where="topic: /state"))
    read = read_recording(tmp_path / "a.mcap", read_mapping(tmp_path / "map.yaml"))
    np.testing.assert_array_equal(read.channels["linear_velocity"].values[:, 2], [0.0, 1.0, 2.0])


def test_a_mapping_is_for_files_of_others_and_ours_beside_them_are_read_as_they_are(
    tmp_path: Path, run: Record
) -> None:
    run.save(tmp_path / "dive.npz")
    write_recording(GOOD, tmp_path / "good.csv")
    velocity = GOOD.channels["linear_velocity"]
    write_columns(
        tmp_path / "other.csv",
        {"t": velocity.t, **dict(zip("abc", velocity.values.T, strict=True))},
    )
    (tmp_path / "map.yaml").write_text(MAPPING.format(where="body: FRD"))
    files = [tmp_path / name for name in ("dive.npz", "good.csv", "other.csv")]
    report = json.loads(checked(*files, "--mapping", tmp_path / "map.yaml", "--json"))
    channels = {
        name: [row["channel"] for row in recording["channels"]]
        for name, recording in report.items()
    }
    assert channels["good"] == list(GOOD.channels)
    assert channels["other"] == ["linear_velocity"]
    assert "thrust" in channels["dive"]


def test_what_is_wrong_with_a_record_of_ours_is_said_with_a_mapping_too(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(MAPPING.format(where="body: FRD"))
    with pytest.raises(InvalidInput, match="this record is of a plan"):
        read_recording(PLAN, read_mapping(tmp_path / "map.yaml"))


@pytest.mark.parametrize(
    "name", ["none.csv", "none.csv.gz", "none.parquet", "none.mcap", "none.npz", "none"]
)
def test_what_is_not_there_is_said_to_be_so_with_a_mapping_and_without(
    name: str, tmp_path: Path
) -> None:
    (tmp_path / "map.yaml").write_text(MAPPING.format(where="body: FRD"))
    for mapping in (None, read_mapping(tmp_path / "map.yaml")):
        with pytest.raises(InvalidInput, match=f"{name}: there is no such file"):
            read_recording(tmp_path / name, mapping)


def checked(*words: object) -> str:
    result = CliRunner().invoke(app, ["check-recording", *map(str, words)], env={"COLUMNS": "200"})
    assert result.exit_code == 0, result.output
    return result.stdout


def test_samples_that_are_missing_are_counted_beside_their_channel_and_rows_of_other_channels_are_not(
    tmp_path: Path,
) -> None:
    t = np.arange(0.0, 40.0, 0.1)
    depth = np.where(
        np.arange(len(t)) % 4 == 0, 3.0 + np.sin(0.3 * t), np.nan
    )  # beside what comes four times as often
    depth[[40, 80, 200]] = -99.0
    write_columns(
        tmp_path / "a.csv",
        {"t": t, "depth": depth, "u": np.sin(t), "v": np.cos(t), "w": np.sin(2.0 * t)},
    )
    (tmp_path / "map.yaml").write_text(
        "channels: {position: {time: t, columns: [0.0, 0.0, -depth], missing: [-99]}, "
        "linear_velocity: {time: t, columns: [u, v, w]}}"
    )
    report = json.loads(checked(tmp_path / "a.csv", "--mapping", tmp_path / "map.yaml", "--json"))[
        "a"
    ]
    assert [row["missing"] for row in report["channels"]] == [3, 0]
    assert report["doubts"] == ["position: 3 of 100 rows have NaN (-depth) and are left out"]
    assert "missing" in checked(tmp_path / "a.csv", "--mapping", tmp_path / "map.yaml")


def test_a_command_tells_channels_and_doubts_of_every_recording(tmp_path: Path) -> None:
    write_recording(GOOD, tmp_path / "good.csv")
    report = json.loads(checked(tmp_path / "good.csv", "--json"))
    assert report["good"]["doubts"] == []
    assert [row["channel"] for row in report["good"]["channels"]] == list(GOOD.channels)
    assert report["good"]["channels"][0]["rate [Hz]"] == pytest.approx(20.0)
    turned = dict(zip("abc", (GOOD.channels["linear_velocity"].values @ DOWN).T, strict=True))
    position = dict(zip("xyz", GOOD.channels["position"].values.T, strict=True))
    attitude = dict(zip("ijkl", GOOD.channels["attitude"].values.T, strict=True))
    write_columns(
        tmp_path / "other.csv", {"t": GOOD.channels["position"].t, **turned, **position, **attitude}
    )
    (tmp_path / "map.yaml").write_text(
        MAPPING.format(where="body: FLU")[:-1]
        + ", position: {time: t, columns: [x, y, z]}, attitude: {time: t, columns: [i, j, k, l]}}"
    )
    text = checked(tmp_path / "other.csv", "--mapping", tmp_path / "map.yaml")
    assert "linear_velocity" in text
    assert "doubtful: linear_velocity: its axes fit the rate of the position as (x, -y, -z)" in text
