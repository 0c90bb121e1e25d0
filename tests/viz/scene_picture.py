"""The picture of a scene that tests compare with: ``python tests/viz/scene_picture.py`` takes it
anew; look at it.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib.image as mpl_image
import numpy as np
from synthetic_record import SURROUNDINGS, synthetic_record

from uvms_ocp.record.meta_values import ObstacleMeta
from uvms_ocp.record.record import Record
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.viz import show
from uvms_ocp.viz.scene.page_server import served
from uvms_ocp.viz.scene.pictures import browser

EXPECTED = Path(__file__).with_name("scene_picture.png")
SIZE = (960, 540)
"""[px]"""
_BLOCK = 20  # [px] averaged into one, which takes out fonts and jagged edges
_BOULDER = ObstacleMeta(name="boulder", shape="sphere", size=(0.4,), position=(2.4, 1.8, -37.0))


def record_to_look_at(robot: Robot) -> Record:
    """With all that a scene can draw."""
    record = synthetic_record(
        robot, surroundings=SURROUNDINGS.model_copy(update={"obstacles": (_BOULDER,)})
    )
    n = len(record)
    pressing = np.outer(np.linspace(0.0, 40.0, n), [1.0, 0.8, 0.6, 0.4])
    return Record(
        series={**record.series, "current": np.tile([0.3, 0.1, 0.0], (n, 1)), "contact": pressing},
        meta=record.meta,
    )


def at(page: Any, t: float) -> np.ndarray:
    """The picture (height, width, 3) of an open page at t [s]."""
    page.evaluate("setPlaying(false)")
    page.evaluate(
        "(t) => new Promise((done) => { showTime(t); requestAnimationFrame(() =>"
        " requestAnimationFrame(done)); })",
        t,
    )
    picture: np.ndarray = mpl_image.imread(BytesIO(page.screenshot()))[..., :3]
    return picture


def coarse(picture: np.ndarray) -> np.ndarray:
    """The mean colour of every block of the picture (height, width, 3)."""
    height, width = (n // _BLOCK for n in picture.shape[:2])
    blocks: np.ndarray = picture[: height * _BLOCK, : width * _BLOCK].reshape(
        height, _BLOCK, width, _BLOCK, 3
    )
    means: np.ndarray = blocks.mean(axis=(1, 3))
    return means


def main() -> None:
    robot = load_robot("girona_maris7")
    with browser() as chromium, served(show(record_to_look_at(robot), robot)) as address:
        page = chromium.new_page(viewport=dict(zip(("width", "height"), SIZE, strict=True)))
        page.goto(f"{address}#t=0")
        picture = at(page, 3.0)
    mpl_image.imsave("scene.png", picture)
    mpl_image.imsave(EXPECTED, coarse(picture))
    print(f"{EXPECTED} from scene.png, which is there to look at")


if __name__ == "__main__":
    main()
