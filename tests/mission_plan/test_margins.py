"""What a mission plan keeps from obstacles and between links is what the mission's own tasks ask
for each of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uvms_ocp.mission_plan import Margins, clearances
from uvms_ocp.robot.shapes.collision_model import CollisionModel
from uvms_ocp.scenario.cases import obstacle_field
from uvms_ocp.tasks import Clearance, Hierarchy


@pytest.mark.parametrize("of_links", [0.01, 0.09])
@pytest.mark.parametrize("of_obstacles", [None, 0.01, 0.4])
def test_each_pair_keeps_what_is_asked_for_it(of_links: float, of_obstacles: float | None) -> None:
    given = obstacle_field(with_clearance=False)
    others = [task for task in given.mission.hierarchy.tasks if not isinstance(task, Clearance)]
    own = [Clearance(name="SC", model=CollisionModel(given.robot), threshold=of_links)]
    if of_obstacles is not None:
        around = CollisionModel(given.robot, given.environment.obstacles, self_collision=False)
        own.append(Clearance(model=around, threshold=of_obstacles))
    mission = replace(given.mission, hierarchy=Hierarchy([*others, *own]))
    margins = Margins().of(given.robot)
    kept = clearances.shape_clearance(replace(given, mission=mission), margins)
    assert kept is not None
    links = np.isfinite(kept.scene.room)
    assert kept.margins[links] == pytest.approx(
        np.minimum(max(margins.links, of_links), kept.scene.room[links])
    )
    assert kept.margins[~links] == pytest.approx(max(margins.position, of_obstacles or 0.0))
