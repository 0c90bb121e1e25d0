"""``show``, ``compare``, ``check`` and ``mission``: look at runs, plans, robots and missions."""

from __future__ import annotations

import json
import sys
import time
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from uvms_ocp.cli import options as opt
from uvms_ocp.cli.exit_codes import BAD_INPUT
from uvms_ocp.cli.identify import MappingFile, read_recordings
from uvms_ocp.cli.printing import (
    busy,
    console_of,
    print_findings,
    print_json,
    print_line,
    print_paths,
    table_of,
)
from uvms_ocp.cli.result_folders import named_folder
from uvms_ocp.errors import InvalidInput, plain_line
from uvms_ocp.mission_plan.mission_plan import MissionPlan
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.record import durable_files, row_files
from uvms_ocp.record.manifest import STORE
from uvms_ocp.record.output import RECORD, RUNNING, claim_folder, recover_folder
from uvms_ocp.record.record import Record
from uvms_ocp.report.comparison import compare
from uvms_ocp.robot import Robot, list_robots, loading
from uvms_ocp.robot.dialects.robot_xml import ROBOT_SUFFIXES, robot_file_in
from uvms_ocp.scenario.cases import SCENARIOS
from uvms_ocp.scenario.own_code import own_code, with_robot
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.faults import parse_faults

if TYPE_CHECKING:
    from uvms_ocp.identification.recording import Recording
    from uvms_ocp.viz.scene.page import ScenePage

_WHAT = "Folder of a run or of a plan, its record.npz, or what is run first:"

_AGREEMENT = (
    "channel",
    "readings",
    "delay_s",
    "compared",
    "refused",
    "ratio",
    "sigma",
    "proposed_sigma",
)
_DOUBTS = ("channel", "suspect_s", "lost_s", "first_s", "why")
RobotOfRecord = Annotated[
    str | None,
    typer.Option(help="Robot of the record, by name, folder or URDF; default: as it says."),
]


# ``check`` and ``mission``: look at a mission without running it.


def check(
    name: opt.Name = "case1", changes: opt.ScenarioOptions = opt.AS_IT_IS, as_json: opt.Json = False
) -> None:
    """Check whether a mission can be completed, without running it; exit code 2 where it cannot."""
    preflight = opt.build_scenario(name, changes.chosen).check()
    print_findings(console_of(stderr=as_json), preflight, notes=True)
    if as_json:
        print_json(preflight.to_dict())
    if not preflight.accepted:
        raise typer.Exit(BAD_INPUT)


def mission(
    name: opt.Name = "case1",
    robot: opt.RobotName = None,
    files: opt.RobotFiles = opt.AS_WRITTEN,
    mermaid: Annotated[
        bool, typer.Option("--mermaid", help="Print a state diagram in Mermaid's notation.")
    ] = False,
) -> None:
    """Print which tasks are on in which phase of a scenario, or its phases as a diagram."""
    plan = opt.build_scenario(name, opt.given_options(robot=robot, **files.options)).mission
    sys.stdout.write(plan.mermaid() if mermaid else f"{plan}\n")


# ``compare``: two runs, or two plans, side by side.


def compare_runs(
    first: Annotated[str, typer.Argument(metavar="A", help=f"{_WHAT} {opt.SCENARIO_HELP}")],
    second: Annotated[str, typer.Argument(metavar="B", help="The other of the same kind.")],
    as_json: opt.Json = False,
) -> None:
    """Compare the resources that two runs took, or two plans would take.

    \f
    Raises `InvalidInput` for a folder without a record.
    """
    console = console_of(stderr=as_json)
    # Both are looked at before either is run.
    first_source = _record_or_scenario(first)
    second_source = _record_or_scenario(second)
    first_record = _record(first, first_source, console)
    second_record = _record(second, second_source, console)
    rows = compare(first_record, second_record)
    shown = [row | {"change": _percent(row["change"])} for row in rows]
    columns = ("figure", "first", "second", "change")
    console.print(table_of(f"{first} against {second}", shown, columns))
    if as_json:
        print_json(rows)


def _record_or_scenario(words: str) -> Record | Scenario:
    """Return a record of a folder or a file, or a scenario to be run."""
    is_code = own_code(words) is not None
    is_scenario = is_code or (words in SCENARIOS and not Path(words).exists())
    if is_scenario:
        return opt.build_scenario(words, {})
    advice = "the folder of a run, or of a plan of `plan`"
    return Record.load(_file_at(Path(words), (RECORD,), advice))


