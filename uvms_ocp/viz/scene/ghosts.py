"""Other motions of the same robot beside the record's: translucent, each in a colour of its own, at
the same time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.record import Record
from uvms_ocp.robot.robot import Robot
from uvms_ocp.viz.scene import colours
from uvms_ocp.viz.scene.animation import Frames, frames_of, require_fit

NO_GHOSTS: Mapping[str, Record] = MappingProxyType({})


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Ghost:
    """A motion that is drawn translucent beside the record's."""

    name: str
    node: str
    """Node of the scene."""
    rgb: tuple[float, float, float]
    """Colour (3,) from 0 to 1."""
    frames: Frames
    """Motion of the ghost, thinned to the frames of the animation."""


def ghosts_of(records: Mapping[str, Record], robot: Robot, fps: float) -> Iterator[Ghost]:
    """Yield the ghosts of records by name, in frames of `fps` [Hz]. Raises `InvalidInput` for a
    record of another robot.
    """
    if len(records) > len(colours.GHOSTS):
        raise InvalidInput(
            f"{len(records)} ghosts; give {len(colours.GHOSTS)} at most, more cannot be told apart"
        )
    for k, (name, record) in enumerate(records.items()):
        require_fit(record, robot)
        yield Ghost(
            name=name,
            node=f"ghost {k}",
            rgb=colours.GHOSTS[k],
            frames=frames_of(record, robot, fps),
        )
