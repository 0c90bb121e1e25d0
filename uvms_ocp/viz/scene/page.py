"""HTML page of a meshcat scene without its server; served on the loopback address, or drawn as
pictures by Chromium.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import os
import re
import shutil
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path
from threading import BoundedSemaphore, Thread
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np
import umsgpack  # type: ignore[import-untyped]

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.errors import InvalidInput, OutputError, plain_line
from uvms_ocp.record.output import as_output_errors
from uvms_ocp.types import AtLeastOne, Positive

if TYPE_CHECKING:
    from playwright.sync_api import Browser

# The parts of meshcat that scenes use, imported without the deprecation warning that its unused
# server raises.

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    from meshcat import geometry as geometry, viewer_assets_path as viewer_assets_path
    from meshcat.animation import (
        Animation as Animation,
        AnimationClip as AnimationClip,
        AnimationTrack as AnimationTrack,
    )
    from meshcat.commands import SetAnimation as SetAnimation
    from meshcat.path import Path as ScenePath
    from meshcat.visualizer import Visualizer as Visualizer

_VIEWER_MARK = "<!--viewer-->"
"""Comment before and after the viewer's script, which all pages share."""
_WITHOUT_SCRIPTS = (
    "A scene is drawn here by scripts, which this notebook may not run: trust it, or run this cell."
)
"""Text inside the frame, which a notebook shows that takes frames out of outputs it does not
trust.
"""
_shown = dict[str, str]()
"""Cells of this kernel's notebook that showed a scene, and by which message they were run then."""

_FROM_THE_SIDE = (0.5, -1.0, 0.45)

_SCRIPTS = ("stage", "camera", "legend", "time", "arrows", "joints", "drag", "live", "main")
"""One after the other: the page's script."""
_MARK = re.compile("__([A-Z]+)__")

_HOST = "127.0.0.1"
_MOST_CONNECTIONS = 32
_PATIENCE = 10.0  # [s] with a browser that neither asks nor takes what it asked for
FRAMES = "/frames"
"""The path at which a live page hears of frames, as server-sent events."""

CHROMIUM = "UVMS_OCP_CHROMIUM"
"""The variable that says where Chromium is, unless it is found by its name."""
_NAMES = ("chromium", "chromium-browser", "google-chrome")
_DRAWN_BY_THE_PROCESSOR = (
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)
_MOST_FRAMES = 100_000


# A meshcat scene without meshcat's server: commands are collected here and packed into one HTML
# page.


@dataclass(kw_only=True, slots=True)
class CommandLog:
    """Stands in for meshcat's window: keeps every command instead of sending it to a server."""

    blobs: list[bytes] = field(default_factory=list)

    def send(self, command: Any) -> None:
        """Take a command as meshcat's `Visualizer` sends it; 32-bit floats halve the page."""
        self.blobs.append(umsgpack.packb(command.lower(), force_float_precision="single"))

    def visualizer(self) -> Visualizer:
        """Return a meshcat visualizer that writes into this log."""
        return Visualizer(window=self)

    def animate(self, clips: Mapping[ScenePath, Any]) -> None:
        """Load one clip per path; the page starts and drives them."""
        self.send(SetAnimation(Animation(clips=dict(clips)), play=False))


