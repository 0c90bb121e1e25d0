"""``plan mission``: all phases of a scenario as one problem, for ``run --follow``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from uvms_ocp.cli.options import (
    NOT_COMPLETED,
    CurrentVelocity,
    Hydrodynamics,
    Json,
    Name,
    Noise,
    Out,
    PlantName,
    RobotName,
    Seabed,
    build_scenario,
    default_folder,
    given,
    label,
)
from uvms_ocp.cli.printing import console_of, print_json, print_paths, table_of
from uvms_ocp.exceptions import plain_line
from uvms_ocp.mission_plan import MissionPlan, plan_mission
from uvms_ocp.mission_plan.planning import OPTIONS
from uvms_ocp.output import claimed
from uvms_ocp.solvers.nlp.nlp_options import PLUGINS, NlpOptions

_FILES = ("plan.npz", "report.json")
_COLUMNS = ("name", "begin_s", "end_s")


def mission(
    name: Name,
    robot: RobotName = None,
    hydrodynamics: Hydrodynamics = None,
    plant: PlantName = None,
    current: CurrentVelocity = None,
    seabed: Seabed = None,
    noise: Noise = None,
    within: Annotated[
        float | None, typer.Option(metavar="S", help="Longest duration [s]; default: that of the greedy mission.")
    ] = None,
    step: Annotated[float, typer.Option(metavar="S", help="Step of the horizon [s].")] = 1.0,
    time_limit: Annotated[float, typer.Option(metavar="S", help="Time limit of each solve [s].")] = OPTIONS.time_limit,
    nlp: Annotated[str, typer.Option(help=f"Solver: {' or '.join(PLUGINS)}.")] = OPTIONS.plugin,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """A whole mission as one problem of least energy.

    Current, obstacles, floor and all limits included; `run SCENARIO --follow DIR/plan.npz` flies it, with the same options.
    """
    console = console_of(stderr=as_json)
    options = given(robot=robot, hydrodynamics=hydrodynamics, plant=plant, current=current, seabed=seabed, noise=noise)
    scenario = build_scenario(name, options)
    solver = _options(nlp, time_limit)
    with claimed(out or default_folder(("plan", "mission", label(name)), options), _FILES) as claim:
        with console.status(f"planning {name}"):
            found = plan_mission(scenario, duration=within, step=step, options=solver)
        with claim.staged() as staging:
            _write(found, staging)
        written = claim.written()
    _print(console, found, written)
    if as_json:
        print_json(found.summary())
    if not found.solved:
        raise typer.Exit(NOT_COMPLETED)


def _options(plugin: str, time_limit: float) -> NlpOptions:
    return NlpOptions(
        plugin=plugin,
        time_limit=time_limit,
        max_iterations=OPTIONS.max_iterations,
        convergence=OPTIONS.convergence,
        barrier=OPTIONS.barrier,
    )


def _write(found: MissionPlan, folder: Path) -> None:
    """The report always, a plan that can be flown beside it."""
    (folder / "report.json").write_text(json.dumps(found.summary(), indent=2) + "\n")
    if found.status.usable:
        found.save(folder / "plan.npz")


def _print(console: Console, found: MissionPlan, paths: list[Path]) -> None:
    report: dict[str, Any] = found.summary()
    console.print(plain_line(f"plan: {report['status']} ({report['reason']}); advice: {report['advice']}"))
    if found.status.usable:
        console.print(table_of(f"{found.scenario} as one problem", report["phases"], _COLUMNS))
        energy = "- J (not known)" if found.energy is None else f"{found.energy:.0f} J"
        greedy = f"greedy {found.greedy_duration:.1f} s"
        console.print(
            f"{found.duration:.1f} s ({greedy}), {energy}, thrust up to {found.peak_thrust:.0f} N; "
            f"{found.iterations} iterations, found in {found.solve_time:.1f} s"
        )
    print_paths(console, paths)
