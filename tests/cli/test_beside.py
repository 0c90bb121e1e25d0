"""Jobs that are shared with a second process are all done, once, and what goes wrong in them is
told.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from functools import partial
from multiprocessing import active_children
from pathlib import Path
from pickle import dumps
from time import perf_counter, sleep

import numpy as np
import pytest

from uvms_ocp.cli.drawing import Job, drawer, drawings_of
from uvms_ocp.record.record import Record
from uvms_ocp.scenario.cases import reach


def _note(folder: Path, k: int) -> None:
    (folder / f"{k}").write_text(str(os.getpid()))


_COPIED = pytest.mark.skipif(sys.platform != "linux", reason="no copy is made there")


def _notes(folder: Path, n: int) -> dict[str, Job]:
    return {f"{k}": partial(_note, folder, k) for k in range(n)}


def test_commands_know_the_names_of_figures_before_anything_that_draws_is_loaded() -> None:
    code = (
        "import sys, uvms_ocp.cli.plan; print(sorted({'matplotlib', 'meshcat', 'scipy'} &"
        " set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.sampled
@pytest.mark.parametrize("module", ["plan", "run"])
def test_commands_load_no_missions_before_they_are_asked_for_one(module: str) -> None:
    """Plans among obstacles need none, and missions of one's own none of those that come with the
    package.
    """
    code = f"import sys, uvms_ocp.cli.{module}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    parts = {name.split(".")[1] for name in done.stdout.split() if name.startswith("uvms_ocp.")}
    assert not {"scenario", "mission_plan", "control", "estimation"} & parts


@pytest.mark.parametrize("n_processors", [1, 2])
def test_every_drawing_is_made_in_a_copy_where_there_are_processors_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, n_processors: int
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: n_processors)
    with drawer() as draw:
        assert draw(_notes(tmp_path, 20)) == []
    assert {int(path.name) for path in tmp_path.iterdir()} == set(range(20))
    drawn_in_this_process = os.getpid() in {int(path.read_text()) for path in tmp_path.iterdir()}
    assert drawn_in_this_process == (n_processors == 1 or sys.platform != "linux")


@_COPIED
def test_two_processes_work_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    with drawer() as draw:  # neither ends before the other has begun
        draw({f"{k}": partial(_note_and_wait, tmp_path, k) for k in range(2)})
    assert (tmp_path / "0").read_text() != (tmp_path / "1").read_text()


def _note_and_wait(folder: Path, k: int) -> None:
    _note(folder, k)
    while not (folder / f"{1 - k}").exists():
        pass


@_COPIED
def test_what_draws_is_loaded_once_by_what_all_copies_are_made_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    with drawer() as draw:
        (first,) = active_children()
        draw({f"{k}": partial(_note_parent, tmp_path, k) for k in range(20)})
    assert {path.read_text() for path in tmp_path.iterdir()} == {f"{first.pid} True"}


def _note_parent(folder: Path, k: int) -> None:
    (folder / f"{k}").write_text(f"{os.getppid()} {'matplotlib' in sys.modules}")


@pytest.mark.parametrize("n_processors", [1, 2])
def test_what_the_disk_refuses_is_raised(
    monkeypatch: pytest.MonkeyPatch, n_processors: int
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: n_processors)
    with drawer() as draw, pytest.raises(OSError, match="no room"):
        draw({"own": _no_room})


def _no_room() -> None:
    raise OSError("no room")


@_COPIED
@pytest.mark.parametrize("begun", [False, True])
def test_a_copy_that_is_killed_leaves_nothing_undrawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, begun: bool
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    before = active_children()
    with drawer() as draw:
        for copy in () if begun else set(active_children()).difference(before):
            copy.kill()
        assert draw({"own": partial(_die_elsewhere, os.getpid()), **_notes(tmp_path, 5)}) == []
    assert {
        int(path.name): int(path.read_text()) for path in tmp_path.glob("[0-9]")
    } == dict.fromkeys(range(5), os.getpid())


def _die_elsewhere(here: int) -> None:
    if os.getpid() != here:
        os.kill(os.getpid(), signal.SIGKILL)


@_COPIED
def test_what_cannot_be_sent_is_drawn_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    with drawer() as draw:
        assert draw({"own": lambda: _note(tmp_path, 0)}) == []
    assert (tmp_path / "0").read_text() == str(os.getpid())


@_COPIED
def test_what_ends_before_anything_is_drawn_waits_for_no_copy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    monkeypatch.setattr("uvms_ocp.cli.drawing._load_drawing", _load_for_ever)
    before = active_children()
    begin = perf_counter()
    with pytest.raises(ValueError, match="wrong"), drawer():
        raise ValueError("wrong")
    assert perf_counter() - begin < 10.0
    assert set(active_children()) <= set(before)


@_COPIED
def test_a_long_record_is_not_sent_to_what_draws_it(tmp_path: Path) -> None:
    scenario = reach(plant="kinematic", duration=0.5)
    short = scenario.run()
    robot = scenario.robot
    series = {name: np.repeat(short[name], 500, axis=0) for name in short.series}
    record = Record(series=series | {"t": np.arange(len(series["t"])) * 0.01}, meta=short.meta)
    whole = sum(values.nbytes for values in record.series.values())
    assert len(dumps(drawings_of(record, robot, tmp_path, ("scene",))["scene.html"])) > whole
    record.save(tmp_path / "record.npz")
    for job in drawings_of(record, robot, tmp_path, ("scene", "joints")).values():
        assert len(dumps(job)) < whole / 4


def test_a_command_that_is_killed_leaves_no_copies(tmp_path: Path) -> None:
    code = f"""
import os, time
from functools import partial
from multiprocessing import active_children
from pathlib import Path
from uvms_ocp.cli.drawing import drawer

def wait(k):
    Path({str(tmp_path)!r}, str(k)).write_text(str(os.getpid()))
    time.sleep(600.0)

os.cpu_count = lambda: 2
with drawer() as draw:
    print(*(child.pid for child in active_children()), flush=True)
    draw({{str(k): partial(wait, k) for k in range(2)}})
"""
    ends = perf_counter() + 60.0
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True
    ) as command:
        assert command.stdout is not None
        copies = [int(word) for word in command.stdout.readline().split()]
        while len(written := [path.read_text() for path in tmp_path.iterdir()]) < 2 or not all(
            written
        ):
            assert perf_counter() < ends
            sleep(0.05)
        command.kill()
    copies += map(int, written)
    assert len(set(copies)) == 3
    while any(map(_lives, copies)) and perf_counter() < ends:
        sleep(0.05)
    assert not any(map(_lives, copies))


def _lives(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def _load_for_ever(parent: int) -> None:
    signal.pause()
