"""Pictures and films of a page: what is asked for by the suffix is what is in the file."""

from __future__ import annotations

import asyncio
import subprocess
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import matplotlib.image as mpl_image
import numpy as np
import pytest
from synthetic_record import synthetic_record

from uvms_ocp.errors import InvalidInput, OutputError
from uvms_ocp.robot.robot import Robot
from uvms_ocp.viz import ScenePage, show
from uvms_ocp.viz.scene import pictures

SIZE = (320, 180)
drawn = pytest.mark.skipif(
    bool(pictures.missing_for_films()), reason=pictures.missing_for_films() or "all is there"
)


@pytest.fixture(scope="module")
def page(robot: Robot) -> ScenePage:
    run = synthetic_record(robot)
    first_rows = {name: values[:21] for name, values in run.series.items()}
    return show(replace(run, series=first_rows), robot)


def frames_of(path: Path) -> tuple[int, tuple[int, int]]:
    """Return number of frames of a film, and their width and height [px]."""
    from imageio_ffmpeg import count_frames_and_secs, get_ffmpeg_exe

    command = [get_ffmpeg_exe(), "-i", str(path), "-frames:v", "1", "-c:v", "png"]
    first = subprocess.run([*command, "-f", "image2pipe", "-"], capture_output=True, check=True)
    height, width, *_ = mpl_image.imread(BytesIO(first.stdout)).shape
    return count_frames_and_secs(str(path))[0], (width, height)


@pytest.mark.slow
@drawn
@pytest.mark.parametrize("name", ["run.mp4", "run.gif"])
def test_a_film_holds_the_whole_run_at_its_pictures_per_second(
    name: str, page: ScenePage, tmp_path: Path
) -> None:
    path = page.save(tmp_path / name, fps=5.0, width=320, height=180)
    assert frames_of(path) == (3, SIZE)
    assert [file.name for file in tmp_path.iterdir()] == [name]


@pytest.mark.slow
@drawn
def test_sizes_of_films_are_even_as_players_want_them(page: ScenePage, tmp_path: Path) -> None:
    path = page.save(tmp_path / "run.mp4", fps=5.0, width=321, height=181)
    assert frames_of(path) == (3, SIZE)


@pytest.mark.slow
@drawn
def test_a_picture_is_that_of_its_time_also_where_an_event_loop_runs(
    page: ScenePage, tmp_path: Path
) -> None:
    async def cell(name: str, t: float) -> np.ndarray:
        path = page.save(tmp_path / name, t=t, width=320, height=180)
        return np.asarray(mpl_image.imread(BytesIO(path.read_bytes())))

    first = asyncio.run(cell("first.png", 0.0))
    later = asyncio.run(cell("later.png", 0.4))
    assert first.shape[:2] == SIZE[::-1]
    assert np.abs(first - later).max() > 0.1


@pytest.mark.slow
@drawn
def test_a_posed_robot_is_a_picture_and_no_film(robot: Robot, tmp_path: Path) -> None:
    posed = show(robot)
    assert posed.save(tmp_path / "robot.jpg", width=320, height=180).read_bytes()[:2] == b"\xff\xd8"
    with pytest.raises(InvalidInput, match="nothing moves; give a picture"):
        posed.save(tmp_path / "robot.gif", width=320, height=180)
    with pytest.raises(InvalidInput, match="view = 'tools'; this page has mission"):
        posed.save(tmp_path / "other.png", view="tools")
    assert [file.name for file in tmp_path.iterdir()] == ["robot.jpg"]


@pytest.mark.slow
@drawn
def test_what_ffmpeg_cannot_write_is_told_and_leaves_nothing(
    page: ScenePage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(pictures.FILM_FORMATS, ".gif", ("-c:v", "no_such_codec"))
    with pytest.raises(OutputError, match=r"ffmpeg cannot write \.gif: .*no_such_codec"):
        page.save(tmp_path / "run.gif", fps=5.0, width=320, height=180)
    assert not list(tmp_path.iterdir())


def test_html_needs_nothing(page: ScenePage, tmp_path: Path) -> None:
    assert page.save(tmp_path / "new" / "run.html").read_text(encoding="utf-8") == page.html


@pytest.mark.parametrize("name", ["run", "run.avi", "run.PNG"])
def test_other_suffixes_are_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"has no suffix of \.html, \.png, \.jpg, \.mp4, \.gif"):
        ScenePage(html="").save(tmp_path / name)


@pytest.mark.parametrize("suffix", [".png", ".mp4"])
def test_what_is_missing_is_told(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pictures, "missing", lambda: "no chromium is found")
    monkeypatch.setattr(pictures, "find_spec", lambda name: name)
    with pytest.raises(InvalidInput, match="no chromium"):
        ScenePage(html="").save(tmp_path / f"run{suffix}")
