"""``check-robot``, ``schema``, ``list``, ``new-robot``, ``new-mission`` and ``export``: robot
files, templates and C sources.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from uvms_ocp.cli import options as opt
from uvms_ocp.cli.exit_codes import BAD_INPUT
from uvms_ocp.cli.new_mission import TEMPLATES, NewMission, loading_line, variations_text
from uvms_ocp.cli.printing import busy, cell, console_of, print_json, print_line, print_paths
from uvms_ocp.cli.result_folders import named_folder
from uvms_ocp.errors import InvalidInput, plain_line
from uvms_ocp.export.controller import export_controller
from uvms_ocp.record.meta_values import PLANTS
from uvms_ocp.record.output import as_output_errors
from uvms_ocp.robot import description, list_robots, proposal, robot_folder
from uvms_ocp.robot.loading import robot_called
from uvms_ocp.robot.own_meshes import with_own_meshes
from uvms_ocp.scenario.cases import SCENARIOS
from uvms_ocp.scenario.preflight import robot_check

# ``check-robot`` and ``schema``: robot files.

_Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def check_robot(
    robot: Annotated[
        str,
        typer.Argument(
            help="Robot file (URDF, SDF, MJCF, xacro), a folder with one and hydrodynamics.yaml, or a"
            " name, see `uvms-ocp list`."
        ),
    ],
    files: opt.RobotFiles = opt.AS_WRITTEN,
    as_json: _Json = False,
) -> None:
    """Check a robot: inertias, trim, thruster rank, frames, meshes."""
    report = robot_check.check_robot_files(_files(robot), files.hydrodynamics, **files.loading)
    if as_json:
        findings = [
            {"subject": f.subject, "verdict": f.verdict.value, "text": f.text}
            for f in report.findings
        ]
        print_json({"usable": report.usable, "findings": findings})
    else:
        _print_robot(report)
    if not report.usable:
        raise typer.Exit(BAD_INPUT)


def schema() -> None:
    """Print the JSON schema of hydrodynamics.yaml."""
    print_json(description.RobotDescription.model_json_schema())


def _files(robot: str) -> Path:
    """Return the path as it is where there is one, or else the folder of the robot of that name."""
    path = Path(robot)
    if robot == path.name and not path.suffix and not path.exists():
        return robot_folder(robot)
    return path


def _print_robot(report: robot_check.RobotReport) -> None:
    table = Table(
        "", "what", "finding", box=None, title=plain_line(report.name), title_justify="left"
    )
    for finding in report.findings:
        table.add_row(finding.verdict.value, cell(finding.subject), cell(finding.text))
    console = console_of()
    console.print(table)
    console.print(plain_line(report.advice), highlight=False)


# ``list``: every name that other commands take.


def list_all(as_json: _Json = False) -> None:
    """List scenarios, robots, plants and solvers."""
    names_by_kind = {
        "scenarios": list(SCENARIOS),
        "robots": list(list_robots()),
        "plants": list(PLANTS),
        "solvers": list(opt.SOLVERS),
    }
    if as_json:
        print_json(names_by_kind)
        return
    table = Table("kind", "names", box=None)
    for kind, names in names_by_kind.items():
        table.add_row(kind, ", ".join(names))
    console_of().print(table)


# ``new-robot`` and ``new-mission``: files to begin with, which run as they are.


def new_robot(
    out: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", parser=named_folder, help="Folder for robot.urdf and hydrodynamics.yaml."
        ),
    ],
    source: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="FILE|DIR",
            help="A URDF, SDF, MJCF or xacro, or a folder with one, of whatever maker.",
        ),
    ] = None,
    files: opt.RobotFiles = opt.AS_WRITTEN,
) -> None:
    """Write a robot to begin with: of a robot file, with its roles and water proposed, or a box of a
    vehicle with an arm.

    With --from the folder gets a copy of it as a URDF, its meshes, and a hydrodynamics.yaml in which
    every proposal is marked; what the URDF leaves open is asked in one line each, and answered by
    options.

    \f Raises `InvalidInput` for files that are there, `OutputError` where they cannot be written,
    `RobotDataError` for a URDF that cannot be read.
    """
    if source is None:
        if files != opt.AS_WRITTEN:
            raise InvalidInput("options of a robot's files need one: give --from FILE")
        _write(
            {
                out / name: (TEMPLATES / name).read_text(encoding="utf-8")
                for name in ("robot.urdf", "hydrodynamics.yaml")
            }
        )
        return
    urdf = proposal.find_urdf(source)
    folders = [Path(place) for place in files.packages or ()]
    loading = {
        key: value for key, value in files.loading.items() if key in ("mimic", "lock", "drop")
    }
    if files.meshes is not None:
        loading["meshes"] = "yes" if files.meshes else "no"
    proposed = proposal.propose(
        urdf,
        base=files.base,
        package_dirs=folders,
        loading=loading,
        tool=files.tool_link or (),
        altimeter=files.altimeter,
        dvl=files.dvl,
    )
    urdf_text, meshes = with_own_meshes(urdf, folders)
    _write(
        {out / "robot.urdf": urdf_text, out / "hydrodynamics.yaml": proposed.text},
        {out / target: origin for target, origin in meshes.items()},
    )
    errors = (
        f
        for f in robot_check.check_robot(proposed.robot).findings
        if f.verdict is robot_check.RobotVerdict.ERROR
    )
    for reason in proposed.reasons:
        print_line(console_of(stderr=True), reason)
    _say([*proposed.questions, *(f"{finding.subject}: {finding.text}" for finding in errors)])


def new_mission(
    file: Annotated[
        Path, typer.Argument(metavar="FILE.py", help="The file; what varies goes beside it.")
    ],
    robot: Annotated[
        str | None,
        typer.Option(
            metavar="DIR",
            help="Folder of your robot, or its URDF; default: bluerov2_alpha5 of the package.",
        ),
    ] = None,
    files: opt.RobotFiles = opt.AS_WRITTEN,
) -> None:
    """Write a mission of what the robot has, and what is uncertain about it, with comments.

    \f Raises `InvalidInput` for files that are there or another name, `RobotDataError` for a robot
    that cannot be loaded, whose frames the tasks name, `OutputError` where they cannot be written.
    """
    if file.suffix != ".py":
        raise InvalidInput(f"{file}: give the name of a Python file, such as my_mission.py")
    vary = file.with_name(f"{file.stem}_variations.py")
    name = robot or "bluerov2_alpha5"
    place = repr(name).replace("'", '"')
    load = "return uo.load_robot(ROBOT)"
    if Path(name).exists():
        place, load = loading_line(file, Path(name), files.hydrodynamics, files.loading)
    elif files != opt.AS_WRITTEN:
        load = (
            "return uo.load_robot(ROBOT,"
            f" {', '.join(f'{key}={value!r}' for key, value in files.loading.items())})"
        )
    mission = NewMission(
        robot=robot_called(name, files.hydrodynamics, files.loading), place=place, load=load
    )
    _write({file: mission.text(file, vary), vary: variations_text(mission)})
    _say(mission.notes())


def _say(lines: Iterable[str]) -> None:
    for line in lines:
        print_line(console_of(stderr=True), line, "yellow")


def _write(files: dict[Path, str], originals: Mapping[Path, Path] | None = None) -> None:
    """Write all of them, or none where one is there already; originals: of copies to make."""
    for path in files:
        if path.exists():
            raise InvalidInput(f"{path}: is there already; choose another name, or move it away")
    with as_output_errors(next(iter(files)).parent, "choose another place"):
        for path, text in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        for path, original in (originals or {}).items():
            path.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(original, path)
    print_paths(console_of(), list(files))


# ``export``: what runs without Python.


def controller(
    scenario: Annotated[str, typer.Argument(help=opt.SCENARIO_HELP)],
    out: Annotated[
        Path, typer.Argument(metavar="DIR", parser=named_folder, help="Folder for the sources.")
    ],
    plant: Annotated[
        str | None,
        typer.Option(
            help="dynamic: with thrust and torque; kinematic: velocities alone; default: the scenario's."
        ),
    ] = None,
    robot: opt.RobotName = None,
    files: opt.RobotFiles = opt.AS_WRITTEN,
    name: Annotated[
        str | None,
        typer.Option(
            help="C identifier before all names of the export, another one for each in a program;"
            " by default that of the mission."
        ),
    ] = None,
) -> None:
    """Write the whole controller as C source that needs libm only, with a recorded run to compare
    with.
    """
    console = console_of()
    with busy(console, "running the scenario once"):
        paths = export_controller(
            opt.build_scenario(
                scenario, opt.given_options(plant=plant, robot=robot, **files.options)
            ),
            out,
            name,
        )
    print_paths(console, paths)
