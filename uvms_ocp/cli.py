"""Command line: ``uvms-ocp run`` and ``uvms-ocp list``.

Exit codes: 0 done, 1 internal error, 2 bad input, 3 mission not completed.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from uvms_ocp.control.export import RecordingSolver, write_tick
from uvms_ocp.control.kinematic import HierarchySolver, KinematicController
from uvms_ocp.exceptions import NameNotFound, UvmsError
from uvms_ocp.model.check_robot import RobotReport, check_robot_files
from uvms_ocp.model.description import RobotDescription
from uvms_ocp.model.robot import list_robots
from uvms_ocp.model.state import Command
from uvms_ocp.output import staged_folder
from uvms_ocp.record import Record
from uvms_ocp.report import summarize
from uvms_ocp.scenario import PLANTS, Scenario
from uvms_ocp.scenarios import SCENARIOS
from uvms_ocp.solvers import Icat, LexicographicActiveSet, LexicographicQp

SOLVERS: dict[str, type[HierarchySolver]] = {
    "lexls": LexicographicActiveSet,
    "lexqp": LexicographicQp,
    "icat": Icat,
}
BAD_INPUT, NOT_COMPLETED = 2, 3
_PROGRESS_EVERY = 40  # ticks between two updates of the progress bar

app = typer.Typer(
    help="Task-priority planning of underwater vehicle-manipulator systems.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

export_app = typer.Typer(help="Write what runs without Python.", no_args_is_help=True)
app.add_typer(export_app, name="export")


def main() -> None:
    """Entry point of the console script."""
    try:
        app()
    except UvmsError as error:
        Console(stderr=True, soft_wrap=True, highlight=False).print(f"error: {error}", style="red", markup=False)
        sys.exit(BAD_INPUT)


@app.command()
def run(
    name: Annotated[str, typer.Argument(metavar="SCENARIO", help="Scenario to run, see `uvms-ocp list`.")] = "case1",
    robot: Annotated[str | None, typer.Option(help="Robot, see `uvms-ocp list`; default: the scenario's.")] = None,
    plant: Annotated[str, typer.Option(help=f"Plant: {', '.join(PLANTS)}.")] = PLANTS[0],
    solver: Annotated[str, typer.Option(help=f"Hierarchy solver: {', '.join(SOLVERS)}.")] = "lexls",
    current: Annotated[
        tuple[float, float, float] | None, typer.Option(metavar="X Y Z", help="Uniform current in W [m/s].")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of everything random.")] = None,
    noise: Annotated[
        bool | None, typer.Option("--noise/--no-noise", help="Sensors with noise, rates and delays.")
    ] = None,
    duration: Annotated[float | None, typer.Option(metavar="S", help="Time limit of the mission [s].")] = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the results.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report on stdout, the rest on stderr.")] = False,
) -> None:
    """Run a scenario; write its record, report, figures and 3-D scene. What is left out is as the scenario has it."""
    console = Console(stderr=as_json)
    given = {"robot": robot, "plant": plant, "current": current, "seed": seed, "noise": noise, "duration": duration}
    scenario = _build(name, solver, {option: value for option, value in given.items() if value is not None})
    folder = out or Path("uvms_runs") / f"{name}-{plant}-{solver}"
    with staged_folder(folder) as staging:
        record = _simulate(scenario, console)
        report = summarize(record)
        with console.status("writing record, report, figures and scene"):
            _write(scenario, record, report, staging)
        written = sorted(path.relative_to(staging) for path in staging.rglob("*") if path.is_file())
    _print_summary(console, report, [folder / path for path in written])
    if as_json:
        sys.stdout.write(json.dumps(report, indent=2) + "\n")
    if not report["completed"]:
        raise typer.Exit(NOT_COMPLETED)


@app.command(name="list")
def list_all(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """List scenarios, robots, plants and solvers."""
    known = {
        "scenarios": list(SCENARIOS),
        "robots": list(list_robots()),
        "plants": list(PLANTS),
        "solvers": list(SOLVERS),
    }
    if as_json:
        sys.stdout.write(json.dumps(known, indent=2) + "\n")
        return
    table = Table("kind", "names", box=None)
    for kind, names in known.items():
        table.add_row(kind, ", ".join(names))
    Console().print(table)


def _active_errors(phase: dict[str, Any]) -> Iterator[str]:
    """Errors of the tasks that the phase had turned on."""
    for name, value in phase["final_errors"].items():
        task, quantity = name.split(".")
        if task in phase["tasks"] and "error" in quantity:
            yield f"{name} {value:.3g}"


@app.command(name="check-robot")
def check_robot(
    path: Annotated[Path, typer.Argument(help="URDF, or a folder with robot.urdf and hydrodynamics.yaml.")],
    hydrodynamics: Annotated[Path | None, typer.Option(metavar="YAML", help="Hydrodynamics file.")] = None,
    fixed: Annotated[bool, typer.Option("--fixed", help="The base does not float.")] = False,
    packages: Annotated[
        list[Path] | None, typer.Option("--packages", metavar="DIR", help="Where package:// meshes are; repeatable.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Check a robot: inertias, trim, thruster rank, frames, meshes."""
    report = check_robot_files(path, hydrodynamics, base="fixed" if fixed else None, package_dirs=packages or ())
    if as_json:
        findings = [{"subject": f.subject, "verdict": f.verdict.value, "text": f.text} for f in report.findings]
        sys.stdout.write(json.dumps({"usable": report.usable, "findings": findings}, indent=2) + "\n")
    else:
        _print_findings(report)
    if not report.usable:
        raise typer.Exit(BAD_INPUT)


