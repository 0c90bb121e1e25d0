"""What happens where horizontal attitude does not outrank the way point."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from uvms_ocp.arguments import checked
from uvms_ocp.scenario import Scenario, pose_at
from uvms_ocp.scenarios.case1 import case1
from uvms_ocp.tasks.hierarchy import Hierarchy


@checked
def priority_swap(*, swapped: bool = True, **options: Any) -> Scenario:
    """Case 1 with a way point whose attitude is pitched by 0.3 rad, and PC above HA ([Gao2022], after Table 3).

    Swapped, the vehicle follows the way point's attitude and tilts by more than 0.1 rad; in the right order HA keeps
    the tilt below 0.1 rad. Both reach the target. Other options as for `case1`.
    """
    defaults: dict[str, Any] = {"way_point": pose_at((10.8, 37.45, -38.0), (0.0, -0.3, 0.5))}
    scenario = case1(**{**defaults, **options})
    if swapped:
        hierarchy = scenario.mission.hierarchy
        order = exchanged(hierarchy.names, "HA", "PC")
        mission = replace(scenario.mission, hierarchy=Hierarchy(hierarchy.tasks, order))
        scenario = replace(scenario, mission=mission)
    return replace(scenario, name="priority_swap")


def exchanged(names: tuple[str, ...], first: str, second: str) -> tuple[str, ...]:
    """The names with two of them in each other's place."""
    places = {first: second, second: first}
    return tuple(places.get(name, name) for name in names)