@checked_dataclass()
class ScenePage:
    """A finished page: write it to a file, or show it as the last value of a notebook cell."""

    html: str = field(repr=False)
    height: AtLeastOne = 520
    """Height in a notebook [px]."""
    still: str = field(default="", repr=False)
    """An image, as HTML, for where scripts do not run."""

    def write(self, path: Path | str) -> Path:
        """Write the page. Raises `OutputError` where `path` cannot be written."""
        path = Path(path)
        with as_output_errors(path, "choose another place"):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(self.html, encoding="utf-8")
        return path

    def _repr_html_(self) -> str:
        return self.framed(f"scene-{uuid4().hex}")

    def framed(self, name: str) -> str:
        """Return an iframe of that id with the page; a viewer that the notebook holds already is
        copied in by a script.
        """
        head, _, after_head = self.html.partition(_VIEWER_MARK)
        viewer, _, tail = after_head.partition(_VIEWER_MARK)
        with_viewer = not _viewer_in_notebook()
        style = f"width:100%;height:{self.height:d}px;border:none"
        if with_viewer:
            page = f'srcdoc="{html.escape(self.html)}"'
            script = ""
        else:
            page = f'data-page="{html.escape(head + _VIEWER_MARK + tail)}"'
            script = f"<script>{asset('frame.js')}('{name}')</script>"
        opening = (
            f'<iframe id="{name}" data-viewer="{_digest(viewer)}" sandbox="allow-scripts"'
            f' style="{style}" {page}>'
        )
        return f"{script}{opening}{self.still}{_WITHOUT_SCRIPTS}</iframe>"


def _viewer_in_notebook() -> bool:
    """Check whether another cell's output holds the viewer: one that is run again has lost its own,
    and perhaps the viewer.
    """
    kernel: Any = getattr(
        getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)(), "kernel", None
    )
    if (
        not hasattr(kernel, "get_parent") or "google.colab" in sys.modules
    ):  # where each cell is a page of its own
        return False
    request = kernel.get_parent()
    cell = request.get("metadata", {}).get("cellId") or request.get("content", {}).get("code", "")
    message = request.get("header", {}).get("msg_id", "")
    is_held = bool(_shown)
    former_message = _shown.get(cell, message)
    _shown[cell] = message
    return is_held and former_message == message


def build_page(
    log: CommandLog,
    *,
    title: str,
    details: Mapping[str, Any],
    height: int = 520,
    live: bool = False,
    lines: Sequence[np.ndarray] = (),
) -> ScenePage:
    """Fill the page template with meshcat's viewer, the commands and `details` (JSON values) for
    the page's script.

    The page's policy lets the viewer and the page's script run, by their hashes, and nothing else,
    and loads nothing; a live one hears from whoever serves it. lines (n, 3) [m]: the robot, for
    where scripts do not run.
    """
    details = {"direction": _FROM_THE_SIDE, "close_direction": _FROM_THE_SIDE, **details}
    scripts = {
        "VIEWER": _viewer_source(),
        "SCRIPT": "".join(asset(f"{name}.js") for name in _SCRIPTS),
    }
    parts = {
        **scripts,
        "POLICY": _policy(scripts.values()) + ("; connect-src 'self'" if live else ""),
        "TITLE": html.escape(plain_line(title)),
        "STYLE": asset("page.css"),
        "DETAILS": _data_block(details),
        "COMMANDS": _data_block([base64.b64encode(blob).decode("ascii") for blob in log.blobs]),
    }
    # In one pass, so that no text that is filled in is looked through for marks.
    page = _MARK.sub(lambda mark: parts[mark[1]], asset("page.html"))
    return ScenePage(
        html=page, height=height, still=_still(lines, details["direction"]) if lines else ""
    )


def _still(lines: Sequence[np.ndarray], direction: Sequence[float]) -> str:
    """Draw lines (n, 3) [m], as they are seen from a direction."""
    x, y, z = direction
    right = np.array([-y, x, 0.0])
    up = np.array([-x * z, -y * z, x * x + y * y])
    plane = np.stack([right / np.linalg.norm(right), up / -np.linalg.norm(up)], axis=1)
    projected = [line @ plane for line in lines]
    (x_min, y_min) = np.vstack(projected).min(axis=0) - 0.2
    (x_max, y_max) = np.vstack(projected).max(axis=0) + 0.2
    path = ""
    for line in projected:
        path += "M" + "L".join(f"{u:.2f} {v:.2f}" for u, v in line)
    width = x_max - x_min
    height = y_max - y_min
    style = (
        f'fill="none" stroke="#3a7ca5" stroke-width="{0.005 * (width + height):.3f}"'
        ' stroke-linecap="round"'
    )
    box = f'width="480" height="270" viewBox="{x_min:.2f} {y_min:.2f} {width:.2f} {height:.2f}"'
    image = f'<svg xmlns="http://www.w3.org/2000/svg" {box}><path d="{path}" {style}/></svg>'
    return (
        '<img alt="the robot from its side"'
        f' src="data:image/svg+xml;base64,{base64.b64encode(image.encode()).decode()}"/>'
    )


