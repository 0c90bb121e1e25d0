"""The command `show`: a run, a plan or a robot as a page, in a file or for the browsers of this
machine.
"""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from http.client import HTTPConnection
from pathlib import Path

import numpy as np
import pytest
from command_line import called

from uvms_ocp.record.meta_values import PhaseMeta
from uvms_ocp.record.record import Record
from uvms_ocp.record.run_meta import RunMeta
from uvms_ocp.robot.loading import load_robot, robot_folder

COMMAND = (sys.executable, "-m", "uvms_ocp", "show")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run of two rows."""
    folder = tmp_path_factory.mktemp("runs") / "swing"
    folder.mkdir()
    robot = load_robot("planar5")
    meta = RunMeta(
        scenario="swing",
        robot=robot.name,
        joints=robot.joint_names,
        phases=(PhaseMeta(name="A"),),
        plant="kinematic",
        solver="none",
        floating=False,
        dt=1.0,
        completed=True,
    )
    q = np.array([robot.home, robot.home + 0.1])
    Record(series={"t": np.arange(2.0), "q": q, "v": np.zeros((2, robot.n_v))}, meta=meta).save(
        folder / "record.npz"
    )
    return folder


def show(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return called("show", *arguments, cwd=Path())


def legend(page: Path) -> list[str]:
    details = re.search(r'id="details">(.*?)</script', page.read_text(encoding="utf-8"))
    assert details is not None
    return [row["label"] for row in json.loads(details[1])["legend"]]


def test_a_run_and_its_ghost_are_written_as_one_page(run: Path, tmp_path: Path) -> None:
    page = tmp_path / ("a_path_that_is_wider_than_a_terminal_" * 3) / "scene.html"
    process = show(run, "--ghost", run / "record.npz", "--out", page)
    assert process.returncode == 0, process.stderr
    assert process.stdout.splitlines() == [str(page)]
    assert "swing" in legend(page)


def test_a_robot_is_shown_by_its_name(tmp_path: Path) -> None:
    process = show("planar5", "--out", tmp_path / "robot.html")
    assert process.returncode == 0, process.stderr
    assert "planar5" in (tmp_path / "robot.html").read_text(encoding="utf-8")


def test_a_robot_is_shown_by_its_folder_and_shows_its_runs(run: Path, tmp_path: Path) -> None:
    folder = robot_folder("planar5")
    for k, words in enumerate(((folder,), (run, "--robot", folder))):
        process = show(*words, "--out", tmp_path / f"{k}.html")
        assert process.returncode == 0, process.stderr
        assert "planar5" in (tmp_path / f"{k}.html").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nowhere",), "nowhere"),
        ((".",), "holds no record.npz or plan.npz or plan.json"),
        (("RUN", "--hydrodynamics", "water.yaml"), "without a robot; give both, --robot"),
        (("RUN", "--ghost", "RUN", "--ghost", "RUN"), "two ghosts of one name"),
        (("RUN", "--robot", "bluerov2_alpha5"), "give its own robot"),
        (("RUN", "--port", "-1", "--no-browser"), "give another"),
    ],
)
def test_what_cannot_be_shown_is_told_in_one_line(
    run: Path, arguments: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    words = (str(run) if word == "RUN" else word for word in arguments)
    process = called("show", *words, cwd=tmp_path)
    assert process.returncode == 2
    assert message in process.stderr
    assert process.stderr.count("\n") == 1


def test_a_page_is_served_until_it_is_stopped(run: Path) -> None:
    with subprocess.Popen(
        [*COMMAND, str(run), "--no-browser"], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        address = re.match(r"http://127\.0\.0\.1:(\d+)/", process.stdout.readline())
        assert address is not None
        connection = HTTPConnection("127.0.0.1", int(address[1]), timeout=30)
        connection.request("GET", "/")
        assert b"swing" in connection.getresponse().read()
        connection.close()
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30) == 0
