"""Rows on the disk while a run goes on: the same as in memory, there whatever ends the program,
read in little memory.
"""

from __future__ import annotations

import os
import signal
import sys
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from mmap import mmap
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from tiny_robots import TINY, robot_of, scenario_of

from uvms_ocp.cli import run
from uvms_ocp.cli.show import _file_at
from uvms_ocp.errors import InvalidInput, OutputError
from uvms_ocp.record import array_file, record as records, row_files
from uvms_ocp.record.meta_values import PhaseMeta
from uvms_ocp.record.output import RUNNING
from uvms_ocp.record.record import Record
from uvms_ocp.record.recorder import Recorder
from uvms_ocp.record.row_files import parts
from uvms_ocp.record.run_meta import RunMeta
from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.signals import Command, State
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.types import memory_of
from uvms_ocp.viz.thinning import thinned

WORDS = {"scenario": "é", "robot": "any", "plant": "kinematic", "solver": "none"}
META = RunMeta(
    **WORDS,
    joints=("a",),
    phases=(PhaseMeta(name="A"),),
    floating=False,
    dt=0.1,
    completed=False,
    stopped="cut off",
)
CLOCKS = ("tick_time", "solve_time", "controller_time")


def row(k: int) -> dict[str, object]:
    """Row k of a record, of every type and shape that there is."""
    further_series = {
        "own/table é": np.arange(3.0) + k,
        "codes": np.full(2, k % 3, np.int8),
        "none": np.zeros(0),
        "late": k > 3,
    }
    return {"t": 0.1 * k, "q": np.full(1, float(k)), **further_series}


def filled(recorder: Recorder, rows: int) -> Recorder:
    for k in range(rows):
        recorder.append(row(k))
    return recorder


def require_same(actual: Record, whole: Record, rows: int) -> None:
    assert list(actual.series) == list(whole.series)
    for name in set(whole.series) - set(CLOCKS):
        np.testing.assert_array_equal(actual[name], whole[name][:rows])
        assert actual[name].dtype == whole[name].dtype


