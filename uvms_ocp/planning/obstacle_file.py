"""Obstacles as data: a YAML file, words of a command line, and the values that a ``Record`` keeps of them.

    obstacles:
      - {name: pile, shape: cylinder, size: [0.2, 3.0], position: [1.5, 0.0, 0.0]}
      - {name: crate, shape: box, size: [0.4, 0.4, 0.8], position: [2.0, 1.0, -0.5], rpy: [0.0, 0.0, 0.3]}

``size`` [m] is (radius) of a sphere, (radius, length) of a capsule or cylinder along z, (x, y, z) of a box; a capsule's
length is that of its straight part. ``position`` [m] and ``rpy`` [rad], R = Rz Ry Rx, are of its middle in W.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Literal

import coal
import pinocchio as pin
import yaml
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, model_validator

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.obstacles import Obstacle, obstacle

_N_SIZES: Mapping[str, int] = MappingProxyType({"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3})
_SHAPES: Mapping[str, Callable[..., coal.ShapeBase]] = MappingProxyType(
    {"sphere": coal.Sphere, "capsule": coal.Capsule, "cylinder": coal.Cylinder, "box": coal.Box}
)


class ObstacleData(BaseModel):
    """One obstacle; see the module."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[str, Field(min_length=1)]
    shape: Literal["sphere", "capsule", "cylinder", "box"]
    size: tuple[Annotated[FiniteFloat, Field(gt=0.0)], ...]
    position: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    rpy: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _has_its_sizes(self) -> ObstacleData:
        if len(self.size) != _N_SIZES[self.shape]:
            raise ValueError(f"a {self.shape} has {_N_SIZES[self.shape]} sizes, not {len(self.size)}")
        return self

    def build(self) -> Obstacle:
        """The obstacle itself."""
        return obstacle(self.name, _SHAPES[self.shape](*self.size), self.position, pin.rpy.rpyToMatrix(*self.rpy))


class ObstacleFile(BaseModel):
    """The whole file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    obstacles: tuple[ObstacleData, ...]


def read_obstacles(path: Path | str) -> tuple[ObstacleData, ...]:
    """Read a file of obstacles. Raises ``InvalidInput`` naming the file and the entry that is wrong."""
    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
        return ObstacleFile.model_validate(content).obstacles
    except ValidationError as error:
        raise InvalidInput(f"{path}: {_first(error)}") from error
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InvalidInput(f"{path}: cannot be read as YAML ({' '.join(str(error).split())})") from error


def obstacle_from_words(shape: str, words: str, name: str) -> ObstacleData:
    """An obstacle from its position and sizes, numbers with commas or blanks between: ``"X,Y,Z,R"`` for a sphere.

    Raises:
        InvalidInput: words that are not numbers, too many or too few, or a size that is not positive.
    """
    given = words.replace(",", " ").split()
    wanted = 3 + _N_SIZES[shape]
    try:
        numbers = [float(word) for word in given]
    except ValueError:
        numbers = []
    if len(numbers) != wanted:
        raise InvalidInput(f"{shape} {words!r}: give {wanted} numbers, the position and the size, such as 1,0,0.5,0.3")
    try:
        return ObstacleData.model_validate({"name": name, "shape": shape, "size": numbers[3:], "position": numbers[:3]})
    except ValidationError as error:
        raise InvalidInput(f"{shape} {words!r}: {_first(error)}") from error


def check_names(obstacles: tuple[ObstacleData, ...]) -> None:
    """Raise ``InvalidInput`` where two obstacles share a name."""
    names = [item.name for item in obstacles]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise InvalidInput(f"two obstacles are called {twice[0]!r}; give each a name of its own")


def _first(error: ValidationError) -> str:
    first = error.errors()[0]
    place = ".".join(str(part) for part in first["loc"])
    text = first["msg"].removeprefix("Value error, ")
    return f"{place}: {text}" if place else text
