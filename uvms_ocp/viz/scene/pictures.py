"""Pictures of a page, such as the frames of a video: drawn by a Chromium without a window, which
playwright drives.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.output import as_output_errors
from uvms_ocp.types import AtLeastOne, Positive
from uvms_ocp.viz.scene.page import ScenePage
from uvms_ocp.viz.scene.page_server import served

if TYPE_CHECKING:
    from playwright.sync_api import Browser

CHROMIUM = "UVMS_OCP_CHROMIUM"
"""The variable that says where Chromium is, unless it is found by its name."""
_NAMES = ("chromium", "chromium-browser", "google-chrome")
_DRAWN_BY_THE_PROCESSOR = (
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)
_MOST_FRAMES = 100_000
"""Pictures of a video at most."""


def missing() -> str:
    """Return what to install before pictures can be made; empty where nothing is missing."""
    try:
        import playwright.sync_api  # noqa: F401 - only whether it is there
    except ImportError:
        return 'playwright is not installed; run: pip install "uvms-ocp[video]"'
    if _chromium() is None:
        return (
            f"no {', '.join(_NAMES)} is found; install Chromium, or say where it is by {CHROMIUM}"
        )
    return ""


def _chromium() -> str | None:
    return os.environ.get(CHROMIUM) or next(filter(None, map(shutil.which, _NAMES)), None)


@contextmanager
def browser() -> Iterator[Browser]:
    """Yield a Chromium without a window. Raises `InvalidInput` with what is missing."""
    advice = missing()
    if advice:
        raise InvalidInput(advice)
    from playwright.sync_api import sync_playwright

    flags = [
        *_DRAWN_BY_THE_PROCESSOR,
        *(["--no-sandbox"] if os.geteuid() == 0 else []),
    ]  # root has no sandbox
    with sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=_chromium(), args=flags)
        try:
            yield chromium
        finally:
            chromium.close()


@checked
def write_frames(
    page: ScenePage,
    folder: Path | str,
    *,
    fps: Positive = 25.0,
    width: AtLeastOne = 1280,
    height: AtLeastOne = 720,
    view: str = "mission",
) -> tuple[Path, ...]:
    """Write what the page shows as ``00000.png``, ``00001.png`` and so on; returns their paths.

    fps [Hz]: pictures per second of the run. width, height [px]. view: the camera, ``mission``,
    ``vehicle`` or ``tool``. A video from them: ``ffmpeg -framerate 25 -i %05d.png -pix_fmt yuv420p
    video.mp4``. Raises `InvalidInput` where playwright or Chromium is missing, or the run is too
    long for so many pictures, and `OutputError` where the folder cannot be written.
    """
    folder = Path(folder)
    with browser() as chromium, served(page) as address:
        sheet = chromium.new_page(viewport={"width": width, "height": height})
        sheet.goto(f"{address}#t=0&view={view}&film")
        duration = float(sheet.evaluate("DETAILS.duration"))
        if duration * fps > _MOST_FRAMES:
            raise InvalidInput(
                f"fps = {fps:g} for {duration:g} s; give fewer than {_MOST_FRAMES} pictures"
            )
        with as_output_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            paths = [folder / f"{k:05d}.png" for k in range(int(duration * fps) + 1)]
            for k, path in enumerate(paths):
                sheet.evaluate("(t) => drawnAt(t)", k / fps)
                sheet.screenshot(path=path)
            return tuple(paths)