@pytest.mark.parametrize("rows", [1, 3, 7, 12])
def test_rows_on_the_disk_are_those_in_memory(rows: int, tmp_path: Path) -> None:
    recorder = filled(Recorder(3, tmp_path / "new" / "rows"), rows)
    whole = filled(Recorder(3), rows).series()
    np.testing.assert_array_equal(recorder.series()["q"][rows // 2], whole["q"][rows // 2])
    recorder.append(row(rows))  # after they were looked at
    written = recorder.freeze(META)
    require_same(written, filled(Recorder(5), rows + 1).freeze(META), rows + 1)
    loaded = Record.load(tmp_path / "new" / "rows")
    require_same(loaded, written, rows + 1)
    assert loaded.meta == META
    for path in (tmp_path / "new" / "rows").glob("*.npy"):
        assert len(np.load(path)) == rows + 1


def test_only_a_run_with_a_folder_is_longer_than_memory() -> None:
    with pytest.raises(
        InvalidInput, match="give a folder for it, or at most 4,000,000 ticks, 20000 s"
    ):
        replace(_tiny(), duration=20_001.0).run()


def test_a_folder_of_rows_is_not_written_over(tmp_path: Path) -> None:
    filled(Recorder(1, tmp_path / "rows"), 2)
    with pytest.raises(
        OutputError, match="rows is there already; give a folder that is not there yet"
    ):
        Recorder(1, tmp_path / "rows")


@pytest.mark.parametrize("rows", [0, 2])
def test_a_folder_without_rows_is_no_record(rows: int, tmp_path: Path) -> None:
    filled(Recorder(3, tmp_path / "rows"), rows)
    with pytest.raises(InvalidInput, match="rows: not a record written by uvms_ocp"):
        Record.load(tmp_path / "rows")


def _tiny() -> Scenario:
    return scenario_of(robot_of(TINY["one wet link"]), "kinematic", duration=4.0)


@pytest.mark.sampled
@pytest.mark.skipif(sys.platform == "win32", reason="processes are not copied")
@pytest.mark.parametrize("seconds", [0.45, 2.9])
def test_a_run_that_is_killed_leaves_all_but_its_last_seconds(
    seconds: float, tmp_path: Path
) -> None:
    folder = tmp_path / "rows"
    scenario = _tiny()
    whole = _tiny().run()

    def kill(t: float, state: State, command: Command) -> None:
        if t >= seconds:
            os.kill(os.getpid(), signal.SIGKILL)

    assert whole["t"][-1] > seconds
    child = os.fork()
    if child == 0:
        scenario.run(observer=kill, folder=folder)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    if seconds < 2.0:
        assert not folder.exists()
        return
    loaded = Record.load(folder)
    assert seconds - 2.0 - scenario.dt <= loaded["t"][-1] <= seconds
    require_same(loaded, whole, len(loaded))
    assert loaded.run_meta.stopped == summarize(loaded)["cause"]["kind"] == "cut off"


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """As on a full disk: what would make a file larger [B] is refused."""
    resource = pytest.importorskip("resource", reason="files of at most a size")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_ends_a_run_and_leaves_what_was_written(tmp_path: Path) -> None:
    recorder = Recorder(10, tmp_path / "rows", lambda: META)
    with (
        files_of_at_most(4096),
        pytest.raises(OutputError, match="make room; what was written before can be read"),
    ):
        filled(recorder, 200)
    loaded = Record.load(tmp_path / "rows")
    assert len(loaded) == 160  # of the largest row, 24 B, as many blocks as fit beside the header
    require_same(loaded, filled(Recorder(), 200).freeze(META), len(loaded))


def test_what_a_run_was_cut_off_with_is_shown_and_kept_by_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = filled(Recorder(3, tmp_path / RUNNING, lambda: META), 9).freeze(META)
    assert _file_at(tmp_path, ("record.npz",), "") == tmp_path / RUNNING
    monkeypatch.setattr(run, "_simulate", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run.run_and_write(_tiny(), tmp_path, Console(quiet=True))
    require_same(Record.load(tmp_path / "cut_off.npz"), whole, 9)
    assert not (tmp_path / RUNNING).exists()


def test_a_run_that_is_refused_leaves_what_was_cut_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = filled(Recorder(3, tmp_path / RUNNING, lambda: META), 9).freeze(META)
    monkeypatch.setattr(Scenario, "check", lambda scenario: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run.run_and_write(_tiny(), tmp_path, Console(quiet=True))
    require_same(Record.load(tmp_path / RUNNING), whole, 9)


def test_rows_that_are_damaged_are_moved_aside_and_the_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    filled(Recorder(3, tmp_path / RUNNING, lambda: META), 9).freeze(META)
    next((tmp_path / RUNNING).glob("*.npy")).write_bytes(b"")
    monkeypatch.setattr(run, "_simulate", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run.run_and_write(_tiny(), tmp_path, Console(quiet=True))
    assert any((tmp_path / RUNNING).with_name("damaged").iterdir())


def test_a_mapped_record_is_saved_over_its_own_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before, the file was cut while its rows were read from it: a bus error, and nothing left."""
    monkeypatch.setattr("uvms_ocp.record.record.SMALL", 100)
    monkeypatch.setattr("uvms_ocp.record.array_file._LARGE", 8)
    whole = filled(Recorder(), 200).freeze(META)
    whole.save(tmp_path / "r.npz")
    mapped = Record.load(tmp_path / "r.npz")
    mapped.save(tmp_path / "r.npz")
    require_same(Record.load(tmp_path / "r.npz"), whole, 200)
    require_same(mapped, whole, 200)


def peak(work: object, *args: object) -> int:
    """[B] of memory that a call takes at most, beyond what there was."""
    tracemalloc.start()
    work(*args)  # type: ignore[operator]
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak_bytes


@pytest.mark.slow
def test_memory_of_a_run_does_not_grow_with_its_length(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(row_files, "_PART", 1 << 18)

    def record(rows: int) -> Record:
        recorder = Recorder(100, tmp_path / f"{rows}", lambda: META)
        for k in range(rows):
            recorder.append(row(k) | {"q": np.zeros(500)})
        recorder.freeze(META)
        return Record.load(tmp_path / f"{rows}")

    record(10)
    peak_of_short, peak_of_long = (peak(record, rows) for rows in (600, 6000))
    assert peak_of_long < 1.2 * peak_of_short
    assert peak_of_long < 0.8 * 6000 * 500 * 8


def test_large_series_are_mapped_and_what_is_damaged_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = filled(Recorder(), 9).freeze(META)
    monkeypatch.setattr(records, "SMALL", 0)
    monkeypatch.setattr(array_file, "_LARGE", 16)
    whole.save(tmp_path / "r.npz")
    loaded = Record.load(tmp_path / "r.npz")
    require_same(loaded, whole, 9)
    assert isinstance(memory_of(loaded["own/table é"]), mmap)
    assert not loaded["q"].flags.writeable
    np.testing.assert_array_equal(np.load(tmp_path / "r.npz")["q"], whole["q"])
    content = (tmp_path / "r.npz").read_bytes()
    place = content.index(whole["q"].tobytes())
    (tmp_path / "r.npz").write_bytes(content[:place] + b"\x01" + content[place + 1 :])
    with pytest.raises(InvalidInput, match="CRC"):
        Record.load(tmp_path / "r.npz")


@pytest.mark.parametrize("rows", [0, 1, 4, 100])
def test_parts_are_all_rows_in_their_order(rows: int) -> None:
    arrays = np.arange(10.0), np.arange(20).reshape(10, 2)
    all_parts = [*parts(*arrays, rows=rows)]
    assert len(all_parts) == (-(-10 // rows) if rows else 1)
    for k, array in enumerate(arrays):
        np.testing.assert_array_equal(np.concatenate([part[k] for part in all_parts]), array)


@pytest.mark.parametrize("rows", [50_000, 50_001, 81_920, 123_457])
def test_what_is_drawn_of_a_long_record_has_its_extremes_and_its_ends(rows: int) -> None:
    rng = np.random.default_rng(rows)
    thrust = rng.standard_normal((rows, 2))
    thrust[rng.random(rows) < 0.1] = np.nan
    series = {
        "t": 0.005 * np.arange(rows),
        "thrust": thrust,
        "q": rng.standard_normal((rows, 1)),
        "late": thrust[:, 0] > 3.0,
    }
    thinned_record = thinned(Record(series=series, meta=META))
    whole = Record(series=series, meta=META)
    assert len(thinned_record) == rows if rows <= 50_000 else len(thinned_record) <= 8192
    assert {len(array) for array in thinned_record.series.values()} == {len(thinned_record)}
    assert [thinned_record["t"][0], thinned_record["t"][-1]] == [whole["t"][0], whole["t"][-1]]
    assert (np.diff(thinned_record["t"]) > 0).all()
    for name in ("thrust", "late"):
        np.testing.assert_array_equal(
            np.fmin.reduce(thinned_record[name]), np.fmin.reduce(whole[name])
        )
        np.testing.assert_array_equal(
            np.fmax.reduce(thinned_record[name]), np.fmax.reduce(whole[name])
        )
    np.testing.assert_array_equal(
        thinned_record["q"], whole["q"][np.searchsorted(whole["t"], thinned_record["t"])]
    )