def _record(words: str, source: Record | Scenario, console: Console) -> Record:
    if isinstance(source, Record):
        return source
    with busy(console, f"running {plain_line(words, 60)}"):
        return source.run()


def _percent(change: float | None) -> str | None:
    if change is None:
        return None
    return f"{round(change, 4) + 0.0:+.4g} %"  # without the noise of sums, and no -0


# ``estimate``: what filter and health monitor make of a recording.


def estimate(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING", help="Folder of a run, its record, or a recording of others."
        ),
    ],
    out: Annotated[
        Path, typer.Option(metavar="DIR", parser=named_folder, help="Folder for the results.")
    ],
    robot: RobotOfRecord = None,
    files: opt.RobotFiles = opt.AS_WRITTEN,
    mapping: MappingFile = None,
    fault: opt.Faults = None,
    as_json: opt.Json = False,
) -> None:
    """Run filter and health monitor over a recording, and say how well each sensor agrees with
    them.

    Of a run the estimate is that of the run, to the last bit; of a log of others, sensors are expected
    to be as the log shows them. Faults are those of sensors.

    \f Raises `InvalidInput` for a recording of others without a robot, and as `estimate_recording`
    does.
    """
    from uvms_ocp.scenario.recorded_estimate import estimate_recording
    from uvms_ocp.viz.run_figures import write_figure
    from uvms_ocp.viz.scene.show import robot_of as recorded
    from uvms_ocp.viz.thinning import thinned

    console = console_of(stderr=as_json)
    used_robot = with_robot(opt.given_options(robot=robot, **files.options)).get("robot")
    is_run = mapping is None and (path.is_dir() or path.suffix == ".npz")
    recording: Record | Recording
    if is_run:
        recording = Record.load(_file_at(path, (RECORD,), "the folder of a run"))
    else:
        recording = read_recordings([path], mapping)[0]
    if used_robot is None:
        if not isinstance(recording, Record):
            raise InvalidInput(f"{path} does not say of which robot it is; give --robot")
        used_robot = recorded(recording, path)
    names = ("estimate", "health")
    rows = out / STORE / "estimate"
    with claim_folder(
        out, (RECORD, "report.json", *(f"figures/{name}.png" for name in names))
    ) as claim:
        durable_files.discard(rows)
        with busy(console, "estimating"):
            result = estimate_recording(
                recording, used_robot, faults=parse_faults(fault or ()), folder=rows
            )
        report = {
            "recording": str(path),
            "robot": used_robot.name,
            "same_as_run": result.same,
            "channels": list(result.channels),
        }
        with claim.staged() as staging:
            result.record.save(staging / RECORD)
            (staging / "report.json").write_text(json.dumps(report, indent=2) + "\n")
            for name in names:
                write_figure(thinned(result.record), name, staging / "figures")
        durable_files.discard(rows)
        written = claim.written()
    for columns in (_AGREEMENT, _DOUBTS):
        console.print(table_of(result.record.meta.scenario, result.channels, columns))
    if result.same is not None:
        relation = "is" if result.same else "differs from"
        print_line(console, f"the estimate {relation} that of the run")
    print_paths(console, written)
    if as_json:
        print_json(report)


# ``show``: a run, a plan or a robot in three dimensions, in the browser or as a file.


