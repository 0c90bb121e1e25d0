"""``export``: what runs without Python."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from uvms_ocp.cli.compiling import told_of_compiling
from uvms_ocp.cli.options import SCENARIO_HELP, Hydrodynamics, RobotName, build_scenario, folder, given
from uvms_ocp.cli.printing import console_of, print_paths
from uvms_ocp.export import export_controller


def controller(
    scenario: Annotated[str, typer.Argument(help=SCENARIO_HELP)],
    out: Annotated[Path, typer.Argument(metavar="DIR", parser=folder, help="Folder for the sources.")],
    plant: Annotated[
        str | None,
        typer.Option(help="dynamic: with thrust and torque; kinematic: velocities alone; default: the scenario's."),
    ] = None,
    robot: RobotName = None,
    hydrodynamics: Hydrodynamics = None,
) -> None:
    """Write the whole controller as C source that needs libm only, with a recorded run to compare with."""
    options = given(plant=plant, robot=robot, hydrodynamics=hydrodynamics)
    console = console_of()
    with console.status("running the scenario once") as status, told_of_compiling(status.update):
        paths = export_controller(build_scenario(scenario, options), out)
    print_paths(console, paths)
