"""What has no form in C is refused before anything is written, by its name."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pytest

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.export import export_controller
from uvms_ocp.model.shapes.obstacles import Obstacle, mesh_shape, obstacle
from uvms_ocp.scenarios.obstacle_field import FIELD, obstacle_field

PYRAMID = mesh_shape(
    np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0], [0, 0, 1]]), np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
)
RUBBLE = obstacle("rubble", PYRAMID, (3.0, 3.0, -39.0))
CONE = obstacle("cone", coal.Cone(0.2, 0.5), (5.0, 3.0, -39.0))


@pytest.mark.parametrize(("items", "names"), [((RUBBLE,), "rubble"), ((RUBBLE, CONE), "rubble, cone")])
def test_a_mission_among_shapes_without_a_form_in_c_is_refused_by_their_names(
    items: tuple[Obstacle, ...], names: str, tmp_path: Path
) -> None:
    scenario = obstacle_field(obstacles=(*FIELD, *items), duration=0.1)
    message = f"no form in C: task CL: distances of {names}; spheres, capsules, cylinders and boxes have$"
    with pytest.raises(InvalidInput, match=message):
        export_controller(scenario, tmp_path / "controller")
    assert not (tmp_path / "controller").exists()


def test_a_mission_among_spheres_capsules_and_boxes_has_a_form_in_c() -> None:
    assert obstacle_field().kinematic_controller().without_c_form == {}
