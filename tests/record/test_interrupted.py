"""Killed, or refused by the disk, at any of its file operations, a command leaves all of the old
files or all of the new.
"""

from __future__ import annotations

import json
import subprocess
import sys
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest

SCRIPT = Path(__file__).with_name("interrupted.py")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="kills by signal")


def answer(experiment: str, folder: Path) -> Any:
    command = [sys.executable, str(SCRIPT), experiment, str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1])


def in_turn(states: list[str]) -> list[str]:
    """The states, each once where it lasts."""
    return [state for state, _ in groupby(states)]


@pytest.mark.slow
def test_a_kill_at_any_operation_and_at_any_of_the_recovery_leaves_all_old_files_or_all_new_ones(
    tmp_path: Path,
) -> None:
    states = answer("killed", tmp_path)
    assert len(states["found"]) > 50
    assert in_turn(states["found"]) == ["old", "new"]
    assert set(states["again"]) == {"old", "new"}


@pytest.mark.slow
def test_so_does_one_at_any_operation_of_run_plan_and_export(tmp_path: Path) -> None:
    for name, command in answer("commands", tmp_path).items():
        assert len(command["found"]) > 40, name
        # The record of a run or a plan is safe before its figures are drawn.
        assert in_turn(command["found"]) == [
            "old",
            *(["record"] if name != "export" else []),
            "new",
        ], name
        assert command["killed"], name
        assert command["is_mixed"], name
        assert command["left"] == command["files"], name
        assert command["as_in_manifest"], name


@pytest.mark.slow
@pytest.mark.parametrize("experiment", ["refused", "full"])
def test_an_operation_that_the_disk_refuses_changes_nothing_and_is_one_line(
    experiment: str, tmp_path: Path
) -> None:
    """Once, or from then on; without the help of another command."""
    for k, (state, recovered, message) in enumerate(answer(experiment, tmp_path), 1):
        assert state == recovered == ("old" if message else "new"), (k, state, recovered, message)
        if message:
            assert "No space left on device); choose another folder" in message
            assert "\n" not in message
