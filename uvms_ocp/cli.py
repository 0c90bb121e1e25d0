"""Command line: ``uvms-ocp run`` and ``uvms-ocp list``.

Exit codes: 0 done, 1 internal error, 2 bad input, 3 mission not completed.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from uvms_ocp.control.kinematic import HierarchySolver, KinematicController
from uvms_ocp.exceptions import NameNotFound, UvmsError
from uvms_ocp.model.robot import list_robots
from uvms_ocp.model.state import Command
from uvms_ocp.output import staged_folder
from uvms_ocp.record import Record
from uvms_ocp.report import summarize
from uvms_ocp.scenario import PLANTS, Scenario
from uvms_ocp.scenarios import SCENARIOS
from uvms_ocp.solvers import Icat, LexicographicQp

SOLVERS: dict[str, type[HierarchySolver]] = {"lexqp": LexicographicQp, "icat": Icat}
BAD_INPUT, NOT_COMPLETED = 2, 3
_PROGRESS_EVERY = 40  # ticks between two updates of the progress bar

app = typer.Typer(
    help="Task-priority planning of underwater vehicle-manipulator systems.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


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
    plant: Annotated[str, typer.Option(help=f"Plant: {', '.join(PLANTS)}.")] = "kinematic",
    solver: Annotated[str, typer.Option(help=f"Hierarchy solver: {', '.join(SOLVERS)}.")] = "lexqp",
    duration: Annotated[float, typer.Option(metavar="S", help="Time limit of the mission [s].")] = 120.0,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the results.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report on stdout, the rest on stderr.")] = False,
) -> None:
    """Run a scenario; write its record, report, figures and 3-D scene."""
    console = Console(stderr=as_json)
    scenario = _build(name, robot=robot, plant=plant, solver=solver, duration=duration)
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


def _build(name: str, *, robot: str | None, plant: str, solver: str, duration: float) -> Scenario:
    """The scenario with the options of the command line; raises `UvmsError` where one is wrong."""
    if name not in SCENARIOS:
        raise NameNotFound("scenario", name, SCENARIOS)
    if solver not in SOLVERS:
        raise NameNotFound("solver", solver, SOLVERS)
    options: dict[str, Any] = {} if robot is None else {"robot": robot}
    return SCENARIOS[name](plant=plant, solver=SOLVERS[solver](), duration=duration, **options)


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
    for column in ("phase", "start [s]", "end [s]", "why it ended", "errors at its end"):
        table.add_column(column, overflow="fold")
    for phase in report["phases"]:
        errors = ", ".join(f"{name} {value:.3g}" for name, value in phase["final_errors"].items() if "error" in name)
        times = (f"{phase['start_s']:.2f}", f"{phase['end_s']:.2f}")
        table.add_row(f"{phase['name']} {phase['title']}", *times, phase["reason"], errors)
    console.print(table)
    verdict = "complete" if report["completed"] else f"not completed: {report['pending']}"
    console.print(
        f"mission {verdict}; simulated {report['simulated_s']:.1f} s in {report['wall_s']:.1f} s, "
        f"tick p50 {report['tick_us']['p50']:.0f} us",
        markup=False,
    )
    for path in paths:
        console.print(str(path), markup=False, highlight=False)
