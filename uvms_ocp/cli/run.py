"""``run``: simulate a scenario, and write its record, report, figures and scene."""

from __future__ import annotations

import json
import webbrowser
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from uvms_ocp.cli import options as opt, printing
from uvms_ocp.cli.drawing import SCENE, drawer, drawings_of
from uvms_ocp.cli.exit_codes import INTERRUPTED, NOT_COMPLETED
from uvms_ocp.cli.result_folders import default_folder, label
from uvms_ocp.errors import InvalidInput, plain_line, require_known
from uvms_ocp.interrupts import Interrupted
from uvms_ocp.record import durable_files, row_files
from uvms_ocp.record.output import RECORD, RUNNING, claim_folder
from uvms_ocp.record.record import Record
from uvms_ocp.report.summary import format_load, summarize
from uvms_ocp.sim.faults import parse_faults
from uvms_ocp.viz.figure_names import RUN_NAMES

if TYPE_CHECKING:
    from uvms_ocp.mission_plan.mission_plan import MissionPlan
    from uvms_ocp.scenario.scenario import Scenario
    from uvms_ocp.sim.loop import TickObserver

Follow = Annotated[
    Path | None,
    typer.Option(
        metavar="PLAN", help="Plan of this mission, of `plan mission`; the hierarchy takes over."
    ),
]


def run(
    name: opt.Name = "case1",
    changes: opt.ScenarioOptions = opt.AS_IT_IS,
    solver: opt.SolverName = None,
    seed: opt.Seed = None,
    noise: opt.Noise = None,
    duration: opt.Duration = None,
    record_rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="Rows of the record; default: every tick.")
    ] = None,
    fault: opt.Faults = None,
    follow: Follow = None,
    out: opt.Out = None,
    force: Annotated[
        bool, typer.Option("--force", help="Run even if pre-flight finds errors.")
    ] = False,
    live: Annotated[
        bool,
        typer.Option("--live", help="Show it in the browser meanwhile, no faster than the clock."),
    ] = False,
    figures: Annotated[
        str,
        typer.Option(metavar="NAMES", help="What to draw: all, none, or names such as path,scene."),
    ] = "all",
    as_json: opt.Json = False,
) -> None:
    """Run a scenario; write its record, report, figures and 3-D scene.

    What is left out is as the scenario has it.

    \f Raises `InvalidInput` for what pre-flight refuses, unless forced, and for --follow with
    another mission's plan, and `NameNotFound` for a figure that there is not.
    """
    console = printing.console_of(stderr=as_json)
    drawn = _drawing_names(figures)
    options = changes.chosen | opt.given_options(
        noise=noise, seed=seed, duration=duration, record_rate=record_rate
    )
    if fault:
        options |= {"faults": parse_faults(fault)}
    scenario = opt.build_scenario(name, options, solver)
    from uvms_ocp.sim.own_parts import plant_name

    folder_parts = [
        label(name),
        plant_name(scenario.plant),
        opt.solver_name(scenario.solver),
    ]
    if follow is None:
        plan = None
    else:
        plan = _plan_of(scenario, follow)
        folder_parts.append("followed")
    other_options = {key: value for key, value in options.items() if key != "plant"}
    folder = out or default_folder(folder_parts, other_options)
    report = run_and_write(
        scenario, folder, console, force=force, plan=plan, live=live, drawn=drawn
    )
    if as_json:
        printing.print_json(report)
    ending = report["cause"]["kind"]
    if ending == "stopped":
        raise typer.Exit(INTERRUPTED)
    if ending != "completed":
        raise typer.Exit(NOT_COMPLETED)