def show_scene(
    what: Annotated[
        str,
        typer.Argument(
            metavar="WHAT",
            help="Folder of a run, a plan or a robot, a file of a motion, or a robot's name.",
        ),
    ],
    ghost: Annotated[
        list[Path] | None,
        typer.Option(metavar="PATH", help="Another run or plan, drawn translucent; several times."),
    ] = None,
    robot: RobotOfRecord = None,
    files: opt.RobotFiles = opt.AS_WRITTEN,
    fps: Annotated[float, typer.Option(metavar="HZ", help="Frames per second.")] = 25.0,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write this file, and serve nothing: .html; or .png, .jpg, .mp4, .gif, for which"
            ' "uvms-ocp[video]" and Chromium are needed.',
        ),
    ] = None,
    view: Annotated[
        str, typer.Option(metavar="NAME", help="Camera of pictures: mission, vehicle or tool.")
    ] = "mission",
    at: Annotated[float, typer.Option(metavar="S", help="Time of a picture.")] = 0.0,
    port: Annotated[
        int, typer.Option(metavar="N", help="Of the loopback address; 0: any that is free.")
    ] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open a browser.")] = True,
) -> None:
    """Show a run, a plan or a robot in three dimensions, until Ctrl-C.

    Only this machine is served. A robot alone has sliders for its joints.

    \f
    Raises `InvalidInput` for what is no record, plan or robot, and for what does not fit together.
    """
    from uvms_ocp.viz.scene.page import require_saved_suffix

    if out is not None:
        require_saved_suffix(out)
    console = console_of()
    with console.status("drawing"):
        page = _page(what, tuple(ghost or ()), robot, files, fps)
    if out is not None:
        print_paths(console, [page.save(out, fps=fps, view=view, t=at)])
    else:
        _serve(console, page, port, what, browser)


def _serve(console: Console, page: ScenePage, port: int, what: str, browser: bool) -> None:
    """Serve a page until Ctrl-C."""
    from uvms_ocp.viz.scene.page_server import served

    with suppress(KeyboardInterrupt), served(page, port) as address:
        console.print(f"{address} shows {what}; Ctrl-C stops", highlight=False)
        if browser:
            webbrowser.open(address)
        while True:
            time.sleep(3600)


def _page(
    what: str, ghosts: tuple[Path, ...], robot: str | None, files: opt.RobotFiles, fps: float
) -> ScenePage:
    from uvms_ocp.viz.scene.show import robot_of as recorded, show

    is_name = what in list_robots() and not Path(what).exists()
    if is_name or robot_file_in(Path(what)).is_file() or Path(what).suffix in ROBOT_SUFFIXES:
        return show(loading.robot_called(what, files.hydrodynamics, files.loading))
    used_robot = with_robot(opt.given_options(robot=robot, **files.options)).get("robot")
    ghost_motions = {_name_of(path): _motion(path, used_robot) for path in ghosts}
    if len(ghost_motions) < len(ghosts):
        raise InvalidInput("two ghosts of one name; their folders, or files, need different names")
    motion = _motion(Path(what), used_robot)
    if isinstance(motion, Plan):
        shown_robot = None
    else:
        shown_robot = used_robot or recorded(motion, Path(what))
    return show(motion, shown_robot, ghosts=ghost_motions, fps=fps)


def _motion(path: Path, robot: Robot | None) -> Record | Plan:
    """Return the record of a folder or file, or else the plan, of that robot unless it is one of
    the library.
    """
    file = _file_at(
        path,
        (RECORD, "plan.npz", "plan.json"),
        "the folder of a run, a plan or a robot, or a robot's name",
    )
    readers: tuple[Callable[[Path], Record | Plan], ...] = (
        Record.load,
        partial(Plan.load, robot=robot),
    )
    messages: list[str] = []
    for read in readers[1:] if file.suffix == ".json" else readers:
        try:
            return read(file)
        except InvalidInput as error:
            messages.append(str(error))
    with suppress(InvalidInput):
        MissionPlan.load(file)
        messages[0] = (
            f"{file}: a plan of a mission, which is shown once flown; give the folder of `run NAME"
            " --follow PLAN`"
        )
    raise InvalidInput(messages[0])


def _file_at(path: Path, names: tuple[str, ...], advice: str) -> Path:
    """Return a file itself, or the first of these that a folder holds; what a command left
    unfinished there is ended before.

    Of a run that goes on, or that was cut off, the folder of its rows so far.
    """
    recover_folder(path if path.is_dir() else path.parent)
    if (path / RUNNING / row_files.META).is_file():
        return path / RUNNING
    if path.is_dir():
        files = [path / name for name in names if (path / name).is_file()]
    else:
        files = [path]
    if not files:
        raise InvalidInput(f"{path}: holds no {' or '.join(names)}; give {advice}")
    return files[0]


def _name_of(path: Path) -> str:
    """Return the name of a run: that of its folder."""
    is_file_of_run = not path.is_dir() and path.stem in ("record", "plan")
    folder = path.parent if is_file_of_run else path
    return folder.resolve().name
