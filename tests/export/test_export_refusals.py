"""What has no form in C is refused before anything is written, by its name."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import coal
import numpy as np
import pytest

import uvms_ocp as uo
from uvms_ocp.errors import InvalidInput
from uvms_ocp.export import export_controller
from uvms_ocp.export.c_files import literal, table
from uvms_ocp.robot.limits import PositionLimit
from uvms_ocp.robot.shapes.obstacles import Obstacle, mesh_shape, obstacle
from uvms_ocp.scenario.cases.transit import FIELD, obstacle_field
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.pose import VehiclePose

PYRAMID = mesh_shape(
    np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0], [0, 0, 1]]),
    np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]),
)
RUBBLE = obstacle("rubble", PYRAMID, (3.0, 3.0, -39.0))
CONE = obstacle("cone", coal.Cone(0.2, 0.5), (5.0, 3.0, -39.0))


@pytest.mark.parametrize(
    ("items", "names"), [((RUBBLE,), "rubble"), ((RUBBLE, CONE), "rubble, cone")]
)
def test_a_mission_among_shapes_without_a_form_in_c_is_refused_by_their_names(
    items: tuple[Obstacle, ...], names: str, tmp_path: Path
) -> None:
    scenario = obstacle_field(obstacles=(*FIELD, *items), duration=0.1)
    message = (
        rf"no form in C: task CL: distances of {names}; spheres, capsules, cylinders and boxes"
        r" have$"
    )
    with pytest.raises(InvalidInput, match=message):
        export_controller(scenario, tmp_path / "controller")
    assert not (tmp_path / "controller").exists()


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Fenced(VehiclePose):
    """A task of one's own with a limit on positions that Python tells."""

    def position_limit(self, robot: uo.Robot) -> PositionLimit:
        return PositionLimit(
            quantity="position_error",
            lower=-1.0,
            values=lambda q, rows: q[:1],
            reach=np.ones(robot.n_v),
        )


def test_a_limit_that_python_tells_is_refused(tmp_path: Path) -> None:
    scenario = obstacle_field(duration=0.1)
    tasks = [
        Fenced(goal=task.goal) if type(task) is VehiclePose else task
        for task in scenario.mission.hierarchy.tasks
    ]
    mission = replace(scenario.mission, hierarchy=Hierarchy(tasks))
    with pytest.raises(
        InvalidInput, match=r"no form in C: task PC: a limit on positions without an expression$"
    ):
        export_controller(replace(scenario, mission=mission), tmp_path / "controller")


def test_a_mission_among_spheres_capsules_and_boxes_has_a_form_in_c() -> None:
    assert obstacle_field().kinematic_controller().without_c_form == {}


@pytest.mark.parametrize(
    "name", ["<img src=x onerror=alert(1)>", "a`b`|c\n# d", "[x](javascript:y)", "_a_ **b**"]
)
def test_a_name_is_literal_in_markdown(name: str) -> None:
    for text in (literal(name), table([name])):
        span = text[text.index("`") :].rstrip(" |")
        assert span.startswith("`")
        assert span.endswith("`")
        assert not set(span[1:-1]) & set("`|\n")
    assert literal("case1") == "`case1`"