@export_app.command(name="tick")
def export_tick(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for the sources.")],
    scenario: Annotated[str, typer.Option(help="Scenario, see `uvms-ocp list`.")] = "case1",
    robot: Annotated[str | None, typer.Option(help="Robot; default: the scenario's.")] = None,
) -> None:
    """Write C source of one control tick, with recorded ticks to compare with; it needs libm only."""
    options = {"plant": "kinematic"} | ({} if robot is None else {"robot": robot})
    made = _build(scenario, "lexls", options)
    recording = RecordingSolver(solver=made.solver)
    with staged_folder(folder) as staging:
        replace(made, solver=recording).run()
        write_tick(made.controller().problem, recording.ticks, staging)
        written = sorted(path.name for path in staging.iterdir())
    console = Console()
    for name in written:
        console.print(str(folder / name), markup=False, highlight=False)


@app.command()
def schema() -> None:
    """Print the JSON schema of hydrodynamics.yaml."""
    sys.stdout.write(json.dumps(RobotDescription.model_json_schema(), indent=2) + "\n")


def _print_findings(report: RobotReport) -> None:
    table = Table("", "what", "finding", box=None, title=report.name, title_justify="left")
    for finding in report.findings:
        table.add_row(finding.verdict.value, finding.subject, Text(finding.text))
    Console().print(table)


def _build(name: str, solver: str, options: dict[str, Any]) -> Scenario:
    """The scenario with the options of the command line; raises `UvmsError` where one is wrong."""
    if name not in SCENARIOS:
        raise NameNotFound("scenario", name, SCENARIOS)
    if solver not in SOLVERS:
        raise NameNotFound("solver", solver, SOLVERS)
    return SCENARIOS[name](solver=SOLVERS[solver](), **options)


def _simulate(scenario: Scenario, console: Console) -> Record:
    """Run with a progress bar that names the phase and what it waits for."""
    with _progress(console) as progress:
        task = progress.add_task("", total=scenario.duration, waiting="")

        def show(t: float, command: Command, controller: KinematicController) -> None:
            if round(t / scenario.dt) % _PROGRESS_EVERY == 0 or command.finished:
                phase = scenario.mission.phases[controller.state.phase]
                waiting = "complete" if command.finished else controller.pending()
                done = scenario.duration if command.finished else t
                progress.update(task, completed=done, description=f"{phase.name} {phase.title}", waiting=waiting)

        return scenario.run(show)


@contextmanager
def _progress(console: Console) -> Iterator[Progress]:
    columns = (
        TextColumn("[bold]{task.description:<14}"),
        BarColumn(bar_width=24),
        TimeElapsedColumn(),
        TextColumn("{task.fields[waiting]}", markup=False),
    )
    with Progress(*columns, console=console) as progress:
        yield progress


def _write(scenario: Scenario, record: Record, report: dict[str, Any], folder: Path) -> None:
    from uvms_ocp.viz import write_figures, write_scene

    record.save(folder / "record.npz")
    (folder / "report.json").write_text(json.dumps(report, indent=2) + "\n")
    (folder / "figures").mkdir()
    write_figures(record, folder / "figures")
    write_scene(record, scenario.robot, folder / "scene.html")


def _print_summary(console: Console, report: dict[str, Any], paths: list[Path]) -> None:
    table = Table(title=f"{report['scenario']}, {report['robot']}, {report['plant']} plant, {report['solver']}")
    for column in ("phase", "start [s]", "end [s]", "J", "m"):
        table.add_column(column, no_wrap=True, justify="left" if column == "phase" else "right")
    table.add_column("why it ended, errors at its end")
    for phase in report["phases"]:
        times = (f"{phase['start_s']:.2f}", f"{phase['end_s']:.2f}")
        energy = f"{phase['energy_j']:.0f}" if "energy_j" in phase else "-"
        why = Text("\n").join([Text(phase["reason"]), *(Text(error, style="dim") for error in _active_errors(phase))])
        table.add_row(f"{phase['name']} {phase['title']}", *times, energy, f"{phase['path_length_m']:.2f}", why)
    console.print(table)
    for alarm in report["alarms"]:
        console.print(f"alarm at {alarm['t']:.2f} s: {alarm['text']}", style="yellow", markup=False)
    verdict = "complete" if report["completed"] else f"not completed: {report['pending']}"
    console.print(
        f"mission {verdict}; simulated {report['simulated_s']:.1f} s in {report['wall_s']:.1f} s, "
        f"tick p50 {report['tick_us']['p50']:.0f} us",
        markup=False,
    )
    for path in paths:
        console.print(str(path), markup=False, highlight=False)
