"""``check`` and ``mission``: look at a mission without running it."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from uvms_ocp.cli.options import (
    BAD_INPUT,
    CurrentVelocity,
    Hydrodynamics,
    Json,
    Name,
    PlantName,
    RobotName,
    Seabed,
    build_scenario,
    given,
)
from uvms_ocp.cli.printing import console_of, print_findings, print_json


def check(
    name: Name = "case1",
    robot: RobotName = None,
    hydrodynamics: Hydrodynamics = None,
    plant: PlantName = None,
    current: CurrentVelocity = None,
    seabed: Seabed = None,
    as_json: Json = False,
) -> None:
    """Check whether a mission can be completed, without running it; exit code 2 where it cannot."""
    options = given(robot=robot, hydrodynamics=hydrodynamics, plant=plant, current=current, seabed=seabed)
    scenario = build_scenario(name, options)
    preflight = scenario.check()
    print_findings(console_of(stderr=as_json), preflight, notes=True)
    if as_json:
        print_json(preflight.to_dict())
    if not preflight.accepted:
        raise typer.Exit(BAD_INPUT)


def mission(
    name: Name = "case1",
    robot: RobotName = None,
    hydrodynamics: Hydrodynamics = None,
    mermaid: Annotated[bool, typer.Option("--mermaid", help="Print a state diagram in Mermaid's notation.")] = False,
) -> None:
    """Print which tasks are on in which phase of a scenario, or its phases as a diagram."""
    plan = build_scenario(name, given(robot=robot, hydrodynamics=hydrodynamics)).mission
    sys.stdout.write(plan.mermaid() if mermaid else f"{plan}\n")
