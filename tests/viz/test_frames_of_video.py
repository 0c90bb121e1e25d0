"""Frames of a video: pictures of the run, one after the other."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from pathlib import Path

import matplotlib.image as mpl_image
import numpy as np
import pytest
from synthetic_record import synthetic_record

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.robot import Robot
from uvms_ocp.viz import ScenePage, show
from uvms_ocp.viz.scene import pictures
from uvms_ocp.viz.scene.pictures import write_frames

pytestmark = pytest.mark.slow


@pytest.mark.skipif(bool(pictures.missing()), reason=pictures.missing() or "all is there")
def test_frames_of_a_video_are_pictures_of_the_run_without_controls(
    robot: Robot, tmp_path: Path
) -> None:
    short = replace(
        run := synthetic_record(robot),
        series={name: values[:21] for name, values in run.series.items()},
    )
    paths = write_frames(show(short, robot), tmp_path / "film", fps=5, width=320, height=180)
    assert [path.name for path in paths] == ["00000.png", "00001.png", "00002.png"]
    pictures = [mpl_image.imread(BytesIO(path.read_bytes())) for path in paths]
    assert {picture.shape[:2] for picture in pictures} == {(180, 320)}
    assert np.abs(pictures[0] - pictures[2]).max() > 0.1


def test_what_is_missing_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "missing", lambda: "no chromium is found")
    with pytest.raises(InvalidInput, match="no chromium"):
        write_frames(ScenePage(html=""), tmp_path)
