"""Jobs that are shared with a second process are all done, once, and what goes wrong in them is told."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from uvms_ocp.cli.run import run_jobs


def _note(folder: Path, k: int) -> None:
    (folder / f"{k}").write_text(str(os.getpid()))


def _wait_for(path: Path) -> None:
    while not path.exists():
        pass


@pytest.mark.parametrize("n_processors", [1, 2])
def test_every_job_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, n_processors: int) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: n_processors)
    run_jobs([partial(_note, tmp_path, k) for k in range(20)])
    assert {int(path.name) for path in tmp_path.iterdir()} == set(range(20))


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="no copy is made there")
def test_two_processes_work_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    one, two = tmp_path / "0", tmp_path / "1"

    def first() -> None:
        _note(tmp_path, 0)
        _wait_for(two)

    def second() -> None:
        _note(tmp_path, 1)
        _wait_for(one)

    run_jobs([first, second])  # neither ends before the other has begun
    assert one.read_text() != two.read_text()


@pytest.mark.parametrize("n_processors", [1, 2])
def test_what_a_job_raises_is_raised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, n_processors: int) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: n_processors)

    def wrong() -> None:
        raise OSError("no room")

    jobs: list[Callable[[], None]] = [wrong, *(partial(_note, tmp_path, k) for k in range(5))]
    with pytest.raises(OSError, match="no room"):
        run_jobs(jobs)


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="no copy is made there")
def test_a_copy_that_is_killed_leaves_nothing_undone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    here, taken = os.getpid(), tmp_path / "taken"

    def die_elsewhere() -> None:
        if os.getpid() != here:
            taken.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        _wait_for(taken)

    run_jobs([die_elsewhere] * 2 + [partial(_note, tmp_path, k) for k in range(5)])
    assert {int(path.name): int(path.read_text()) for path in tmp_path.glob("[0-9]")} == dict.fromkeys(range(5), here)
