"""What the page can show and hide, by name and colour."""

from __future__ import annotations

from typing import Any

from uvms_ocp.record import Record
from uvms_ocp.viz.scene.ghosts import Ghost
from uvms_ocp.viz.scene.shapes import hex_of

_SCENE = ("meshcat", "scene")


def legend(record: Record, trails: list[dict[str, Any]], ghosts: list[Ghost], *, beam: bool) -> list[dict[str, Any]]:
    """JSON values: rows that show or hide nodes of the scene by their paths; the page adds arrows and witness lines."""
    rows = [_row(f"path of the {trail['name']}", trail["colour"], trail["path"]) for trail in trails]
    if beam:
        rows.append(_row("altimeter", "#80ffe6", [*_SCENE, "beam"]))
    if record.meta.surroundings.frames or record.meta.surroundings.markers:
        rows.append(_row("goals", "#f24d1a", [*_SCENE, "goals"]))
    rows += [_row(ghost.name, hex_of(ghost.rgb), [*_SCENE, ghost.node]) for ghost in ghosts]
    return rows


def _row(label: str, colour: str, path: list[str]) -> dict[str, Any]:
    return {"label": label, "colour": colour, "path": path}
