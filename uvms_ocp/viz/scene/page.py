"""HTML page of a meshcat scene without its server: commands are collected, and packed into one
page.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
import sys
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np
import umsgpack  # type: ignore[import-untyped]

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput, plain_line
from uvms_ocp.record.output import as_output_errors
from uvms_ocp.types import AtLeastOne, Magnitude, Positive

if TYPE_CHECKING:
    pass

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
"""Files of the page's script, one after the other."""
_MARK = re.compile("__([A-Z]+)__")


@dataclass(kw_only=True, slots=True)
class CommandLog:
    """Replacement of meshcat's window that keeps every command instead of sending it to a server."""

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

    def save(
        self,
        path: Path | str,
        *,
        t: Magnitude = 0.0,
        view: str = "mission",
        fps: Positive = 25.0,
        width: AtLeastOne = 1280,
        height: AtLeastOne = 720,
    ) -> Path:
        """Write the page (``.html``), a picture of a time t [s] (``.png``, ``.jpg``) or its whole
        time line as a film (``.mp4``, ``.gif``), by the suffix of the path; returns the path.

        view: the camera, ``mission``, ``vehicle`` or ``tool``. fps [Hz]: pictures per second of
        film and motion. width, height [px] of pictures. Raises `InvalidInput` for another suffix or
        view, for a film in which nothing moves, and where playwright, Chromium or ffmpeg is missing
        (``pip install "uvms-ocp[video]"``); `OutputError` where `path` cannot be written.
        """
        # Imported here, as that module builds on this one.
        from uvms_ocp.viz.scene import pictures

        path = Path(path)
        require_saved_suffix(path)
        if path.suffix == ".html":
            return self.write(path)
        camera = pictures.Camera(width=width, height=height, view=view)
        if path.suffix in pictures.PICTURE_FORMATS:
            pictures.write_picture(self, path, t=t, camera=camera)
        else:
            pictures.write_film(self, path, fps=fps, camera=camera)
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


def require_saved_suffix(path: Path) -> None:
    """Raise `InvalidInput` for a file that `ScenePage.save` cannot write, by its suffix."""
    from uvms_ocp.viz.scene import pictures

    suffixes = (".html", *pictures.PICTURE_FORMATS, *pictures.FILM_FORMATS)
    if path.suffix not in suffixes:
        raise InvalidInput(f"{path.name} has no suffix of {', '.join(suffixes)}")


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
