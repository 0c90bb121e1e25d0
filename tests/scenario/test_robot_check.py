"""The report of check_robot: what a valid file can still get wrong."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from uvms_ocp.cli.commands import app
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.assembly import without_arm
from uvms_ocp.robot.description import TrimBody
from uvms_ocp.robot.loading import example_robot_data, list_robots, load_robot, robot_folder
from uvms_ocp.robot.static_balance import with_trim, without_trim
from uvms_ocp.scenario.preflight.robot_check import (
    RobotFinding,
    RobotReport,
    RobotVerdict,
    check_robot,
    check_robot_files,
)

MASS = (
    "<inertial><mass value='1'/><inertia ixx='{}' ixy='0' ixz='0' iyy='1' iyz='0'"
    " izz='1'/></inertial>"
)


def finding(report: RobotReport, subject: str) -> RobotFinding:
    return next(f for f in report.findings if f.subject == subject)


def write(folder: Path, urdf: str, water: str | None = None) -> Path:
    (folder / "robot.urdf").write_text(f"<robot name='mine'>{urdf}</robot>", encoding="utf-8")
    if water is not None:
        (folder / "hydrodynamics.yaml").write_text(water, encoding="utf-8")
    return folder


@pytest.mark.parametrize("name", list_robots())
def test_every_robot_of_the_package_is_usable(name: str) -> None:
    report = check_robot_files(robot_folder(name))
    assert report.usable
    assert report.name == name
    assert {f.subject for f in report.findings} >= {
        "inertias",
        "mass matrix",
        "limits",
        "frames",
        "shapes",
    }


def test_meshes_of_other_packages_are_resolved() -> None:
    urdf = example_robot_data() / "robots" / "panda_description/urdf/panda.urdf"
    report = check_robot_files(urdf, base="fixed", mimic="free")
    assert report.usable
    assert finding(report, "shapes").text == "11 visual shapes, 11 of them meshes, all found"
    assert finding(report, "limits").text.startswith(
        "unlimited: 9 of 9 acceleration; give vehicle_limits"
    )
    assert "tool: panda_hand_tcp" in finding(report, "frames").text


@pytest.mark.parametrize(
    ("verdicts", "begins"),
    [
        ((RobotVerdict.GOOD,), "usable; next: `uvms-ocp new-mission"),
        ((RobotVerdict.GOOD, RobotVerdict.WARNING), "usable, with 1 to look at"),
        ((RobotVerdict.WARNING, RobotVerdict.ERROR), r"not usable: mend what is called error (1)"),
    ],
)
def test_a_report_says_what_to_do_next(verdicts: tuple[RobotVerdict, ...], begins: str) -> None:
    findings = tuple(RobotFinding(subject="a", verdict=verdict, text="b") for verdict in verdicts)
    assert RobotReport(name="mine", findings=findings).advice.startswith(begins)


def test_a_file_that_cannot_be_loaded_is_the_one_error(tmp_path: Path) -> None:
    report = check_robot_files(write(tmp_path, "<link name='a'/>"))
    assert not report.usable
    assert [f.verdict for f in report.findings] == [RobotVerdict.ERROR]
    assert "no link has a mass" in report.findings[0].text


def test_the_thrusters_say_which_axis_they_cannot_drive() -> None:
    report = check_robot(load_robot("girona_maris7"))
    assert finding(report, "thrusters").verdict is RobotVerdict.WARNING
    assert "5 thrusters, rank 5" in finding(report, "thrusters").text
    assert finding(report, "thrusters").text.endswith("under-actuated mainly in roll")
    assert (
        finding(check_robot(load_robot("girona_maris7_full")), "thrusters").verdict
        is RobotVerdict.GOOD
    )


def test_an_untrimmed_robot_is_told_which_float_would_trim_it() -> None:
    trim = finding(check_robot(without_trim(load_robot("girona_maris7"))), "trim")
    assert trim.verdict is RobotVerdict.WARNING
    assert "-118 N upwards and 146 N m" in trim.text
    assert "a float of 1" in trim.text


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.2, -0.1), (-0.4, 0.3)])
@pytest.mark.parametrize(
    ("mass", "volume"), [(3.0, 0.0), (0.0, 2e-3), (1.0, 1e-3), (1.0, 1.001e-3)]
)
def test_trim_that_is_advised_trims_and_lies_within_the_hull(
    mass: float, volume: float, place: tuple[float, float]
) -> None:
    """The entries as they are printed, for a vehicle that carries something, heavy or light, or
    only out of place.
    """
    robot = load_robot("bluerov2_alpha5")
    robot = with_trim(
        robot, [TrimBody(name="pack", position=(*place, 0.0), mass=mass, volume=volume)]
    )
    robot = with_trim(
        robot, [TrimBody(name="cell", position=(0.2, 0.1, 0.0), mass=1.0, volume=0.0)]
    )
    text = finding(check_robot(robot), "trim").text
    entries = yaml.safe_load(text[text.index("trim: [") :])["trim"]
    bodies = [TrimBody(**entry) for entry in entries]
    assert [body.name for body in bodies[: len(robot.description.trim)]] == [
        body.name for body in robot.description.trim
    ]
    assert (
        finding(check_robot(with_trim(without_trim(robot), bodies)), "trim").verdict
        is RobotVerdict.GOOD
    )
    added = bodies[len(robot.description.trim) :]
    assert all(abs(body.position[0]) < 0.23 and abs(body.position[1]) < 0.29 for body in added)


def test_trim_that_is_advised_can_be_pasted_where_the_file_has_some_already(tmp_path: Path) -> None:
    """In place of it: a second `trim:` would be a repeated key. And once more, when something was
    added since.
    """
    files = {
        path.name: path.read_text(encoding="utf-8")
        for path in robot_folder("bluerov2").iterdir()
        if path.is_file()
    }
    water = yaml.safe_load(files["hydrodynamics.yaml"])
    for lamp in ("lamp", "sonar"):
        water["trim"].append(
            {"name": lamp, "position": [0.2, 0.1, 0.0], "mass": 0.4, "volume": 0.0001}
        )
        (tmp_path / "robot.urdf").write_text(files["robot.urdf"], encoding="utf-8")
        (tmp_path / "hydrodynamics.yaml").write_text(yaml.safe_dump(water), encoding="utf-8")
        text = finding(check_robot_files(tmp_path), "trim").text
        assert "would trim it in place of what stands there" in text
        water |= yaml.safe_load(text[text.index("trim: [") :])
        (tmp_path / "hydrodynamics.yaml").write_text(yaml.safe_dump(water), encoding="utf-8")
        assert finding(check_robot_files(tmp_path), "trim").verdict is RobotVerdict.GOOD


@pytest.mark.parametrize("name", ["a: b, c", "null", "12", "float_1", "float_1_1", "ballast_2"])
def test_trim_that_is_advised_can_be_pasted_whatever_bodies_are_called(name: str) -> None:
    """A body of half the float that was advised, or of any name, and the same advice again."""
    bare = without_trim(load_robot("girona_maris7"))
    text = finding(check_robot(bare), "trim").text
    first = TrimBody(**yaml.safe_load(text[text.index("trim: [") :])["trim"][0])
    half = first.model_copy(
        update={"name": name, "mass": first.mass / 2, "volume": first.volume / 2}
    )
    text = finding(check_robot(with_trim(bare, [half])), "trim").text
    bodies = [TrimBody(**entry) for entry in yaml.safe_load(text[text.index("trim: [") :])["trim"]]
    assert bodies[0].name == name
    assert finding(check_robot(with_trim(bare, bodies)), "trim").verdict is RobotVerdict.GOOD


def test_a_light_vehicle_is_told_to_take_ballast() -> None:
    trim = finding(check_robot(without_trim(without_arm(load_robot("girona_maris7")))), "trim")
    assert "a ballast of 23.9 N" in trim.text


def test_an_impossible_inertia_is_an_error(tmp_path: Path) -> None:
    report = check_robot_files(write(tmp_path, f"<link name='base_link'>{MASS.format(3)}</link>"))
    assert not report.usable
    assert (
        "allowed: none exceeds the sum of the others; mend <inertia>"
        in finding(report, "inertias").text
    )


def test_a_massless_tip_makes_the_mass_matrix_singular(tmp_path: Path) -> None:
    joint = (
        "<link name='tip'/><joint name='j' type='revolute'><parent link='base_link'/><child"
        " link='tip'/><axis xyz='0 0 1'/><limit lower='-1' upper='1' velocity='1'"
        " effort='1'/></joint>"
    )
    report = check_robot_files(
        write(tmp_path, f"<link name='base_link'>{MASS.format(1)}</link>{joint}")
    )
    assert not report.usable
    assert (
        finding(report, "inertias").text == "no mass in link 'tip'; give links there an <inertial>"
    )
    assert finding(report, "mass matrix").verdict is RobotVerdict.ERROR


def test_a_free_flyer_without_water_or_thrusters_is_warned_about(tmp_path: Path) -> None:
    hull = f"<link name='base_link'>{MASS.format(1)}</link>"
    dry = check_robot_files(write(tmp_path, hull))
    assert dry.usable
    assert "give a hydrodynamics.yaml" in finding(dry, "water").text
    wet = check_robot_files(write(tmp_path, hull, "links: {base_link: {sphere: {radius: 0.1}}}"))
    assert finding(wet, "thrusters").verdict is RobotVerdict.WARNING


def test_links_that_could_touch_something_unseen_are_named(tmp_path: Path) -> None:
    box = "<collision><geometry><box size='1 1 1'/></geometry></collision>"
    joint = (
        "<joint name='j' type='fixed'><parent link='base_link'/><child link='arm'/></joint><link"
        " name='arm'>{}</link><joint name='k' type='fixed'><parent link='arm'/><child"
        " link='frame'/></joint><link name='frame'/>"
    )
    hull = f"<link name='base_link'>{MASS.format(1)}{box}</link>"
    texts = {
        bare: [
            f.text for f in check_robot_files(write(tmp_path, hull + joint.format(inside))).findings
        ]
        for bare, inside in ((True, MASS.format(1)), (False, MASS.format(1) + box))
    }
    beginning = "links with a mass, without a collision shape: arm: "
    assert [any(text.startswith(beginning) for text in texts[bare]) for bare in (True, False)] == [
        True,
        False,
    ]


def test_a_variant_in_the_place_of_a_whole_file_is_named(tmp_path: Path) -> None:
    hull = f"<link name='base_link'>{MASS.format(1)}</link>"
    links = "links: {base_link: {sphere: {radius: 0.1}}}"
    variant = check_robot_files(write(tmp_path, hull, links))
    assert "a variant belongs over a whole file" in finding(variant, "thrusters").text
    whole = check_robot_files(write(tmp_path, hull, f"{links}\nwater_density: 1025.0"))
    assert "variant" not in finding(whole, "thrusters").text


@pytest.mark.slow
def test_the_command_has_the_options_of_the_loader() -> None:
    urdf = str(example_robot_data() / "robots" / "panda_description/urdf/panda.urdf")
    for word, joints in (("coupled", 8), ("free", 9), ("fixed", 8)):
        process = CliRunner().invoke(
            app, ["check-robot", urdf, "--base", "fixed", "--mimic", word, "--json"]
        )
        assert process.exit_code == 0
        assert len(load_robot(urdf=urdf, base="fixed", mimic=word).joints) == joints  # type: ignore[arg-type]
    mistakes = (
        ("--base", "wheels", "given 'wheels'"),
        ("--mimic", "follow", "mimic = 'follow'; give 'coupled' or 'free' or 'fixed' or None"),
    )
    for option, value, message in mistakes:
        wrong = CliRunner().invoke(app, ["check-robot", urdf, option, value])
        assert isinstance(wrong.exception, InvalidInput)
        assert message in str(wrong.exception)
