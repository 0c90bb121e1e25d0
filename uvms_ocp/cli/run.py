"""``run``: simulate a scenario, and write its record, report, figures and scene."""

from __future__ import annotations

import ctypes
import gc
import json
import os
import signal
import sys
import warnings
import webbrowser
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import partial
from importlib import import_module
from multiprocessing import active_children, get_context
from pathlib import Path
from pickle import PicklingError
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from uvms_ocp.cli import INTERRUPTED, NOT_COMPLETED, options as opt, printing
from uvms_ocp.errors import InvalidInput, OutputError, plain_line, require_known
from uvms_ocp.interrupts import Interrupted
from uvms_ocp.record import durable_files, row_files
from uvms_ocp.record.output import RECORD, RUNNING, claim_folder
from uvms_ocp.record.record import Record
from uvms_ocp.report.summary import format_load, summarize
from uvms_ocp.robot.robot import Robot
from uvms_ocp.sim.faults import parse_faults
from uvms_ocp.viz.series import RUN_NAMES, thinned

if TYPE_CHECKING:
    from uvms_ocp.mission_plan.mission_plan import MissionPlan
    from uvms_ocp.scenario.scenario import Scenario
    from uvms_ocp.sim.loop import TickObserver

# What writes figures and scenes, shared by copies of this process: Matplotlib and meshcat keep one
# processor busy each.

Job = Callable[[], object]
# that draw at a time; `PR_SET_PDEATHSIG` of Linux
_COPIES = 2
_DIE_WITH_PARENT = 1

_DRAWINGS = dict[str, Job]()
"""Jobs of a copy of the process, which its own copies find here: they need not be sent."""

Follow = Annotated[
    Path | None,
    typer.Option(
        metavar="PLAN", help="Plan of this mission, of `plan mission`; the hierarchy takes over."
    ),
]

SCENE = "scene"


@contextmanager
def drawer(*, needed: bool = True) -> Iterator[Callable[..., list[str]]]:
    """Yield what writes all figures and scenes: one that fails costs no other, and is returned as a
    line that says why.

    It takes the functions that write them, by name, each of which may be called twice, and the
    status to show meanwhile; what the disk refuses is raised. On Linux, with processors for them,
    copies of this process write: until then the first imports what draws, which takes half a
    second, and the others are copied from it.
    """
    in_copies = needed and sys.platform == "linux" and (os.cpu_count() or 1) >= _COPIES
    pool = ProcessPoolExecutor(
        1, get_context("fork" if in_copies else None), _load_drawing, (os.getpid(),)
    )
    earlier_children = active_children()
    with warnings.catch_warnings(
        action="ignore", category=DeprecationWarning
    ):  # of threads of libraries, which wait for work
        if in_copies:
            pool.submit(int)  # which begins it
    copies = set(active_children()).difference(earlier_children)

    def draw(
        drawings: Mapping[str, Job], status: AbstractContextManager[object] | None = None
    ) -> list[str]:
        with (
            status or nullcontext(),
            suppress(BrokenProcessPool, PicklingError, AttributeError, TypeError),
        ):
            if in_copies:
                return pool.submit(_draw_in_copies, drawings).result()
        return [
            *filter(None, map(_attempt, drawings, drawings.values()))
        ]  # or a copy was killed, or cannot be sent something

    try:
        yield draw
    finally:
        for copy in copies:
            copy.kill()
        pool.shutdown(cancel_futures=True)


