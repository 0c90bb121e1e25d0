"""What surrounds the robot: floor, water and obstacles."""

from __future__ import annotations

from dataclasses import dataclass, field

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.shapes.obstacles import Obstacle
from uvms_ocp.sim.currents import Current, StillWater
from uvms_ocp.sim.seafloor import Seafloor


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Environment:
    """Everything that is not the robot. Raises `InvalidInput` for two obstacles of the same name."""

    seafloor: Seafloor
    """Everywhere below."""
    current: Current = field(default_factory=StillWater)
    """Of the water."""
    obstacles: tuple[Obstacle, ...] = ()
    """With names of their own."""

    def __post_init__(self) -> None:
        names = [obstacle.name for obstacle in self.obstacles]
        if len(set(names)) != len(names):
            raise InvalidInput(f"names of obstacles must be unique; given: {names}")
