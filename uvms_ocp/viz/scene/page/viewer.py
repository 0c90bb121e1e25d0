"""A meshcat scene without meshcat's server: commands are collected here and packed into one HTML page."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import umsgpack  # type: ignore[import-untyped]

from uvms_ocp.arguments import AtLeastOne, checked
from uvms_ocp.exceptions import OutputError, plain_line
from uvms_ocp.viz.scene.meshcat_parts import (
    Animation,
    ScenePath,
    SetAnimation,
    Visualizer,
    viewer_assets_path,
)


@dataclass(kw_only=True, slots=True)
class CommandLog:
    """Stands in for meshcat's window: keeps every command instead of sending it to a server."""

    blobs: list[bytes] = field(default_factory=list)

    def send(self, command: Any) -> None:
        """What meshcat's `Visualizer` calls; 32-bit floats halve the page."""
        self.blobs.append(umsgpack.packb(command.lower(), force_float_precision="single"))

    def visualizer(self) -> Visualizer:
        """A meshcat visualizer that writes into this log."""
        return Visualizer(window=self)

    def animate(self, clips: Mapping[ScenePath, Any]) -> None:
        """Load one clip per path; the page starts and drives them."""
        self.send(SetAnimation(Animation(clips=dict(clips)), play=False))

    def commands(self) -> Iterator[Any]:
        """The commands as plain values."""
        return (umsgpack.unpackb(blob) for blob in self.blobs)


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class ScenePage:
    """A finished page: write it to a file, or show it as the last value of a notebook cell."""

    html: str = field(repr=False)
    height: AtLeastOne = 520
    """[px] in a notebook."""

    def write(self, path: Path | str) -> Path:
        """Raises `OutputError` where `path` cannot be written."""
        path = Path(path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(self.html, encoding="utf-8")
        except OSError as error:
            raise OutputError(f"{path}: cannot be written ({error}); choose another place") from error
        return path

    def _repr_html_(self) -> str:
        style = f"width:100%;height:{self.height:d}px;border:none"
        return f'<iframe sandbox="allow-scripts" srcdoc="{html.escape(self.html)}" style="{style}"></iframe>'


def build_page(
    log: CommandLog, *, title: str, details: Mapping[str, Any], height: int = 520, live: bool = False
) -> ScenePage:
    """Fill the page template with meshcat's viewer, the commands and `details` (JSON values) for the page's script.

    The page's policy lets the viewer and the page's script run, by their hashes, and nothing else, and loads nothing; a live
    one hears from whoever serves it.
    """
    folder = files("uvms_ocp.viz.scene.page")
    own = "".join((folder / f"{name}.js").read_text(encoding="utf-8") for name in _SCRIPTS)
    scripts = {"VIEWER": _viewer_source(), "SCRIPT": own}
    parts = {
        **scripts,
        "POLICY": _policy(scripts.values()) + ("; connect-src 'self'" if live else ""),
        "TITLE": html.escape(plain_line(title)),
        "STYLE": (folder / "page.css").read_text(encoding="utf-8"),
        "DETAILS": _data_block(details),
        "COMMANDS": _data_block([base64.b64encode(blob).decode("ascii") for blob in log.blobs]),
    }
    # In one pass, so that no text that is filled in is looked through for marks.
    page = _MARK.sub(lambda mark: parts[mark[1]], (folder / "page.html").read_text(encoding="utf-8"))
    return ScenePage(html=page, height=height)


_SCRIPTS = ("stage", "camera", "legend", "time", "arrows", "joints", "live", "main")
"""One after the other: the page's script."""
_MARK = re.compile("__([A-Z]+)__")


def _policy(scripts: Iterable[str]) -> str:
    """What the page may do; meshcat's panels make style sheets, and its textures are data."""
    digests = (base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii") for text in scripts)
    hashes = " ".join(f"'sha256-{digest}'" for digest in digests)
    return (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def _viewer_source() -> str:
    source = Path(viewer_assets_path()) / "dist" / "main.min.js"
    # Browsers hash what they parsed: line ends as in HTML.
    text = source.read_text(encoding="utf-8").replace("\r\n", "\n").replace("\r", "\n")
    return text.replace("</script", "<\\/script")


def _data_block(value: object) -> str:
    """JSON that nothing in it can end early; numbers that JSON has not are null."""
    return json.dumps(_finite(value), allow_nan=False).replace("<", "\\u003c")


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
