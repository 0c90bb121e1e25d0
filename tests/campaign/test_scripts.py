"""Scripts that start processes: each of those reads the script once more."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import uvms_ocp as uo
from uvms_ocp.campaign import Campaign

def make():
    return uo.scenarios.reach(plant="kinematic", duration=0.1)

Campaign(scenario=make, variations=(), runs=2).run("runs", workers=2)
"""


@pytest.mark.slow
def test_a_script_that_calls_without_a_guard_is_told_of_it(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="install uvms-ocp[campaign]")
    (tmp_path / "study.py").write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, "study.py"], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 1
    told = (
        "Campaign.run: its processes read the script again; put the call below if __name__ =="
        ' "__main__":'
    )
    assert told in done.stderr.splitlines()
    assert done.stderr.count("Traceback") == 1
