"""The schema of hydrodynamics.yaml: a mistake is one line with the file, the key, the value and
what is allowed.
"""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from uvms_ocp.errors import RobotDataError
from uvms_ocp.robot.description import (
    LinkCoefficients,
    RobotDescription,
    as_matrix6,
    read_description,
)

THRUSTER = (
    "name: t, position: [0, 0, 0], direction: [1, 0, 0], minimum: -40, maximum: 40,"
    " time_constant: 0.1"
)
INDEFINITE = [[1.0 if i == j else 0.0 for j in range(6)] for i in range(6)]
INDEFINITE[0][1] = INDEFINITE[1][0] = 2.0
SKEWED = [[1.0 if i == j else 0.0 for j in range(6)] for i in range(6)]
SKEWED[0][1] = 0.5
GENERATING = [[0.1 if i == j else 0.0 for j in range(6)] for i in range(6)]
GENERATING[2][2] = -1.0


def read(tmp_path: Path, text: str) -> RobotDescription:
    path = tmp_path / "hydrodynamics.yaml"
    path.write_text(text, encoding="utf-8")
    return read_description(path)


@pytest.mark.parametrize(
    ("minimum", "maximum", "largest_thrust"),
    [(-40, 50, 50), (-60, 50, 60), (-60, 0, 60), (0, 5, 5)],
)
def test_the_largest_thrust_of_a_thruster_is_that_of_its_stronger_direction(
    tmp_path: Path, minimum: float, maximum: float, largest_thrust: float
) -> None:
    limits = f"minimum: {minimum}, maximum: {maximum}"
    thruster = THRUSTER.replace("minimum: -40, maximum: 40", limits)
    description = read(tmp_path, f"links: {{}}\nthrusters: [{{{thruster}}}]")
    assert description.thrusters[0].largest_thrust == largest_thrust


def coefficients(text: str) -> str:
    return f"links: {{hull: {{coefficients: {{{text}}}}}}}"


