"""Pictures and films of a page: drawn by a Chromium without a window, which playwright drives, and
encoded by ffmpeg.
"""

from __future__ import annotations

import base64
import os
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from subprocess import PIPE, Popen
from tempfile import TemporaryDirectory, TemporaryFile
from threading import Event
from typing import IO, TYPE_CHECKING, Any, BinaryIO, TypeVar

import numpy as np

from uvms_ocp.errors import InvalidInput, OutputError, plain_line
from uvms_ocp.progress import SILENT, progress_bar
from uvms_ocp.record.output import as_output_errors, whole_file
from uvms_ocp.types import Array
from uvms_ocp.viz.scene.page import ScenePage
from uvms_ocp.viz.scene.page_server import served

if TYPE_CHECKING:
    from playwright.sync_api import Browser, CDPSession, Page

Result = TypeVar("Result")

CHROMIUM = "UVMS_OCP_CHROMIUM"
"""The variable that says where Chromium is, unless it is found by its name."""
_NAMES = ("chromium", "chromium-browser", "google-chrome")
_DRAWN_BY_THE_PROCESSOR = (
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)
_MOST_FRAMES = 100_000
"""Largest number of pictures of a film."""
_ROUNDING = 1e-9  # of the number of frames
_JPEG_QUALITY = 92
_EVEN_SIZE = "scale=trunc(iw/2)*2:trunc(ih/2)*2"
_OWN_COLOURS = "split[a][b];[a]palettegen[p];[b][p]paletteuse"
PICTURE_FORMATS = (".png", ".jpg")
FILM_FORMATS = {
    ".mp4": (
        *("-c:v", "libx264", "-preset", "veryfast", "-crf", "18", "-pix_fmt", "yuv420p"),
        *("-vf", _EVEN_SIZE, "-movflags", "+faststart"),
    ),
    ".gif": ("-filter_complex", _OWN_COLOURS),
}
"""Options of ffmpeg for each suffix of films."""
_ADVICE = 'run: pip install "uvms-ocp[video]"'


def missing() -> str:
    """Return what to install before pictures can be made; empty where nothing is missing."""
    if find_spec("playwright") is None:
        return f"playwright is not installed; {_ADVICE}"
    if _chromium() is None:
        return (
            f"no {', '.join(_NAMES)} is found; install Chromium, or say where it is by {CHROMIUM}"
        )
    return ""


def missing_for_films() -> str:
    """Return what to install before films can be made; empty where nothing is missing."""
    advice = missing()
    if advice:
        return advice
    if find_spec("imageio_ffmpeg") is None:
        return f"imageio-ffmpeg is not installed; {_ADVICE}"
    try:
        _ffmpeg()
    except RuntimeError:
        return "imageio-ffmpeg has no ffmpeg for this machine; install ffmpeg"
    return ""


def _ffmpeg() -> str:
    from imageio_ffmpeg import get_ffmpeg_exe

    return str(get_ffmpeg_exe())


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


@dataclass(frozen=True, kw_only=True, slots=True)
class Camera:
    """Camera of a picture: its view and size."""

    width: int
    """[px] width of the picture."""
    height: int
    """[px] height of the picture."""
    view: str
    """Name of the camera: ``mission``, ``vehicle`` or ``tool``."""


def write_picture(page: ScenePage, path: Path, *, t: float, camera: Camera) -> None:
    """Write what the page shows at a time t [s] as PNG or JPEG, by the suffix of the path.

    Raises `InvalidInput` without a browser, and for a view that the page does not have.
    """
    image_format = "png" if path.suffix == ".png" else "jpeg"

    def draw(stopped: Event) -> bytes:
        with _sheet(page, camera) as sheet:
            return sheet.picture(t, image_format)

    image = _beside_event_loops(draw)
    with _new_file(path) as file:
        file.write(image)