def run_and_write(
    scenario: Scenario,
    out: Path,
    console: Console,
    *,
    force: bool = True,
    plan: MissionPlan | None = None,
    live: bool = False,
    drawn: Iterable[str] | None = None,
) -> dict[str, Any]:
    """Run a scenario, by a plan if given, write all that comes of it into a folder, print a
    summary; returns its report.

    The record grows on the disk, and is safe before anything is made of it; Ctrl-C ends the
    simulation, and what was flown is written. What a run that was cut off left is kept as
    ``cut_off.npz``. live: show it in the browser meanwhile. drawn: names of figures, and ``scene``;
    all of them by default.

    Raises `InvalidInput` for what pre-flight refuses, unless forced.
    """
    running = out / RUNNING
    figures = tuple(f"figures/{name}.png" for name in RUN_NAMES)
    files = (RECORD, "report.json", "scene.html", *figures)
    drawing_names: tuple[str, ...] = (SCENE, *RUN_NAMES)
    if drawn is not None:
        drawing_names = tuple(drawn)
    with claim_folder(out, files) as claim, drawer(needed=bool(drawing_names)) as draw:
        preflight = scenario.check()
        printing.require_accepted(preflight, scenario.name, console, force=force)
        if (running / row_files.META).is_file():
            _keep_cut_off(running, out / "cut_off.npz", console)
        durable_files.discard(running)
        watch = _watched(scenario, console) if live else nullcontext()
        with watch as observer:
            record = _simulate(scenario, plan, console, observer, running)
        with claim.staged() as staging:
            record.save(staging / RECORD)
        durable_files.discard(running)
        report = summarize(record) | {"preflight": preflight.to_dict()}
        with claim.staged(keep=[RECORD]) as staging:
            (staging / "report.json").write_text(json.dumps(report, indent=2) + "\n")
            (staging / "figures").mkdir()
            ghosts = {}
            if plan is not None and SCENE in drawing_names:
                ghosts["plan"] = plan.to_record(scenario)
            drawings = drawings_of(record, scenario.robot, staging, drawing_names, ghosts)
            not_drawn = draw(drawings, console.status("writing report, figures and scene"))
        written = claim.written()
    _print_summary(console, report, written)
    for line in not_drawn:
        console.print(line, style="yellow", markup=False)
    return report


def _keep_cut_off(running: Path, target: Path, console: Console) -> None:
    """Keep what a run that was cut off left in the folder `running`: as a record, or moved aside
    where it cannot be read.
    """
    try:
        Record.load(running).save(target)
    except InvalidInput as error:
        aside = running.with_name("damaged")
        durable_files.discard(aside)
        running.rename(aside)
        console.print(f"{error}; moved to {aside}", style="yellow", markup=False)


def _plan_of(scenario: Scenario, place: Path) -> MissionPlan:
    """Return a plan of that scenario, from its file or the folder that holds it. Raises
    `InvalidInput`.
    """
    from uvms_ocp.mission_plan.mission_plan import MissionPlan  # a tenth of a second

    plan = MissionPlan.load(place / "plan.npz" if place.is_dir() else place)
    plan.require_of(scenario)
    return plan


@contextmanager
def _watched(scenario: Scenario, console: Console) -> Iterator[TickObserver]:
    """Return the live view of a run in the browser."""
    from uvms_ocp.viz.scene.live import live

    with console.status("drawing"):
        view = live(scenario)
    with view:
        console.print(f"{view.address} shows it", highlight=False)
        webbrowser.open(view.address)
        yield view


def _simulate(
    scenario: Scenario,
    plan: MissionPlan | None,
    console: Console,
    observer: TickObserver | None,
    folder: Path,
) -> Record:
    """Run the scenario, and show what is compiled before; a run that Ctrl-C ends is returned as far
    as it came.
    """
    with printing.busy(console, "building the controller"):
        if plan is None:
            controller = scenario.controller()
        else:
            controller = plan.controller(scenario)
    try:
        return scenario.run(None, controller, observer, folder)
    except Interrupted as stop:
        return cast(Record, stop.result)


def _drawing_names(words: str) -> list[str]:
    """Return the drawings that ``--figures`` names: all, none, or names with commas.

    Raises `NameNotFound` for an unknown name.
    """
    known = [SCENE, *RUN_NAMES]
    if words == "all":
        return known
    if words == "none":
        return []
    names = [name.strip() for name in words.split(",")]
    # A single word may also have been meant for all or none.
    allowed = ["all", "none", *known] if len(names) == 1 else known
    for name in names:
        require_known("figure", name, allowed)
    return names


def _print_summary(console: Console, report: dict[str, Any], paths: list[Path]) -> None:
    _print_phases(console, report)
    _print_what_went_wrong(console, report)
    for tool, load in report["loads"].items():
        console.print(format_load(load, tool))
    resources = _transposed(report["resources"])
    console.print(printing.table_of("resources", resources, tuple(resources[0])))
    cause = report["cause"]
    if not report["completed"]:
        verdict = plain_line(f"not completed: {report['pending']}")
    elif cause["kind"] == "completed":
        verdict = "complete"
    elif cause["kind"] == "tilted":
        verdict = "complete, but not level"
    else:
        verdict = "complete by the estimate alone"
    times = f"simulated {report['simulated_s']:.1f} s in {report['wall_s']:.1f} s"
    tick_times = f"tick p50 {report['tick_us']['p50']:.0f} us"
    if report["controller_us"]:
        tick_times += f", whole controller {report['controller_us']['p50']:.0f} us"
    tilt = f"largest tilt {printing.cell(report['largest_tilt_rad'])} rad"
    console.print(f"mission {verdict}; {times}, {tick_times}, {tilt}")
    if cause["kind"] != "completed":
        console.print(plain_line(f"cause: {cause['kind']}: {cause['text']}"))
    printing.print_paths(console, paths)


