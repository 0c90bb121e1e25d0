"""Other motions of the same robot beside the record's: translucent, each in a colour of its own, at the same time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.robot import Robot
from uvms_ocp.record import Record
from uvms_ocp.viz.scene.animation import Frames, frames_of
from uvms_ocp.viz.series import require_rows

_COLOURS = ((0.35, 0.85, 1.0), (1.0, 0.6, 0.25), (0.75, 0.6, 1.0), (0.5, 0.95, 0.55))
_OPACITY = 0.32
NO_GHOSTS: Mapping[str, Record] = MappingProxyType({})


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Ghost:
    """One of them."""

    name: str
    node: str
    """Of the scene."""
    rgb: tuple[float, float, float]
    """(3,) [-] from 0 to 1."""
    frames: Frames

    @property
    def rgba(self) -> tuple[float, float, float, float]:
        """(4,) [-] of its shapes."""
        return (*self.rgb, _OPACITY)


def ghosts_of(records: Mapping[str, Record], robot: Robot, fps: float) -> Iterator[Ghost]:
    """The ghosts of records by name, in frames of `fps` [Hz]. Raises `InvalidInput` for a record of another robot."""
    if len(records) > len(_COLOURS):
        raise InvalidInput(f"{len(records)} ghosts; give {len(_COLOURS)} at most, more cannot be told apart")
    for k, (name, record) in enumerate(records.items()):
        require_fit(record, robot)
        yield Ghost(name=name, node=f"ghost {k}", rgb=_COLOURS[k], frames=frames_of(record, robot, fps))


def require_fit(record: Record, robot: Robot) -> None:
    """Raise `InvalidInput` where the record is not of that robot, or has nothing to draw."""
    require_rows(record)
    if record["q"].shape[1] != robot.n_q:
        given = record["q"].shape[1]
        raise InvalidInput(f"record has {given} configuration values, {robot.name} has {robot.n_q}; give its own robot")