def _load_drawing(parent: int) -> None:
    _end_with(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # what is stopped by hand is drawn
    sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115 - for as long as the copy lives
    for module in ("run_figures", "scene.show"):
        import_module(f"uvms_ocp.viz.{module}")
    gc.freeze()  # or every look for garbage goes through all of it


def _end_with(parent: int) -> None:
    ctypes.CDLL(None).prctl(
        _DIE_WITH_PARENT, signal.SIGKILL
    )  # else a command that is killed leaves copies behind
    if os.getppid() != parent:
        os._exit(1)


def _draw_in_copies(drawings: Mapping[str, Job]) -> list[str]:
    _DRAWINGS.update(drawings)
    with ProcessPoolExecutor(_COPIES, get_context("fork"), _end_with, (os.getpid(),)) as pool:
        return [*filter(None, pool.map(_attempt, drawings))]


def _attempt(name: str, draw: Job | None = None) -> str:
    """Draw a file; returns why it failed, nothing where it is drawn."""
    try:
        (draw or _DRAWINGS[name])()
    except (OSError, OutputError):
        raise
    except Exception as error:
        return plain_line(f"{name}: not drawn, {type(error).__name__}: {error}")
    return ""


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
    drawn = _drawn(figures)
    options = changes.chosen | opt.given(
        noise=noise, seed=seed, duration=duration, record_rate=record_rate
    )
    if fault:
        options |= {"faults": parse_faults(fault)}
    scenario = opt.build_scenario(name, options, solver)
    from uvms_ocp.sim.own_parts import plant_name

    if follow is None:
        plan = None
    else:
        plan = _plan_of(scenario, follow)
    parts = (
        opt.label(name),
        plant_name(scenario.plant),
        opt.solver_name(scenario.solver),
        *(("followed",) if plan else ()),
    )
    folder = out or opt.default_folder(
        parts, {key: value for key, value in options.items() if key != "plant"}
    )
    report = run_and_write(
        scenario, folder, console, force=force, plan=plan, live=live, drawn=drawn
    )
    if as_json:
        printing.print_json(report)
    ending = report["cause"]["kind"]
    if ending != "completed":
        raise typer.Exit(INTERRUPTED if ending == "stopped" else NOT_COMPLETED)


def _keep_cut_off(running: Path, target: Path, console: Console) -> None:
    try:
        Record.load(running).save(target)
    except InvalidInput as error:
        aside = running.with_name("damaged")
        durable_files.discard(aside)
        running.rename(aside)
        console.print(f"{error}; moved to {aside}", style="yellow", markup=False)


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
    names = (RECORD, "report.json", "scene.html", *(f"figures/{name}.png" for name in RUN_NAMES))
    drawing_names: tuple[str, ...] = (SCENE, *RUN_NAMES)
    if drawn is not None:
        drawing_names = tuple(drawn)
    with claim_folder(out, names) as claim, drawer(needed=bool(drawing_names)) as draw:
        preflight = scenario.check()
        printing.require_accepted(preflight, scenario.name, console, force=force)
        if (running / row_files.META).is_file():
            _keep_cut_off(running, out / "cut_off.npz", console)
        durable_files.discard(running)
        with _watched(scenario, console) if live else nullcontext() as observer:
            record = _simulate(scenario, plan, console, observer, running)
        with claim.staged() as staging:
            record.save(staging / RECORD)
        durable_files.discard(running)
        report = summarize(record) | {"preflight": preflight.to_dict()}
        with claim.staged(keep=[RECORD]) as staging:
            (staging / "report.json").write_text(json.dumps(report, indent=2) + "\n")
            (staging / "figures").mkdir()
            if plan is not None and SCENE in drawing_names:
                ghosts = {"plan": plan.to_record(scenario)}
            else:
                ghosts = None
            drawings = drawings_of(record, scenario.robot, staging, drawing_names, ghosts)
            missing = draw(drawings, console.status("writing report, figures and scene"))
        written = claim.written()
    _print_summary(console, report, written)
    for line in missing:
        console.print(line, style="yellow", markup=False)
    return report


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


def _drawn(names: str) -> list[str]:
    """Return all figures, none, or those whose names, with commas, are given. Raises
    `NameNotFound`.
    """
    figure_names = [SCENE, *RUN_NAMES]
    listed = [name.strip() for name in names.split(",")]
    chosen = {"all": figure_names, "none": []}.get(names, listed)
    if len(chosen) == 1:
        allowed = ["all", "none", *figure_names]
    else:
        allowed = figure_names
    for name in chosen:
        require_known("figure", name, allowed)
    return chosen


def drawings_of(
    record: Record,
    robot: Robot,
    folder: Path,
    figures: Iterable[str],
    ghosts: Mapping[str, Record] | None = None,
) -> Mapping[str, Job]:
    """Return the function that writes each file, by its name, the slowest first.

    ghosts: drawn in the scene, too, which is among the figures by its name. A record that stands in
    the folder, and may be larger than memory, is read from there by what draws the scene.
    """
    thin_record = thinned(record)
    figure_folder = folder / "figures"
    path = folder / RECORD
    source = path if path.is_file() else record
    scene = partial(
        _write,
        "scene.show",
        "write_scene",
        source,
        robot,
        folder / "scene.html",
        ghosts=ghosts or {},
    )
    figure_jobs = {
        name: partial(_write, "run_figures", "write_figure", thin_record, name, figure_folder)
        for name in figures
        if name != SCENE
    }
    files = {f"figures/{name}.png": draw for name, draw in figure_jobs.items()}
    if SCENE in figures:
        return {"scene.html": scene} | files
    return files


def _write(
    module: str, function: str, record: Record | Path, *arguments: object, **options: object
) -> None:
    """Load what draws, and a record of which the path is given, where it is called."""
    if isinstance(record, Path):
        loaded = Record.load(record)
    else:
        loaded = record
    getattr(import_module(f"uvms_ocp.viz.{module}"), function)(loaded, *arguments, **options)


def _print_summary(console: Console, report: dict[str, Any], paths: list[Path]) -> None:
    table = Table(
        title=plain_line(
            f"{report['scenario']}, {report['robot']}, {report['plant']} plant, {report['solver']}"
        )
    )
    for column in ("phase", "start [s]", "end [s]", "J", "m"):
        table.add_column(column, no_wrap=True, justify="left" if column == "phase" else "right")
    for phase in report["phases"]:
        times = (f"{phase['start_s']:.2f}", f"{phase['end_s']:.2f}")
        energy = printing.cell(phase["energy_j"])
        table.add_row(
            plain_line(f"{phase['name']} {phase['title']}", 40),
            *times,
            energy,
            f"{phase['path_length_m']:.2f}",
        )
    console.print(table)
    for phase in report["phases"]:  # why it ended and, indented below, the errors at its end
        console.print(Text(plain_line(f"{phase['name']} ended: {phase['reason']}")))
        errors = "; ".join(_active_errors(phase))
        if errors:
            console.print(Padding(Text(plain_line(errors), style="dim"), (0, 0, 0, 4)))
    _print_what_went_wrong(console, report)
    for tool, load in report["loads"].items():
        console.print(format_load(load, tool))
    resources = _transposed(report["resources"])
    console.print(printing.table_of("resources", resources, tuple(resources[0])))
    times = report["controller_us"]
    controller_text = f", whole controller {times['p50']:.0f} us" if times else ""
    ending = report["cause"]["kind"]
    if not report["completed"]:
        verdict = plain_line(f"not completed: {report['pending']}")
    elif ending == "completed":
        verdict = "complete"
    else:
        verdict = "complete by the estimate alone"
    tick = (
        f"tick p50 {report['tick_us']['p50']:.0f} us{controller_text}, largest tilt"
        f" {printing.cell(report['largest_tilt_rad'])} rad"
    )
    console.print(
        f"mission {verdict}; simulated {report['simulated_s']:.1f} s in {report['wall_s']:.1f} s,"
        f" {tick}"
    )
    if ending != "completed":
        console.print(plain_line(f"cause: {report['cause']['kind']}: {report['cause']['text']}"))
    printing.print_paths(console, paths)


def _print_what_went_wrong(console: Console, report: dict[str, Any]) -> None:
    """Print faults that were asked for, and what the robot said; a line each."""
    for fault in report["faults"]:
        if fault["end"] is None:
            until = ""
        else:
            until = f" to {fault['end']:g} s"
        console.print(f"fault from {fault['t']:g} s{until}: {fault['text']}", style="yellow")
    for alarm in report["alarms"]:
        console.print(plain_line(f"alarm at {alarm['t']:.2f} s: {alarm['text']}"), style="yellow")
    for row in report["passed_rates"]:
        rate = f"{row['rate']:.3g} {row['unit']}"
        limit = f"{row['share']:.2f} times its limit"
        console.print(
            plain_line(f"joint {row['joint']} moved at {rate} at {row['t']:.2f} s, {limit}"),
            style="yellow",
        )
    for row in report["sensor_health"]:
        if row["first_s"] is not None:  # a channel that was not always good
            spans = f"suspect for {row['suspect_s']:.2f} s, lost for {row['lost_s']:.2f} s"
            console.print(
                plain_line(
                    f"{row['channel']} {spans}, first at {row['first_s']:.2f} s: {row['why']}"
                ),
                style="yellow",
            )


def _active_errors(phase: dict[str, Any]) -> Iterator[str]:
    """Yield errors of the tasks that the phase had turned on: as estimated, and where sensors are
    noisy the truth beside it.
    """
    for name, value in phase["final_errors"].items():
        task, _, quantity = name.rpartition(".")
        if task in phase["tasks"] and "error" in quantity:
            allowed = phase["sensors_allow"].get(name)
            true = printing.cell(phase["true_errors"].get(name))
            if allowed is None:
                truth = ""
            else:
                truth = f", true {true}, sensors allow {allowed:.2g}"
            yield f"{name} {printing.cell(value)}{truth}"


def _transposed(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row per figure that some phase has, one column per visit to a phase; energy that
    is not known has its row too.
    """
    names = [*(f"{k + 1} {row['phase']}" for k, row in enumerate(rows[:-1])), rows[-1]["phase"]]
    nonempty = {name for name in rows[0] if any(row[name] is not None for row in rows)}
    if "joint_energy_j" in nonempty:
        nonempty |= {"thruster_energy_j", "energy_j"}
    figures = [name for name in rows[0] if name != "phase" and name in nonempty]
    transposed = list[dict[str, Any]]()
    for figure in figures:
        values = [row[figure] for row in rows]
        transposed.append({"figure": figure, **dict(zip(names, values, strict=True))})
    return transposed
