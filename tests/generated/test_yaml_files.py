"""Any robot file and any file of obstacles: read, or refused in one line."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from drawing import binary, chosen, either, floats, texts
from hypothesis import given, settings, strategies as st
from promises import DAMAGES, Tally, damaged, damaged_bytes

from uvms_ocp.robot.description import RobotDescription, as_matrix6, read_description
from uvms_ocp.robot.loading import robot_folder
from uvms_ocp.robot.shapes.obstacles import (
    Obstacle,
    build_obstacle,
    describe_obstacle,
    parse_obstacle,
    read_obstacles,
)

pytestmark = pytest.mark.slow

ROBOT = {
    "base": "free_flyer",
    "water_density": 1025.0,
    "vehicle_limits": {"velocity": [1.0, 1, 1, 2, 2, 2], "acceleration": [1.0] * 6},
    "joints": {"joint1": {"home": 0.1, "acceleration": 2.0}},
    "links": {
        "base_link": {
            "coefficients": {
                "added_mass": [9.0] * 6,
                "linear_drag": [4.0] * 6,
                "quadratic_drag": [5.0] * 6,
            }
        },
        "link1": {"cylinder": {"radius": 0.1, "length": 0.4, "pose": {"position": [0.0, 0, 0.2]}}},
    },
    "trim": [{"name": "float", "position": [0.0, 0, 1], "mass": 1.0, "volume": 0.01}],
    "thrusters": [
        {
            "name": "t1",
            "position": [0.1, 0, 0],
            "direction": [1.0, 0, 0],
            "minimum": -9.0,
            "maximum": 9.0,
            "time_constant": 0.1,
            "curve": [[-1.0, -9.0], [1.0, 9.0]],
            "power": {"thrust": 5.0, "watts": 80.0},
        }
    ],
    "sensors": {"depth": {"rate": 10.0, "sigma": 0.1}, "position": None},
}
OBSTACLES = {
    "obstacles": [
        {"name": "ball", "shape": "sphere", "size": [0.3], "position": [1.0, 0.0, 0.0]},
        {
            "name": "box",
            "shape": "box",
            "size": [1.0, 1, 2],
            "position": [1.0, 2, 3],
            "rpy": [0.1, 0, 0],
        },
        {
            "name": "tent",
            "shape": "mesh",
            "vertices": [[0.0, 0, 0], [1.0, 0, 0], [0.0, 1, 0], [0.0, 0, 1]],
            "triangles": [[0, 1, 2], [0, 1, 3], [1, 2, 3], [0, 2, 3]],
            "position": [0.0, 0, 5],
        },
    ]
}


def finite(value: Any) -> bool:
    """All numbers in it are."""
    if isinstance(value, dict):
        return all(map(finite, value.values()))
    if isinstance(value, list | tuple):
        return all(map(finite, value))
    return not isinstance(value, float) or math.isfinite(value)


def check_robot(description: RobotDescription) -> None:
    plain = description.model_dump()
    assert finite(plain)
    assert RobotDescription.model_validate(plain) == description
    for link in description.links.values():
        if link.coefficients is not None:
            mass = as_matrix6(link.coefficients.added_mass)
            drag = as_matrix6(link.coefficients.linear_drag)
            np.testing.assert_allclose(mass, mass.T, atol=1e-9 * max(1.0, np.abs(mass).max()))
            assert np.linalg.eigvalsh(drag + drag.T).min() >= -1e-9 * max(1.0, np.abs(drag).max())


def check_obstacles(obstacles: tuple[Obstacle, ...]) -> None:
    for item in obstacles:
        data = describe_obstacle(item)
        assert data is not None
        assert finite(data.model_dump())
        again = describe_obstacle(build_obstacle(data))
        assert again is not None
        assert again.shape == data.shape


@pytest.mark.parametrize(
    ("whole", "read", "check"),
    [(ROBOT, read_description, check_robot), (OBSTACLES, read_obstacles, check_obstacles)],
    ids=["robot", "obstacles"],
)
def test_any_change_of_a_file_is_read_or_refused_in_one_line(
    whole: Any, read: Callable[[Path], Any], check: Callable[[Any], None], tmp_path: Path
) -> None:
    tally = Tally(bad=500)
    path = tmp_path / "file.yaml"
    path.write_text(json.dumps(whole))
    check(read(path))

    @settings(max_examples=700)
    @given(damaged(whole))
    def holds(value: Any) -> None:
        path.write_text(json.dumps(value, ensure_ascii=False), encoding="utf-8")
        tally.outcome(lambda: check(read(path)))

    holds()
    tally.check()


def test_any_text_is_read_or_refused_in_one_line(tmp_path: Path) -> None:
    tally = Tally(bad=300)
    path = tmp_path / "file.yaml"
    whole = (robot_folder("planar5") / "hydrodynamics.yaml").read_bytes()
    marks = texts("{}[]:,-&*!|>'\"%@`?# \n\tab01.e", max_size=40).map(str.encode)

    @settings(max_examples=600)
    @given(
        either(DAMAGES.map(lambda damage: damaged_bytes(whole, damage)), marks, binary(max_size=30))
    )
    def holds(content: bytes) -> None:
        path.write_bytes(content)
        description = tally.outcome(lambda: read_description(path))
        tally.outcome(lambda: read_obstacles(path))
        if description is not None:
            check_robot(description)

    holds()
    tally.check()


def test_any_words_are_an_obstacle_or_refused_in_one_line() -> None:
    tally = Tally(bad=300)
    number = either(
        floats().map(repr),
        chosen(["1", "0.5", "x", "", "1e400", "-1", "nan", "0x1", "1_0", "\u0661"]),
    )
    words = st.lists(number, max_size=8).map(",".join)

    @settings(max_examples=500)
    @given(chosen(["sphere", "box"]), either(words, texts(max_size=12)))
    def holds(shape: str, text: str) -> None:
        item = tally.outcome(lambda: parse_obstacle(shape, text, "a"))
        if item is not None:
            check_obstacles((item,))

    holds()
    item = tally.outcome(lambda: parse_obstacle("sphere", "1, 2,3 0.5", "a"))
    assert item is not None
    assert item.shape.radius == 0.5
    tally.check()


def test_yaml_and_json_of_the_same_values_are_read_alike(tmp_path: Path) -> None:
    for name, text in (("a.yaml", json.dumps(ROBOT)), ("b.yaml", yaml.safe_dump(ROBOT))):
        (tmp_path / name).write_text(text)
    assert read_description(tmp_path / "a.yaml") == read_description(tmp_path / "b.yaml")
