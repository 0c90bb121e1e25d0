"""``check-robot`` and ``schema``: robot files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, cast

import typer
from rich.table import Table

from uvms_ocp.cli.options import BAD_INPUT
from uvms_ocp.cli.printing import cell, console_of, print_json
from uvms_ocp.exceptions import plain_line
from uvms_ocp.model.files.description import RobotDescription
from uvms_ocp.model.files.library import robot_folder
from uvms_ocp.preflight.robot_check import RobotReport, check_robot_files


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
        raise typer.Exit(BAD_INPUT)


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