def write_film(page: ScenePage, path: Path, *, fps: float, camera: Camera) -> None:
    """Write the page's time line as a film in one of `FILM_FORMATS`, by the suffix of the path.

    Raises `InvalidInput` without browser or ffmpeg, and for a page in which nothing moves; `OutputError`
    where the film cannot be written.
    """
    advice = missing_for_films()
    if advice:
        raise InvalidInput(advice)
    with TemporaryDirectory() as folder:
        # ffmpeg tells formats by their suffix, and goes to and fro in some.
        film = Path(folder) / f"film{path.suffix}"

        def draw(stopped: Event) -> None:
            with _sheet(page, camera) as sheet:
                times = _frame_times(sheet.duration, fps)
                if len(times) < 2:
                    raise InvalidInput(f"{path.name}: nothing moves; give a picture: .png")
                with _encoder(film, fps) as encoder:
                    for t in _with_bar(times):
                        encoder.write(sheet.picture(t, "jpeg"))
                        if stopped.is_set():
                            break

        _beside_event_loops(draw)
        with _new_file(path) as file, film.open("rb") as encoded:
            shutil.copyfileobj(encoded, file)


@contextmanager
def _new_file(path: Path) -> Iterator[BinaryIO]:
    """Yield an empty file that takes the place of `path`, whose folder is made."""
    with as_output_errors(path, "choose another place"):
        path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as file:
        yield file


def _frame_times(duration: float, fps: float) -> Array:
    """Return the times (n,) [s] of all frames. Raises `InvalidInput` for too many."""
    if duration * fps > _MOST_FRAMES:
        raise InvalidInput(
            f"fps = {fps:g} for {duration:g} s; give fewer than {_MOST_FRAMES} pictures"
        )
    n_steps = int(duration * fps + _ROUNDING)
    return np.arange(n_steps + 1) / fps


def _with_bar(times: Array) -> Iterator[float]:
    """Yield times [s], and tell how far they are."""
    with progress_bar(total=len(times), desc="frames", delay=SILENT) as bar:
        for t in times.tolist():
            yield t
            bar.update(1)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Sheet:
    """A page that is open in a browser."""

    page: Page
    chromium: CDPSession

    @property
    def duration(self) -> float:
        """Duration [s] of the time line."""
        return float(self.page.evaluate("DETAILS.duration"))

    def picture(self, t: float, image_format: str) -> bytes:
        """Return the picture of a time [s], as PNG or JPEG."""
        self.page.evaluate("(t) => drawnAt(t)", float(t))
        options: dict[str, Any] = {"format": image_format, "optimizeForSpeed": True}
        if image_format == "jpeg":
            options["quality"] = _JPEG_QUALITY
        answer = self.chromium.send("Page.captureScreenshot", options)
        return base64.b64decode(answer["data"])


@contextmanager
def _sheet(page: ScenePage, camera: Camera) -> Iterator[_Sheet]:
    with browser() as chromium, served(page) as address:
        sheet = chromium.new_page(viewport={"width": camera.width, "height": camera.height})
        sheet.goto(f"{address}#t=0&view={camera.view}&film")
        views = sheet.evaluate("DETAILS.views") or [sheet.evaluate("DETAILS.start_view")]
        if camera.view not in views:
            raise InvalidInput(f"view = {camera.view!r}; this page has {', '.join(views)}")
        yield _Sheet(page=sheet, chromium=sheet.context.new_cdp_session(sheet))


@contextmanager
def _encoder(path: Path, fps: float) -> Iterator[IO[bytes]]:
    """Yield what takes JPEG pictures, one after the other, and makes a film of them."""
    command = [_ffmpeg(), "-loglevel", "error", "-y", "-f", "image2pipe"]
    command += ["-framerate", f"{fps:g}", "-c:v", "mjpeg", "-i", "-"]
    command += [*FILM_FORMATS[path.suffix], str(path)]
    with TemporaryFile() as messages:
        with Popen(command, stdin=PIPE, stderr=messages) as process:
            assert process.stdin is not None
            try:
                try:
                    yield process.stdin
                finally:
                    with suppress(BrokenPipeError):
                        process.stdin.close()
            except BrokenPipeError:  # ffmpeg has ended, and has said why
                pass
            except BaseException:
                process.kill()
                raise
        messages.seek(0)
        said = messages.read().decode(errors="replace")
    if process.returncode != 0:
        raise OutputError(f"ffmpeg cannot write {path.suffix}: {plain_line(said, 200)}")


def _beside_event_loops(draw: Callable[[Event], Result]) -> Result:
    """Call it in a thread of its own: playwright refuses one with an event loop, such as that of a
    notebook's cells. The event is set by Ctrl-C.
    """
    stopped = Event()
    with ThreadPoolExecutor(max_workers=1) as executor:
        result = executor.submit(draw, stopped)
        try:
            return result.result()
        except KeyboardInterrupt:
            stopped.set()
            raise
