"""A meshcat scene without meshcat's server: commands are collected here and packed into one HTML page."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import umsgpack  # type: ignore[import-untyped]

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import OutputError
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

    html: str
    height: int = 520
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
        style = f"width:100%;height:{self.height}px;border:none"
        return f'<iframe srcdoc="{html.escape(self.html)}" style="{style}"></iframe>'


def build_page(log: CommandLog, *, title: str, details: Mapping[str, Any], height: int = 520) -> ScenePage:
    """Fill the page template with meshcat's viewer, the commands and `details` (JSON values) for the page's script."""
    folder = files("uvms_ocp.viz.scene")
    parts = {
        "__TITLE__": html.escape(title),
        "__STYLE__": (folder / "page.css").read_text(encoding="utf-8"),
        "__SCRIPT__": (folder / "page.js").read_text(encoding="utf-8"),
        "__DETAILS__": _script_safe(json.dumps(details)),
        "__COMMANDS__": json.dumps([base64.b64encode(blob).decode("ascii") for blob in log.blobs]),
        "__VIEWER__": _viewer_source(),
    }
    page = (folder / "page.html").read_text(encoding="utf-8")
    for mark, text in parts.items():
        page = page.replace(mark, text, 1)
    return ScenePage(html=page, height=height)


def _viewer_source() -> str:
    source = Path(viewer_assets_path()) / "dist" / "main.min.js"
    return source.read_text(encoding="utf-8").replace("</script", "<\\/script")


def _script_safe(text: str) -> str:
    return text.replace("<", "\\u003c")