def _print_phases(console: Console, report: dict[str, Any]) -> None:
    """Print a table of the phases, and why each ended, with the errors at its end below."""
    title = f"{report['scenario']}, {report['robot']}, {report['plant']} plant, {report['solver']}"
    table = Table(title=plain_line(title))
    table.add_column("phase", no_wrap=True, justify="left")
    for column in ("start [s]", "end [s]", "J", "m"):
        table.add_column(column, no_wrap=True, justify="right")
    for phase in report["phases"]:
        table.add_row(
            plain_line(f"{phase['name']} {phase['title']}", 40),
            f"{phase['start_s']:.2f}",
            f"{phase['end_s']:.2f}",
            printing.cell(phase["energy_j"]),
            f"{phase['path_length_m']:.2f}",
        )
    console.print(table)
    for phase in report["phases"]:
        console.print(Text(plain_line(f"{phase['name']} ended: {phase['reason']}")))
        errors = "; ".join(_active_errors(phase))
        if errors:
            text = Text(plain_line(errors), style="dim")
            console.print(Padding(text, (0, 0, 0, 4)))


def _active_errors(phase: dict[str, Any]) -> Iterator[str]:
    """Yield errors of the tasks that the phase had turned on: as estimated, and where sensors are
    noisy the truth beside it.
    """
    for name, value in phase["final_errors"].items():
        task, _, quantity = name.rpartition(".")
        if task not in phase["tasks"] or "error" not in quantity:
            continue
        text = f"{name} {printing.cell(value)}"
        allowed = phase["sensors_allow"].get(name)
        if allowed is not None:
            true_value = printing.cell(phase["true_errors"].get(name))
            text += f", true {true_value}, sensors allow {allowed:.2g}"
        yield text


def _print_what_went_wrong(console: Console, report: dict[str, Any]) -> None:
    """Print faults that were asked for, alarms, joints that were too fast or lay against their stops,
    and channels that were not always good; a line each.
    """
    for fault in report["faults"]:
        until = "" if fault["end"] is None else f" to {fault['end']:g} s"
        console.print(f"fault from {fault['t']:g} s{until}: {fault['text']}", style="yellow")
    for alarm in report["alarms"]:
        console.print(plain_line(f"alarm at {alarm['t']:.2f} s: {alarm['text']}"), style="yellow")
    for row in report["passed_rates"]:
        rate = f"{row['rate']:.3g} {row['unit']}"
        limit = f"{row['share']:.2f} times its limit"
        text = f"joint {row['joint']} moved at {rate} at {row['t']:.2f} s, {limit}"
        console.print(plain_line(text), style="yellow")
    for row in report["pressed_stops"]:
        text = f"joint {row['joint']} lay against its stop for {row['duration']:.2g} s"
        excess = f"{row['excess']:.2g} {row['unit']} beyond its limit at most"
        console.print(plain_line(f"{text}, from {row['t']:.2f} s on, {excess}"), style="yellow")
    for row in report["sensor_health"]:
        if row["first_s"] is None:
            continue
        spans = f"suspect for {row['suspect_s']:.2f} s, lost for {row['lost_s']:.2f} s"
        text = f"{row['channel']} {spans}, first at {row['first_s']:.2f} s: {row['why']}"
        console.print(plain_line(text), style="yellow")


def _transposed(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row per figure that some phase has, one column per visit to a phase and one for
    the total; energy that is not known has its row too.

    rows: of `uvms_ocp.report.phase_resources.resources`.
    """
    visits = [f"{number} {row['phase']}" for number, row in enumerate(rows[:-1], 1)]
    columns = [*visits, rows[-1]["phase"]]
    shown = set()
    for row in rows:
        shown |= {name for name, value in row.items() if value is not None}
    if "joint_energy_j" in shown:
        shown |= {"thruster_energy_j", "energy_j"}
    transposed = list[dict[str, Any]]()
    for figure in rows[0]:
        if figure == "phase" or figure not in shown:
            continue
        values = [row[figure] for row in rows]
        transposed.append({"figure": figure, **dict(zip(columns, values, strict=True))})
    return transposed