def _policy(scripts: Iterable[str]) -> str:
    """Return the content security policy of the page; meshcat's panels make style sheets, and its
    textures are data.
    """
    hashes = " ".join(f"'sha256-{_digest(text)}'" for text in scripts)
    none = "base-uri 'none'; form-action 'none'"
    return (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data: blob:;"
        f" {none}"
    )


def _digest(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")


def asset(name: str) -> str:
    """Return the text of a part of the page."""
    return (files("uvms_ocp.viz.scene") / "assets" / name).read_text(encoding="utf-8")


def _viewer_source() -> str:
    source = Path(viewer_assets_path()) / "dist" / "main.min.js"
    # Browsers hash what they parsed: line ends as in HTML, which are those of a text that is read.
    return source.read_text(encoding="utf-8").replace("</script", "<\\/script")


def _data_block(value: object) -> str:
    """Return JSON that nothing in it can end early; numbers that JSON has not are null."""
    finite = json.loads(json.dumps(value), parse_constant=lambda name: None)
    return json.dumps(finite, allow_nan=False).replace("<", "\\u003c")


# One page for the browsers of this machine, and what a live one is told: served on the loopback
# address alone.


@contextmanager
def served(
    page: ScenePage, port: int = 0, frames: Callable[[], Iterator[str]] | None = None
) -> Iterator[str]:
    """Serve the page while the context lasts; gives its address. port: 0 for any that is free.

    frames: makes the lines that a live page is told, for each browser in a thread of its own.
    Raises `OutputError` where the port is taken.
    """
    try:
        server = _PageServer((_HOST, port), _handler_of(page, frames))
    except (OSError, OverflowError) as error:
        raise OutputError(
            f"port {port} of {_HOST} cannot be served ({error}); give another, or 0 for any"
        ) from error
    thread = Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://{_HOST}:{server.server_port}/"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class _PageServer(ThreadingHTTPServer):
    """Turns away whoever comes while all connections are taken."""

    request_queue_size = _MOST_CONNECTIONS

    def __init__(self, *arguments: Any) -> None:
        self._free = BoundedSemaphore(_MOST_CONNECTIONS)
        super().__init__(*arguments)

    def process_request(self, request: Any, client_address: Any) -> None:
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        if not isinstance(sys.exc_info()[1], OSError):  # a browser that has gone
            super().handle_error(request, client_address)


def _handler_of(
    page: ScenePage, frames: Callable[[], Iterator[str]] | None
) -> type[BaseHTTPRequestHandler]:
    body = page.html.encode()

    class Handler(BaseHTTPRequestHandler):
        """Knows one page, and no one but those who ask for this machine by its loopback address."""

        timeout = _PATIENCE

        def do_GET(self) -> None:
            # A name that another site has led here is no loopback address.
            is_local = self.headers.get("Host", "").partition(":")[0] in (_HOST, "localhost")
            if is_local and self.path == FRAMES and frames is not None:
                self._send(frames())
                return
            is_page = is_local and self.path == "/"
            if is_page:
                status = 200
            elif is_local:
                status = 404
            else:
                status = 403
            self.send_response(status)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(body) if is_page else 0))
            self.end_headers()
            if is_page:
                self.wfile.write(body)

        def _send(self, lines: Iterator[str]) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/event-stream")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            for line in lines:
                self.wfile.write(f"data: {line}\n\n".encode())
            self.wfile.write(b"event: end\ndata: end\n\n")

        def log_message(self, format: str, *args: Any) -> None:
            """Drop the message, which nobody reads."""

    return Handler


# Pictures of a page, such as the frames of a video: drawn by a Chromium without a window, which
# playwright drives.


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
