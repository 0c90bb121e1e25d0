"""Records survive a round trip without pickle."""

from __future__ import annotations

from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.record import array_file
from uvms_ocp.record.meta_values import PhaseMeta
from uvms_ocp.record.record import Record
from uvms_ocp.record.recorder import Recorder
from uvms_ocp.record.run_meta import RunMeta, write_meta
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial

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
        recorder.append({"t": 0.1 * k, "q": np.full(3, float(k)), "phase": 0})
    return recorder.freeze(META)


def test_a_recorder_grows_and_keeps_every_row() -> None:
    np.testing.assert_array_equal(record()["q"][:, 0], np.arange(5))
    assert len(record()) == 5


ROWS = [
    {
        "t": 0.1 * k,
        "phase": k,
        "q": np.arange(3.0) + k,
        "health": np.full(2, k, dtype=np.int8),
        "table": np.full((2, 2), float(k)),
        "v": np.full(2, -float(k)),
        "late": k > 2,
        "energy": np.float64(k),
    }
    for k in range(7)
]


@pytest.mark.parametrize("capacity", [1, 3, 7, 1024])
def test_every_series_keeps_its_type_its_shape_and_its_place(capacity: int) -> None:
    recorder = Recorder(capacity)
    for row in ROWS:
        recorder.append(row)
    series = recorder.series()
    assert list(series) == list(ROWS[0])
    for name in ROWS[0]:
        expected = np.array([row[name] for row in ROWS])
        np.testing.assert_array_equal(series[name], expected)
        assert series[name].dtype == expected.dtype
        assert name in recorder
        np.testing.assert_array_equal(recorder.last(name), expected[-1])
    assert "other" not in recorder


def test_a_recorder_keeps_what_it_was_given_when_that_is_written_to() -> None:
    recorder = Recorder()
    q = np.zeros(3)
    for k in range(3):
        q[:] = k
        recorder.append({"t": 0.1 * k, "q": q, "v": q})
    series = recorder.series()
    np.testing.assert_array_equal(series["q"][:, 0], [0.0, 1.0, 2.0])
    with pytest.raises(ValueError, match="read-only"):
        series["q"][:] = 7.0
    recorder.append({"t": 0.3, "q": q, "v": q})
    np.testing.assert_array_equal(series["q"][:, 0], [0.0, 1.0, 2.0])


def test_one_number_stands_for_a_whole_column() -> None:
    recorder = Recorder()
    recorder.append({"q": np.zeros(3), "v": np.zeros(2)})
    recorder.append({"q": np.nan, "v": np.ones(1)})
    assert np.isnan(recorder.last("q")).all()
    np.testing.assert_array_equal(recorder.last("v"), [1.0, 1.0])


@pytest.mark.parametrize(
    "misfit", [{"q": np.zeros(2), "v": np.zeros(3)}, {"q": np.zeros(3), "v": np.zeros(3)}]
)
def test_columns_that_only_fit_together_are_refused(misfit: dict[str, np.ndarray]) -> None:
    recorder = Recorder()
    recorder.append({"q": np.zeros(3), "v": np.zeros(2)})
    with pytest.raises(ValueError, match="broadcast"):
        recorder.append(misfit)


@pytest.mark.parametrize(
    "misfit", [{"t": 0.1}, {"t": 0.1, "v": 0.0}, {"t": 0.1, "q": 0.0, "v": 0.0}]
)
def test_a_row_of_other_series_is_refused(misfit: dict[str, float]) -> None:
    recorder = Recorder()
    recorder.append({"t": 0.0, "q": 0.0})
    with pytest.raises(InvalidInput, match=r"row of t.*; give t, q, as in the first one"):
        recorder.append(misfit)
    assert list(recorder.series()["t"]) == [0.0]


