"""Records survive a round trip without pickle; output folders appear whole or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uvms_ocp.exceptions import InvalidInput, NameNotFound, OutputError
from uvms_ocp.meta_values import PhaseMeta
from uvms_ocp.output import staged_folder
from uvms_ocp.record import Record, Recorder
from uvms_ocp.run_meta import RunMeta, write_meta

META = RunMeta(
    scenario="é",
    robot="any",
    joints=("a", "b"),
    phases=(PhaseMeta(name="A"),),
    plant="kinematic",
    solver="none",
    floating=False,
    dt=0.1,
    completed=True,
)


def record(rows: int = 5) -> Record:
    recorder = Recorder(capacity=2)
    for k in range(rows):
        recorder.append({"t": 0.1 * k, "q": np.full(3, k), "phase": k})
    return recorder.freeze(META)


def test_a_recorder_grows_and_keeps_every_row() -> None:
    np.testing.assert_array_equal(record()["q"][:, 0], np.arange(5))
    assert len(record()) == 5


def test_a_record_survives_a_round_trip(tmp_path: Path) -> None:
    record().save(tmp_path / "r.npz")
    loaded = Record.load(tmp_path / "r.npz")
    assert loaded.meta == META
    for name in ("t", "q", "phase"):
        np.testing.assert_array_equal(loaded[name], record()[name])


def test_a_record_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        record()["t"][0] = 1.0


def test_an_unknown_series_is_named_with_the_alternatives() -> None:
    with pytest.raises(NameNotFound, match="unknown series 'qq'; known: phase, q, t"):
        record()["qq"]


def test_a_file_that_is_no_record_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "r.npz"
    path.write_text("no")
    with pytest.raises(InvalidInput, match=r"r\.npz: not a record"):
        Record.load(path)


def test_a_file_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    record().save(tmp_path / "r.npz")
    whole = (tmp_path / "r.npz").read_bytes()
    for n in (0, 10, len(whole) // 2, len(whole) - 30):
        (tmp_path / "r.npz").write_bytes(whole[:n])
        with pytest.raises(InvalidInput, match=r"r\.npz: not a record") as caught:
            Record.load(tmp_path / "r.npz")
        assert "\n" not in str(caught.value)


def test_a_file_without_times_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "r.npz", q=np.zeros(1), __meta__=np.array(write_meta(META)))
    with pytest.raises(InvalidInput, match="no series 't'"):
        Record.load(tmp_path / "r.npz")


def test_metadata_of_another_type_are_refused() -> None:
    with pytest.raises(InvalidInput, match=r"meta = .*; give a RunMeta or a PlanMeta"):
        Record(series={"t": np.zeros(1)}, meta={"scenario": "x"})  # type: ignore[arg-type]


def test_a_run_is_no_plan() -> None:
    assert record().run_meta is META
    with pytest.raises(InvalidInput, match=r"of a run \(é\); give that of a plan"):
        _ = record().plan_meta


def test_a_folder_appears_whole(tmp_path: Path) -> None:
    target = tmp_path / "a" / "b"
    with staged_folder(target) as staging:
        (staging / "figures").mkdir()
        (staging / "figures" / "x.png").write_text("new")
        assert not (target / "figures").exists()
    assert [path.name for path in target.iterdir()] == ["figures"]


def test_an_error_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), staged_folder(tmp_path / "a" / "b") as staging:
        (staging / "half").write_text("x")
        raise RuntimeError
    assert not list(tmp_path.iterdir())


def test_an_error_keeps_earlier_results(tmp_path: Path) -> None:
    (tmp_path / "report.json").write_text("old")
    with pytest.raises(RuntimeError), staged_folder(tmp_path) as staging:
        (staging / "report.json").write_text("new")
        raise RuntimeError
    assert (tmp_path / "report.json").read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1


def test_files_of_an_earlier_result_go_and_others_stay(tmp_path: Path) -> None:
    for name in ("figures/old.png", "figures/mine.png", "plots/old.png", "old.npz", "mine.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("old")
    earlier = ("report.json", "old.npz", "never.npz", "figures/old.png", "plots/old.png")
    with staged_folder(tmp_path, earlier=earlier) as staging:
        (staging / "report.json").write_text("new")
    files = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")}
    assert files == {"report.json", "mine.txt", "figures", "figures/mine.png"}


def test_an_error_removes_nothing(tmp_path: Path) -> None:
    (tmp_path / "old.npz").write_text("old")
    with pytest.raises(RuntimeError), staged_folder(tmp_path, earlier=("old.npz",)):
        raise RuntimeError
    assert [path.name for path in tmp_path.iterdir()] == ["old.npz"]


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write there"), staged_folder(tmp_path / "file" / "out"):
        pass
