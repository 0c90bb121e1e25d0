"""Code that uses the package passes a strict type checker, and its mistakes do not."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

pytest.importorskip("mypy", reason='needs pip install "uvms-ocp[dev]"')

SAMPLE = Path(__file__).with_name("own_mission.py")


def _checked(sample: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--strict",
        "--config-file=",
        f"--cache-dir={folder}",
        str(sample),
    ]
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=600, check=False
    )


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("types")


def test_the_sample_is_right(cache: Path) -> None:
    process = _checked(SAMPLE, cache)
    assert process.returncode == 0, process.stdout + process.stderr


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("robot.configuration(", "robot.konfiguration("),
        ('name="go",\n        robot', "name=5,\n        robot"),
        (
            'plot(record, "PC.position_error").savefig',
            'plot(record, "PC.position_error").save_figure',
        ),
    ],
)
def test_mistakes_in_it_are_found(cache: Path, right: str, wrong: str) -> None:
    text = SAMPLE.read_text(encoding="utf-8")
    assert right in text
    sample = cache / "wrong_mission.py"
    sample.write_text(text.replace(right, wrong), encoding="utf-8")
    assert "error:" in _checked(sample, cache).stdout