def test_a_record_of_a_robot_that_stands_still_is_dense_and_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All that changes are the time and two readings of a clock, as in any run, which keep it from
    looking like a bomb.
    """
    n = 20_000
    clock = np.random.default_rng(0)
    still = Record(
        series={
            "t": 0.005 * np.arange(n),
            "q": np.ones((n, 240)),
            "solve_time": 1e-6 * clock.integers(60, 90, n),
            "tick_time": 1e-6 * clock.integers(90, 140, n),
        },
        meta=META,
    )
    still.save(tmp_path / "r.npz")
    unpacked = sum(array.nbytes for array in still.series.values())
    assert unpacked > 100 * (tmp_path / "r.npz").stat().st_size
    monkeypatch.setattr(array_file, "SMALL", 0)
    assert len(Record.load(tmp_path / "r.npz")) == n


def test_what_packing_makes_hardly_smaller_is_not_packed(tmp_path: Path) -> None:
    n = 2000
    q = np.cumsum(np.random.default_rng(0).normal(size=(n, 7)), axis=0)
    mixed = Record(series={"t": 0.005 * np.arange(n), "q": q, "spare": np.ones((n, 7))}, meta=META)
    mixed.save(tmp_path / "r.npz")
    with ZipFile(tmp_path / "r.npz") as archive:
        packed = {
            member.filename: member.compress_type == ZIP_DEFLATED for member in archive.infolist()
        }
    assert packed == {"__meta__.npy": True, "t.npy": True, "q.npy": False, "spare.npy": True}
    loaded = Record.load(tmp_path / "r.npz")
    for name, array in mixed.series.items():
        np.testing.assert_array_equal(loaded[name], array)


def test_a_record_survives_a_round_trip(tmp_path: Path) -> None:
    record().save(tmp_path / "r.npz")
    loaded = Record.load(tmp_path / "r.npz")
    assert loaded.meta == META
    for name in ("t", "q", "phase"):
        np.testing.assert_array_equal(loaded[name], record()[name])


def test_a_record_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        record()["t"][0] = 1.0


def test_the_newest_row_at_a_time_is_that_of_the_last_tick() -> None:
    run = record()
    assert run.duration == pytest.approx(0.4)
    for time, row in ((0.0, 0), (0.05, 0), (0.1, 1), (0.1 * 3, 3), (0.4, 4)):
        at_time = run.at(time)
        assert at_time.keys() == run.series.keys()
        np.testing.assert_array_equal(at_time["q"], run["q"][row])
    for time in (-0.01, 0.41, 1e30):
        with pytest.raises(InvalidInput, match=r"0 to 0\.4 s"):
            run.at(time)


def test_what_writes_a_file_returns_its_path(tmp_path: Path) -> None:
    for path in (tmp_path / "a.npz", str(tmp_path / "b.npz")):
        written = record().save(path)
        assert written == Path(path)
        assert len(Record.load(written)) == 5


def test_an_unknown_series_is_named_with_the_alternatives() -> None:
    with pytest.raises(NameNotFound, match="unknown series 'qq'; known: phase, q, t"):
        record()["qq"]


def test_the_folder_of_a_commands_results_is_as_good_as_the_record_in_it(tmp_path: Path) -> None:
    record().save(tmp_path / "record.npz")
    np.testing.assert_array_equal(Record.load(tmp_path)["q"], record()["q"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(InvalidInput, match="empty: not a record"):
        Record.load(tmp_path / "empty")


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


def changed(**series: object) -> dict[str, object]:
    """Series of a record of five times, some of them others."""
    good = {
        "t": np.arange(5.0),
        "q": np.zeros((5, 3)),
        "v": np.zeros((5, 2)),
        "phase": np.zeros(5, dtype=int),
    }
    return {**good, **series}


WRONG = {
    "a shorter series": (
        changed(q=np.zeros((4, 3))),
        "series 'q' is float64 of shape (4, 3); allowed: 5 rows of numbers",
    ),
    "one number": (changed(q=np.array(1.0)), "series['q'] = array(1.); give an array of numbers"),
    "words": (changed(x=np.array(["a"] * 5)), "give an array of numbers"),
    "no times": (
        changed(t=np.zeros(0)),
        "times t of shape (0,); allowed: one or more [s], finite, each later",
    ),
    "times in a table": (changed(t=np.zeros((5, 1))), "times t of shape (5, 1)"),
    "whole numbers as times": (changed(t=np.arange(5)), "times t of shape (5,)"),
    "time that stands still": (
        changed(t=np.array([0.0, 1.0, 1.0, 2.0, 3.0])),
        "each later than the one before",
    ),
    "a time that is none": (
        changed(t=np.array([0.0, 1.0, np.nan, 2.0, 3.0])),
        "finite, each later",
    ),
    "an endless time": (changed(t=np.array([0.0, 1.0, 2.0, 3.0, np.inf])), "finite, each later"),
    "a place that is none": (
        changed(q=np.diag([1.0, np.nan, 1.0, 1.0, 1.0])),
        "'q' has NaN or infinity at t = 1 s; record it",
    ),
    "more joints than columns": (
        changed(q=np.zeros((5, 1))),
        "series 'q' has shape (5, 1); its metadata allow 5 rows of 2 or more",
    ),
    "a place that is a number": (
        changed(q=np.zeros(5)),
        "'q' is float64 of shape (5,); allowed: 5 rows of numbers",
    ),
    "activations of no task": (
        changed(activations=np.zeros((5, 3))),
        "'activations' has shape (5, 3); its metadata allow 5 rows of 0",
    ),
    "a phase that there is not": (
        changed(phase=np.full(5, 1)),
        "'phase' counts what the metadata do not have; allowed: whole",
    ),
    "a negative phase": (changed(phase=np.full(5, -1)), "series 'phase' counts"),
    "another width of numbers": (
        changed(v=np.zeros((5, 2), dtype=np.float32)),
        "series 'v' is float32; allowed: float64",
    ),
    "a velocity whose square is endless": (
        changed(v=np.full((5, 2), 1e160)),
        "series 'v' is larger than 1e+30 at t = 0 s",
    ),
    "a command of another robot": (
        changed(command=np.zeros((5, 3))),
        "series 'command' has shape (5, 3); its metadata allow 5 rows of 2",
    ),
    "a place of fewer numbers than axes": (
        changed(v=np.zeros((5, 4))),
        "'q' has shape (5, 3); its metadata allow 5 rows",
    ),
    "a beginning in the middle": (
        changed(t=np.arange(5.0) + 1.0),
        "a run that begins at t = 1 s; allowed: 0 s",
    ),
    "a status without a word": (
        changed(status=np.zeros(5, dtype=int)),
        "series 'status' counts what the metadata do not",
    ),
    "thrust of one column": (
        changed(thrust=np.zeros(5)),
        "series 'thrust' is float64 of shape (5,); allowed: 5 rows",
    ),
    "half a phase": (changed(phase=np.full(5, 0.5)), "series 'phase' counts"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_file_that_breaks_what_a_record_promises_is_refused(case: str, tmp_path: Path) -> None:
    series, message = WRONG[case]
    np.savez(tmp_path / "good.npz", __meta__=np.array(write_meta(META)), **changed())  # type: ignore[arg-type]
    assert len(Record.load(tmp_path / "good.npz")) == 5
    np.savez(tmp_path / "r.npz", __meta__=np.array(write_meta(META)), **series)  # type: ignore[arg-type]
    with pytest.raises(InvalidInput) as caught:
        Record.load(tmp_path / "r.npz")
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"{tmp_path / 'r.npz'}: not a record written by uvms_ocp: ")
    assert "\n" not in str(caught.value)


def test_a_trajectory_in_the_place_of_a_record_is_named_and_the_other_way_round(
    tmp_path: Path,
) -> None:
    curve = PiecewisePolynomial(breaks=np.array([0.0, 1.0]), coefficients=np.zeros((2, 1, 1)))
    curve.to_numpy(tmp_path / "plan.npz")
    record().save(tmp_path / "record.npz")
    np.savez(tmp_path / "nodes.npz", t=np.zeros(1), summary=np.array("{}"))
    for name in ("plan.npz", "nodes.npz"):
        with pytest.raises(
            InvalidInput, match=r"a plan's trajectory; give the record\.npz beside it"
        ):
            Record.load(tmp_path / name)
    with pytest.raises(InvalidInput, match=r"\(a record; give the plan\.npz beside it\)"):
        PiecewisePolynomial.from_numpy(tmp_path / "record.npz")
    with pytest.raises(InvalidInput, match="it holds summary, t; allowed: breaks and coefficients"):
        PiecewisePolynomial.from_numpy(tmp_path / "nodes.npz")


def test_metadata_that_are_no_text_are_refused(tmp_path: Path) -> None:
    for meta in (np.zeros(3), np.array(["a", "b"])):
        np.savez(tmp_path / "r.npz", t=np.zeros(1), __meta__=meta)
        with pytest.raises(InvalidInput, match="allowed: one text"):
            Record.load(tmp_path / "r.npz")


def test_metadata_of_another_type_are_refused() -> None:
    with pytest.raises(InvalidInput, match=r"meta = .*; give a RunMeta or a PlanMeta"):
        Record(series={"t": np.zeros(1)}, meta={"scenario": "x"})  # type: ignore[arg-type]


def test_a_run_is_no_plan() -> None:
    assert record().run_meta is META
    with pytest.raises(InvalidInput, match=r"of a run \(é\); give that of a plan"):
        _ = record().plan_meta
