"""``export``: what runs without Python."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from uvms_ocp.cli.options import build_scenario, folder
from uvms_ocp.cli.printing import console_of, print_paths
from uvms_ocp.control.export import FILES, RecordingSolver, write_tick
from uvms_ocp.output import claimed


def export_tick(
    out: Annotated[Path, typer.Argument(metavar="DIR", parser=folder, help="Folder for the sources.")],
    scenario: Annotated[str, typer.Option(help="Scenario, see `uvms-ocp list`.")] = "case1",
    robot: Annotated[str | None, typer.Option(help="Robot; default: the scenario's.")] = None,
) -> None:
    """Write C source of one control tick, with recorded ticks to compare with; it needs libm only."""
    options = {"plant": "kinematic"} | ({} if robot is None else {"robot": robot})
    made = build_scenario(scenario, options)
    recording = RecordingSolver(solver=made.solver)
    with claimed(out, FILES) as claim:
        replace(made, solver=recording).run()
        with claim.staged() as staging:
            write_tick(made.kinematic_controller().problem, recording.ticks, staging)
        print_paths(console_of(), claim.written())