MISTAKES = {
    "misspelt key": (
        "water_densty: 1000",
        "water_densty",
        "unknown key; did you mean 'water_density'?",
    ),
    "true for a number": (
        "water_density: true",
        "water_density: given 'true';",
        "allowed: a valid number",
    ),
    "millimetres": (
        coefficients("volume: 1, centre_of_buoyancy: [0, 0, 100]"),
        "centre_of_buoyancy.2",
        "50",
    ),
    "unknown key": ("qqq: 1000", "qqq", "unknown key; known here: altimeter, base"),
    "unknown key in a thruster": (
        f"thrusters: [{{{THRUSTER}, colour: red}}]",
        r"thrusters.0.colour",
        "unknown key",
    ),
    "word for a number": ("water_density: heavy", "water_density", "'heavy'"),
    "density in g/cm3": (
        "water_density: 1",
        "water_density: given 1;",
        "greater than or equal to 900",
    ),
    "NaN": ("water_density: .nan", "water_density", "finite"),
    "wrong base": ("base: wheels", "base", "'free_flyer' or 'fixed'"),
    "negative volume": (
        coefficients("volume: -0.1"),
        "links.hull.coefficients.volume: given -0.1;",
        "or equal to 0",
    ),
    "buoyancy without volume": (
        coefficients("centre_of_buoyancy: [0, 0, 0.1]"),
        "links.hull.coefficients",
        "volume > 0",
    ),
    "five coefficients": (
        coefficients("quadratic_drag: [1, 1, 1, 1, 1]"),
        "quadratic_drag",
        "missing",
    ),
    "negative quadratic drag": (
        coefficients("quadratic_drag: [1, 1, -1, 1, 1, 1]"),
        r"quadratic_drag.2: given -1;",
        "0",
    ),
    "drag that feeds energy": (
        coefficients("linear_drag: [1, 1, -2, 1, 1, 1]"),
        "linear_drag",
        "feeds 2 W at nu = (0, 0, 1, 0, 0, 0)",
    ),
    "drag matrix that feeds energy": (
        coefficients(f"linear_drag: {GENERATING}"),
        "linear_drag",
        "feeds",
    ),
    "negative added mass": (
        coefficients("added_mass: [-1, 1, 1, 1, 1, 1]"),
        "added_mass",
        "indefinite",
    ),
    "indefinite added mass": (
        coefficients(f"added_mass: {INDEFINITE}"),
        "added_mass",
        "indefinite",
    ),
    "non-symmetric added mass": (coefficients(f"added_mass: {SKEWED}"), "added_mass", "symmetric"),
    "two ways to describe a link": (
        "links: {arm: {sphere: {radius: 0.1}, box: {size: [1, 1, 1]}}}",
        "links.arm",
        "exactly one of",
    ),
    "zero radius": (
        "links: {arm: {sphere: {radius: 0}}}",
        "links.arm.sphere.radius: given 0;",
        "greater than 0",
    ),
    "negative mass": (
        "trim: [{name: a, position: [0, 0, 0], mass: -1, volume: 0}]",
        r"trim.0.mass: given -1;",
        "0",
    ),
    "missing key": ("trim: [{name: a, position: [0, 0, 0], mass: 1}]", "trim.0.volume", "missing"),
    "thruster without direction": (
        f"thrusters: [{{{THRUSTER.replace('[1, 0, 0]', '[0, 0, 0]')}}}]",
        "thrusters.0.direction",
        "a length from 1e-9 to 1e9",
    ),
    "thruster with a direction whose square is endless": (
        f"thrusters: [{{{THRUSTER.replace('[1, 0, 0]', '[1.0e+200, 0, 0]')}}}]",
        "thrusters.0.direction",
        "a length from 1e-9 to 1e9",
    ),
    "thruster limit of the wrong sign": (
        f"thrusters: [{{{THRUSTER.replace('minimum: -40', 'minimum: 40')}}}]",
        "thrusters.0.minimum: given 40;",
        "0",
    ),
    "dead zone beyond the limit": (
        f"thrusters: [{{{THRUSTER}, dead_zone: 50}}]",
        "thrusters.0",
        "dead_zone 50",
    ),
    "falling thrust curve": (
        f"thrusters: [{{{THRUSTER}, curve: [[0, 1], [1, 0]]}}]",
        "thrusters.0.curve",
        "point 2, [1.0, 0.0], does not",
    ),
    "two thrusters of one name": (
        f"thrusters: [{{{THRUSTER}}}, {{{THRUSTER}}}]",
        "thrusters",
        "unique",
    ),
    "speed limit 0": (
        "vehicle_limits: {velocity: [0, 1, 1, 1, 1, 1], acceleration: [1, 1, 1, 1, 1, 1]}",
        "velocity.0",
        "greater than 0",
    ),
    "repeated key": ("water_density: 998\nwater_density: 1025", "YAML", "repeated key"),
    "not YAML": ("links: [", "not valid YAML", "hydrodynamics.yaml"),
    "empty file": ("", "empty", "hydrodynamics.yaml"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_that_names_file_key_and_range(mistake: str, tmp_path: Path) -> None:
    text, key, allowed = MISTAKES[mistake]
    with pytest.raises(RobotDataError, match=key) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    assert allowed in message
    assert "hydrodynamics.yaml" in message
    assert "\n" not in message


def test_several_mistakes_are_told_at_once_and_a_section_knows_its_own_keys(tmp_path: Path) -> None:
    text = "water_density: heavy\n" + coefficients("volumn: 1, qqq: 2")
    with pytest.raises(RobotDataError) as caught:
        read(tmp_path, text)
    first, second, third = str(caught.value).split("; and ")
    assert "water_density: given 'heavy'" in first
    assert second == "links.hull.coefficients.volumn: unknown key; did you mean 'volume'?"
    assert third.startswith(
        "links.hull.coefficients.qqq: unknown key; known here: added_mass, centre_of_buoyancy, "
    )
    assert "water_density" not in third


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RobotDataError, match=r"nowhere\.yaml: cannot be read"):
        read_description(tmp_path / "nowhere.yaml")


def test_defaults_describe_a_dry_free_flyer(tmp_path: Path) -> None:
    description = read(tmp_path, "base: free_flyer")
    assert description == RobotDescription()
    assert not description.links


def test_a_description_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="frozen"):
        RobotDescription().water_density = 1025.0


def test_a_diagonal_and_its_matrix_mean_the_same() -> None:
    diagonal = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    matrix = as_matrix6(diagonal)
    assert (as_matrix6(tuple(map(tuple, matrix.tolist()))) == matrix).all()


def test_the_json_schema_says_every_unit_and_forbids_other_keys() -> None:
    schema = RobotDescription.model_json_schema()
    assert schema["additionalProperties"] is False
    assert "[kg/m3]" in schema["properties"]["water_density"]["description"]
    assert schema["$defs"]["Thruster"]["properties"]["time_constant"]["description"].startswith(
        "first-order lag [s]"
    )


def test_a_description_survives_a_round_trip_through_yaml(tmp_path: Path) -> None:
    description = read(
        tmp_path, f"thrusters: [{{{THRUSTER}}}]\nlinks: {{arm: {{sphere: {{radius: 0.1}}}}}}"
    )
    text = yaml.safe_dump(description.model_dump(mode="json", exclude_none=True))
    assert read(tmp_path, text) == description


@pytest.mark.parametrize("field", ["linear_drag", "added_mass"])
def test_the_largest_numbers_are_judged_without_overflow(field: str) -> None:
    huge = [1e308, *[4.0] * 5]
    assert getattr(LinkCoefficients.model_validate({field: huge}), field) == tuple(huge)
