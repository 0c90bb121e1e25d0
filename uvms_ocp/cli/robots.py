"""``check-robot``, ``schema``, ``list``, ``new-robot``, ``new-mission`` and ``export``: robot files, templates and C sources."""

from __future__ import annotations

import os
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal, cast

import pinocchio as pin
import typer
from rich.table import Table

from uvms_ocp.cli import options as opt
from uvms_ocp.cli.printing import cell, console_of, print_json, print_paths, show_compilation
from uvms_ocp.errors import InvalidInput, OutputError, plain_line
from uvms_ocp.export.controller import export_controller
from uvms_ocp.robot import Robot, list_robots, robot_folder
from uvms_ocp.robot.description import RobotDescription
from uvms_ocp.scenario.cases import SCENARIOS
from uvms_ocp.scenario.own_code import robot_of
from uvms_ocp.scenario.preflight.robot_check import RobotReport, check_robot_files
from uvms_ocp.sim.own_parts import PLANTS

# ``check-robot`` and ``schema``: robot files.


def check_robot(
    robot: Annotated[
        str,
        typer.Argument(help="URDF, a folder with robot.urdf and hydrodynamics.yaml, or a name, see `uvms-ocp list`."),
    ],
    hydrodynamics: Annotated[Path | None, typer.Option(metavar="YAML", help="Hydrodynamics file.")] = None,
    base: Annotated[
        str | None, typer.Option(metavar="free_flyer|fixed", help="Whether it floats; default: what its file says.")
    ] = None,
    packages: Annotated[
        list[Path] | None, typer.Option("--packages", metavar="DIR", help="Where package:// meshes are; repeatable.")
    ] = None,
    mimic: Annotated[
        str | None, typer.Option(metavar="free", help="Take joints that mimic another one for joints of their own.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Check a robot: inertias, trim, thruster rank, frames, meshes."""
    let = cast(Literal["free"] | None, mimic)  # `load_robot` refuses other words
    report = check_robot_files(_files(robot), hydrodynamics, base=base, package_dirs=packages or (), mimic=let)
    if as_json:
        findings = [{"subject": f.subject, "verdict": f.verdict.value, "text": f.text} for f in report.findings]
        print_json({"usable": report.usable, "findings": findings})
    else:
        _print_robot(report)
    if not report.usable:
        raise typer.Exit(opt.BAD_INPUT)


def schema() -> None:
    """Print the JSON schema of hydrodynamics.yaml."""
    print_json(RobotDescription.model_json_schema())


def _files(robot: str) -> Path:
    """The path as it is where there is one, or else the folder of the robot of that name."""
    path = Path(robot)
    is_name = robot == path.name and not path.suffix
    return robot_folder(robot) if is_name and not path.exists() else path


def _print_robot(report: RobotReport) -> None:
    table = Table("", "what", "finding", box=None, title=plain_line(report.name), title_justify="left")
    for finding in report.findings:
        table.add_row(finding.verdict.value, cell(finding.subject), cell(finding.text))
    console = console_of()
    console.print(table)
    console.print(plain_line(report.advice), highlight=False)


# ``list``: every name that other commands take.


def list_all(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """List scenarios, robots, plants and solvers."""
    known = {
        "scenarios": list(SCENARIOS),
        "robots": list(list_robots()),
        "plants": list(PLANTS),
        "solvers": list(opt.SOLVERS),
    }
    if as_json:
        print_json(known)
        return
    table = Table("kind", "names", box=None)
    for kind, names in known.items():
        table.add_row(kind, ", ".join(names))
    console_of().print(table)


# ``new-robot`` and ``new-mission``: files to begin with, which run as they are.

_TEMPLATES = Path(str(files("uvms_ocp.scenario"))) / "templates"
_BESIDE = 'uo.load_robot(urdf=ROBOT / "robot.urdf", hydrodynamics=ROBOT / "hydrodynamics.yaml")'


def new_robot(
    out: Annotated[
        Path, typer.Argument(metavar="DIR", parser=opt.folder, help="Folder for robot.urdf and hydrodynamics.yaml.")
    ],
) -> None:
    """Write a robot to begin with: a box of a vehicle with an arm of three joints, with comments.

    \f
    Raises `InvalidInput` for files that are there, `OutputError` where they cannot be written.
    """
    names = ("robot.urdf", "hydrodynamics.yaml")
    _write({out / name: (_TEMPLATES / name).read_text(encoding="utf-8") for name in names})


def new_mission(
    file: Annotated[Path, typer.Argument(metavar="FILE.py", help="The file; what varies goes beside it.")],
    robot: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of your robot; default: bluerov2_alpha5 of the package.")
    ] = None,
) -> None:
    """Write a mission to begin with, and what is uncertain about it, with comments.

    \f
    Raises `InvalidInput` for files that are there or another name, `RobotDataError` for a robot that cannot be loaded,
    whose frames the tasks name, `OutputError` where they cannot be written.
    """
    if file.suffix != ".py":
        raise InvalidInput(f"{file}: give the name of a Python file, such as my_mission.py")
    vary = file.with_name(f"{file.stem}_variations.py")
    text = (_TEMPLATES / "mission.py.txt").read_text(encoding="utf-8")
    place, load = ('"bluerov2_alpha5"', "return uo.load_robot(ROBOT)")
    frames = _frames(None)
    if robot is not None:
        way = os.path.relpath(robot.resolve(), file.resolve().parent).replace(os.sep, "/")
        place, load = f'HERE / "{way}"', f"return {_BESIDE}"
        frames = _frames(robot_of(str(robot)))
    filled = text.format(file=file.name, vary=vary.name, robot=place, load=load, **frames)
    _write({file: filled, vary: (_TEMPLATES / "variations.py.txt").read_text(encoding="utf-8")})


def _frames(robot: Robot | None) -> dict[str, str]:
    """Arguments of the tasks that name frames of the robot, where these are not those that tasks take by themselves."""
    if robot is None:
        return {"vehicle": "", "pose": "", "tool": ""}
    links = [frame.name for frame in robot.model.frames if frame.type == pin.FrameType.BODY]
    vehicle = "" if robot.has_frame("base_link") else f'frame="{links[0]}"'
    tool = "" if robot.has_frame("tool") else f'frame="{links[-1]}", '
    return {"vehicle": vehicle, "pose": vehicle and f"{vehicle}, ", "tool": tool}


def _write(files: dict[Path, str]) -> None:
    """All of them, or none where one is there already."""
    for path in files:
        if path.exists():
            raise InvalidInput(f"{path}: is there already; choose another name, or move it away")
    try:
        for path, text in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: cannot write there ({error.strerror}); choose another place") from error
    print_paths(console_of(), list(files))


# ``export``: what runs without Python.


def controller(
    scenario: Annotated[str, typer.Argument(help=opt.SCENARIO_HELP)],
    out: Annotated[Path, typer.Argument(metavar="DIR", parser=opt.folder, help="Folder for the sources.")],
    plant: Annotated[
        str | None,
        typer.Option(help="dynamic: with thrust and torque; kinematic: velocities alone; default: the scenario's."),
    ] = None,
    robot: opt.RobotName = None,
    hydrodynamics: opt.Hydrodynamics = None,
) -> None:
    """Write the whole controller as C source that needs libm only, with a recorded run to compare with."""
    options = opt.given(plant=plant, robot=robot, hydrodynamics=hydrodynamics)
    console = console_of()
    with console.status("running the scenario once") as status, show_compilation(status.update):
        paths = export_controller(opt.build_scenario(scenario, options), out)
    print_paths(console, paths)
