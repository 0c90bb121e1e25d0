"""Environment of the robot, floor, water and obstacles: sampled for the plant, and the closest
approach to it in a run.
"""

from __future__ import annotations

from dataclasses import field

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.robot.shapes.obstacles import Obstacle, require_distinct_names
from uvms_ocp.sim.currents import Current, StillWater
from uvms_ocp.sim.seafloor import Seafloor


@checked_dataclass(eq=False)
class Environment:
    """Everything that is not the robot. Raises `InvalidInput` for two obstacles of the same
    name.
    """

    seafloor: Seafloor
    """Floor of the sea."""
    current: Current = field(default_factory=StillWater)
    """Current of the water."""
    obstacles: tuple[Obstacle, ...] = ()
    """Obstacles, each with a name of its own."""

    def __post_init__(self) -> None:
        require_distinct_names(self.obstacles)
