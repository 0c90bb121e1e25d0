"""Command line: ``run``, ``check``, ``mission``, ``compare``, ``plan``, ``list``, ``check-robot`` and ``schema``.

Exit codes: 0 done, 1 internal error, 2 bad input or refused by pre-flight, 3 mission not completed or no plan free of
collision.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from uvms_ocp.campaign import STUDIES
from uvms_ocp.control.export import RecordingSolver, write_tick
from uvms_ocp.control.kinematic import HierarchySolver, KinematicController
from uvms_ocp.exceptions import InvalidInput, NameNotFound, UvmsError
from uvms_ocp.model.check_robot import RobotReport, check_robot_files
from uvms_ocp.model.description import RobotDescription
from uvms_ocp.model.robot import list_robots, load_robot
from uvms_ocp.model.state import Command
from uvms_ocp.output import staged_folder
from uvms_ocp.planning import (
    AXES,
    ObstacleData,
    PlanRequest,
    PlanResult,
    PostureGoal,
    ToolGoal,
    motion_record,
    obstacle_from_words,
    plan_report,
    read_obstacles,
    solve,
)
from uvms_ocp.preflight import PreflightReport, Severity
from uvms_ocp.record import Record
from uvms_ocp.report import compare, summarize
from uvms_ocp.scenario import PLANTS, Scenario
from uvms_ocp.scenarios import SCENARIOS
from uvms_ocp.solvers import Daqp, Icat, LexicographicActiveSet, LexicographicQp

SOLVERS: dict[str, type[HierarchySolver]] = {
    "lexls": LexicographicActiveSet,
    "lexqp": LexicographicQp,
    "icat": Icat,
    "daqp": Daqp,
}
_DEFAULT_SOLVER = "lexls"
BAD_INPUT, NOT_COMPLETED = 2, 3
_PLAN_PERIOD = 0.02  # [s] between rows of plan.csv
_PROGRESS_EVERY = 40  # ticks between two updates of the progress bar

app = typer.Typer(
    help="Task-priority planning of underwater vehicle-manipulator systems.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
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


Name = Annotated[str, typer.Argument(metavar="SCENARIO", help="Scenario, see `uvms-ocp list`.")]
RobotName = Annotated[str | None, typer.Option(help="Robot, see `uvms-ocp list`; default: the scenario's.")]
Plant = Annotated[str | None, typer.Option(help=f"Plant: {', '.join(PLANTS)}; default: the scenario's.")]
SolverName = Annotated[str, typer.Option(help=f"Hierarchy solver: {', '.join(SOLVERS)}.")]
CurrentVelocity = Annotated[
    tuple[float, float, float] | None,
    typer.Option(metavar="X Y Z", help="Uniform current in W [m/s]; default: the scenario's."),
]
Seed = Annotated[int | None, typer.Option(help="Seed of everything random.")]
Noise = Annotated[bool | None, typer.Option("--noise/--no-noise", help="Sensors with noise, rates and delays.")]
Duration = Annotated[float | None, typer.Option(metavar="S", help="Time limit of the mission [s].")]
Out = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the results.")]
Json = Annotated[bool, typer.Option("--json", help="Print the report on stdout, the rest on stderr.")]


@app.command()
def run(
    name: Name = "case1",
    robot: RobotName = None,
    plant: Plant = None,
    solver: SolverName = _DEFAULT_SOLVER,
    current: CurrentVelocity = None,
    seed: Seed = None,
    noise: Noise = None,
    duration: Duration = None,
    out: Out = None,
    force: Annotated[bool, typer.Option("--force", help="Run even if pre-flight finds errors.")] = False,
    as_json: Json = False,
) -> None:
    """Run a scenario or a study; write its record, report, figures and 3-D scene, or its table.

    What is left out is as the scenario has it.
    """
    console = Console(stderr=as_json)
    if name in STUDIES:
        _run_study(name, seed or 0, out, console, as_json)
        return
    options = _given(robot=robot, plant=plant, current=current, seed=seed, noise=noise, duration=duration)
    scenario = _build(name, solver, options)
    folder = out or Path("uvms_runs") / f"{name}-{scenario.plant}-{solver}"
    with staged_folder(folder) as staging:
        preflight = scenario.check()
        print_findings(console, preflight)
        if not (preflight.accepted or force):
            raise InvalidInput(
                f"pre-flight refuses {name} ({len(preflight.errors)} errors); --force runs it all the same"
            )
        record = _simulate(scenario, console)
        report = summarize(record) | {"preflight": preflight.to_dict()}
        with console.status("writing record, report, figures and scene"):
            _write(scenario, record, report, staging)
        written = sorted(path.relative_to(staging) for path in staging.rglob("*") if path.is_file())
    _print_summary(console, report, [folder / path for path in written])
    if as_json:
        sys.stdout.write(json.dumps(report, indent=2) + "\n")
    if not report["completed"]:
        raise typer.Exit(NOT_COMPLETED)


@app.command()
def check(
    name: Name = "case1",
    robot: RobotName = None,
    plant: Plant = None,
    current: CurrentVelocity = None,
    as_json: Json = False,
) -> None:
    """Check whether a mission can be completed, without running it; exit code 2 where it cannot."""
    scenario = _build(name, _DEFAULT_SOLVER, _given(robot=robot, plant=plant, current=current))
    preflight = scenario.check()
    print_findings(Console(stderr=as_json), preflight, notes=True)
    if as_json:
        sys.stdout.write(json.dumps(preflight.to_dict(), indent=2) + "\n")
    if not preflight.accepted:
        raise typer.Exit(BAD_INPUT)


@app.command()
def mission(
    name: Name = "case1",
    mermaid: Annotated[bool, typer.Option("--mermaid", help="Print a state diagram in Mermaid's notation.")] = False,
) -> None:
    """Print which tasks are on in which phase of a scenario, or its phases as a diagram."""
    plan = _build(name, _DEFAULT_SOLVER, {}).mission
    sys.stdout.write(plan.mermaid() if mermaid else f"{plan}\n")


@app.command(name="compare")
def compare_runs(
    first: Annotated[Path, typer.Argument(metavar="A", help="Folder of a run, or its record.npz.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="The other run.")],
    as_json: Json = False,
) -> None:
    """Compare the resources that two runs took."""
    records = [Record.load(path / "record.npz" if path.is_dir() else path) for path in (first, second)]
    rows = compare(records[0], records[1])
    console = Console(stderr=as_json)
    console.print(_table(f"{first} against {second}", rows, ("figure", "first", "second", "change")))
    if as_json:
        sys.stdout.write(json.dumps(rows, indent=2) + "\n")


_Triple = tuple[float, float, float]


@app.command()
def plan(
    tool: Annotated[_Triple | None, typer.Option(metavar="X Y Z", help="Goal of the tool in W [m].")] = None,
    tool_rpy: Annotated[_Triple | None, typer.Option(metavar="R P Y", help="Its orientation; default: any.")] = None,
    joint: Annotated[list[str] | None, typer.Option(metavar="NAME=Q", help="Goal of a joint; repeatable.")] = None,
    to: Annotated[_Triple | None, typer.Option(metavar="X Y Z", help="Goal of the vehicle [m].")] = None,
    to_rpy: Annotated[_Triple | None, typer.Option(metavar="R P Y", help="Goal of its attitude [rad].")] = None,
    position: Annotated[_Triple | None, typer.Option(metavar="X Y Z", help="Start of the vehicle [m].")] = None,
    rpy: Annotated[_Triple | None, typer.Option(metavar="R P Y", help="Attitude at the start [rad].")] = None,
    sphere: Annotated[list[str] | None, typer.Option(metavar="X,Y,Z,R", help="Obstacle; repeatable.")] = None,
    box: Annotated[list[str] | None, typer.Option(metavar="X,Y,Z,LX,LY,LZ", help="Obstacle; repeatable.")] = None,
    obstacles: Annotated[Path | None, typer.Option(metavar="YAML", help="File of obstacles.")] = None,
    robot: Annotated[str, typer.Option(help="Robot, see `uvms-ocp list`.")] = "girona_maris7_full",
    axes: Annotated[str, typer.Option(help=f"Planned axes: {', '.join(AXES)}; level: no roll, no pitch.")] = AXES[0],
    clearance: Annotated[float, typer.Option(metavar="M", help="Distance wanted from everything [m].")] = 0.06,
    seed: Annotated[int, typer.Option(help="Seed of restarts and sampling.")] = 0,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results.")] = Path("uvms_runs/plan"),
    as_json: Annotated[bool, typer.Option("--json", help="Print the report on stdout, the rest on stderr.")] = False,
) -> None:
    """Plan a motion among obstacles to a goal of the tool, the vehicle or joints, from the stowed posture."""
    console, model = Console(stderr=as_json), load_robot(robot)
    request = PlanRequest(
        robot=model,
        start=model.configuration(position=position, rpy=rpy),
        goal=_plan_goal(tool, tool_rpy, PostureGoal(position=to, rpy=to_rpy, joints=_joint_goals(joint or []))),
        obstacles=_plan_obstacles(sphere or [], box or [], obstacles),
        axes=axes,
        clearance=clearance,
        seed=seed,
    )
    with staged_folder(out) as staging:
        with console.status("planning"):
            result = solve(request)
        report = plan_report(result)
        _write_plan(result, report, staging)
        written = sorted(path.relative_to(staging) for path in staging.rglob("*") if path.is_file())
    _print_plan(console, report, [out / path for path in written])
    if as_json:
        sys.stdout.write(json.dumps(report, indent=2) + "\n")
    if not result.collision_free:
        raise typer.Exit(NOT_COMPLETED)


@app.command(name="list")
def list_all(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """List scenarios, robots, plants and solvers."""
    known = {
        "scenarios": list(SCENARIOS),
        "studies": list(STUDIES),
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
        _print_robot(report)
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


def _print_robot(report: RobotReport) -> None:
    table = Table("", "what", "finding", box=None, title=report.name, title_justify="left")
    for finding in report.findings:
        table.add_row(finding.verdict.value, finding.subject, Text(finding.text))
    Console().print(table)


def _run_study(name: str, seed: int, out: Path | None, console: Console, as_json: bool) -> None:
    folder = out or Path("uvms_runs") / name
    with staged_folder(folder) as staging, console.status(name) as status:
        result = STUDIES[name](seed=seed).run(progress=lambda done, n: status.update(f"{name}: {done} of {n} runs"))
        (staging / "report.json").write_text(json.dumps(result.to_dict(), indent=2) + "\n")
        result.write_csv(staging / "runs.csv")
    console.print(_table(result.title, result.table, tuple(result.table[0])))
    console.print(str(folder), markup=False, highlight=False)
    if as_json:
        sys.stdout.write(json.dumps(result.to_dict(), indent=2) + "\n")


def _table(title: str, rows: Sequence[Mapping[str, Any]], columns: tuple[str, ...]) -> Table:
    table = Table(title=title)
    for column in columns:
        table.add_column(column, overflow="fold")
    for row in rows:
        table.add_row(*(_cell(row[column]) for column in columns))
    return table


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _given(**options: Any) -> dict[str, Any]:
    """The options that were given on the command line."""
    return {name: value for name, value in options.items() if value is not None}


def _build(name: str, solver: str, options: dict[str, Any]) -> Scenario:
    """The scenario with the options of the command line; raises `UvmsError` where one is wrong."""
    if name not in SCENARIOS:
        raise NameNotFound("scenario", name, (*SCENARIOS, *STUDIES))
    if solver not in SOLVERS:
        raise NameNotFound("solver", solver, SOLVERS)
    return SCENARIOS[name](solver=SOLVERS[solver](), **options)


def print_findings(console: Console, preflight: PreflightReport, *, notes: bool = False) -> None:
    """Errors and warnings of pre-flight, one per line, and notes if wanted."""
    styles = {Severity.ERROR: "red", Severity.WARNING: "yellow", Severity.NOTE: ""}
    for finding in preflight.findings:
        if notes or finding.severity is not Severity.NOTE:
            where = f" (phase {finding.phase})" if finding.phase else ""
            text = f"{finding.severity.value}: {finding.check}{where}: {finding.text}"
            console.print(text, style=styles[finding.severity], markup=False, highlight=False, soft_wrap=True)
    if notes:
        verdict = "accepted" if preflight.accepted else "refused"
        console.print(f"pre-flight: {verdict}", markup=False, highlight=False)


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


def _joint_goals(words: list[str]) -> dict[str, float]:
    goals = {}
    for word in words:
        name, _, value = word.partition("=")
        try:
            goals[name] = float(value)
        except ValueError:
            raise InvalidInput(f"--joint {word}: give NAME=VALUE, such as joint2=0.5") from None
    return goals


def _plan_goal(tool: _Triple | None, tool_rpy: _Triple | None, posture: PostureGoal) -> ToolGoal | PostureGoal:
    """The one goal that was given."""
    has_posture = bool(posture.joints or posture.position or posture.rpy)
    if (tool is None) != has_posture or (tool is None and tool_rpy is not None):
        raise InvalidInput("give one goal: --tool, with or without --tool-rpy, or any of --to, --to-rpy and --joint")
    return posture if tool is None else ToolGoal(position=tool, rpy=tool_rpy)


def _plan_obstacles(spheres: list[str], boxes: list[str], path: Path | None) -> tuple[ObstacleData, ...]:
    return (
        *(read_obstacles(path) if path else ()),
        *(obstacle_from_words("sphere", words, f"sphere{i}") for i, words in enumerate(spheres, 1)),
        *(obstacle_from_words("box", words, f"box{i}") for i, words in enumerate(boxes, 1)),
    )


def _write_plan(result: PlanResult, report: dict[str, Any], folder: Path) -> None:
    """The report always, the rest where there is a motion; a colliding one is worth looking at."""
    from uvms_ocp.viz import write_plan_figures, write_scene

    (folder / "report.json").write_text(json.dumps(report, indent=2) + "\n")
    if result.plan is None:
        return
    record = motion_record(result, result.plan)
    result.plan.trajectory.to_numpy(folder / "plan.npz")
    result.plan.trajectory.to_csv(folder / "plan.csv", _PLAN_PERIOD, names=result.scene.coordinates.names)
    record.save(folder / "record.npz")
    write_plan_figures(record, folder / "figures")
    write_scene(record, result.request.robot, folder / "scene.html")


def _print_plan(console: Console, report: dict[str, Any], paths: list[Path]) -> None:
    console.print(f"plan: {report['status']}; advice: {report['advice']}", markup=False)
    if "duration_s" in report:
        least = report["min_clearance_m"]
        near = "" if least is None else f", {least:.3g} m between {report['min_clearance_between']} "
        near += "" if least is None else f"at {report['min_clearance_at_s']:.2f} s"
        console.print(f"{report['duration_s']:.1f} s long{near}; found in {report['solve_time_s']:.2f} s", markup=False)
    for path in paths:
        console.print(str(path), markup=False, highlight=False)


def _print_summary(console: Console, report: dict[str, Any], paths: list[Path]) -> None:
    table = Table(title=f"{report['scenario']}, {report['robot']}, {report['plant']} plant, {report['solver']}")
    for column in ("phase", "start [s]", "end [s]", "J", "m"):
        table.add_column(column, no_wrap=True, justify="left" if column == "phase" else "right")
    table.add_column("why it ended, errors at its end")
    for phase in report["phases"]:
        times = (f"{phase['start_s']:.2f}", f"{phase['end_s']:.2f}")
        energy = _cell(phase["energy_j"])
        why = Text("\n").join([Text(phase["reason"]), *(Text(error, style="dim") for error in _active_errors(phase))])
        table.add_row(f"{phase['name']} {phase['title']}", *times, energy, f"{phase['path_length_m']:.2f}", why)
    console.print(table)
    for alarm in report["alarms"]:
        console.print(f"alarm at {alarm['t']:.2f} s: {alarm['text']}", style="yellow", markup=False)
    resources = _transposed(report["resources"])
    console.print(_table("resources", resources, tuple(resources[0])))
    verdict = "complete" if report["completed"] else f"not completed: {report['pending']}"
    console.print(
        f"mission {verdict}; simulated {report['simulated_s']:.1f} s in {report['wall_s']:.1f} s, "
        f"tick p50 {report['tick_us']['p50']:.0f} us",
        markup=False,
    )
    if not report["completed"]:
        console.print(f"cause: {report['cause']['kind']}: {report['cause']['text']}", markup=False)
    for path in paths:
        console.print(str(path), markup=False, highlight=False)


def _transposed(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row per figure that some phase has, one column per visit to a phase."""
    names = [row["phase"] if row["phase"] == "total" else f"{k + 1} {row['phase']}" for k, row in enumerate(rows)]
    figures = [name for name in rows[0] if name != "phase" and any(row[name] is not None for row in rows)]
    values = [[row[figure] for row in rows] for figure in figures]
    return [{"figure": name, **dict(zip(names, row, strict=True))} for name, row in zip(figures, values, strict=True)]
