"""``show``: a run, a plan or a robot in three dimensions, in the browser or as a file."""

from __future__ import annotations

import time
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from uvms_ocp.cli.printing import console_of, print_paths
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.mission_plan import MissionPlan
from uvms_ocp.model.files.library import list_robots
from uvms_ocp.model.robot import Robot
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.output import settle
from uvms_ocp.record import Record
from uvms_ocp.scenarios.chosen import robot_of

if TYPE_CHECKING:
    from uvms_ocp.viz.scene.page.viewer import ScenePage


def show_scene(
    what: Annotated[
        str,
        typer.Argument(
            metavar="WHAT", help="Folder of a run, a plan or a robot, a file of a motion, or a robot's name."
        ),
    ],
    ghost: Annotated[
        list[Path] | None, typer.Option(metavar="PATH", help="Another run or plan, drawn translucent; several times.")
    ] = None,
    robot: Annotated[
        str | None, typer.Option(help="Robot of the record, by name, folder or URDF; default: as it says.")
    ] = None,
    hydrodynamics: Annotated[Path | None, typer.Option(metavar="YAML", help="Its file of water and limits.")] = None,
    fps: Annotated[float, typer.Option(metavar="HZ", help="Frames per second.")] = 25.0,
    out: Annotated[Path | None, typer.Option(metavar="HTML", help="Write this file, and serve nothing.")] = None,
    frames: Annotated[
        Path | None, typer.Option(metavar="DIR", help='Write PNGs for a video there; needs "uvms-ocp[video]".')
    ] = None,
    port: Annotated[int, typer.Option(metavar="N", help="Of the loopback address; 0: any that is free.")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open a browser.")] = True,
) -> None:
    """Show a run, a plan or a robot in three dimensions, until Ctrl-C.

    Only this machine is served. A robot alone has sliders for its joints.

    \f
    Raises `InvalidInput` for what is no record, plan or robot, and for what does not fit together.
    """
    console = console_of()
    with console.status("drawing"):
        page = _page(what, tuple(ghost or ()), _own_robot(robot, hydrodynamics), fps)
    if out is not None:
        print_paths(console, [page.write(out)])
        return
    if frames is not None:
        _film(console, page, frames, fps)
        return
    _serve(console, page, port, what, browser)


def _serve(console: Console, page: ScenePage, port: int, what: str, browser: bool) -> None:
    """Until Ctrl-C."""
    from uvms_ocp.viz.scene.page.loopback import served

    with suppress(KeyboardInterrupt), served(page, port) as address:
        console.print(f"{address} shows {what}; Ctrl-C stops", highlight=False)
        if browser:
            webbrowser.open(address)
        while True:
            time.sleep(3600)


def _film(console: Console, page: ScenePage, folder: Path, fps: float) -> None:
    from uvms_ocp.viz.scene.page.pictures import write_frames

    with console.status("drawing frames"):
        n = len(write_frames(page, folder, fps=fps))
    console.print(f"{n} frames; for a video: ffmpeg -framerate {fps:g} -i {folder}/%05d.png -pix_fmt yuv420p video.mp4")


def _page(what: str, ghosts: tuple[Path, ...], robot: Robot | None, fps: float) -> ScenePage:
    from uvms_ocp.viz.scene.show import show

    if (what in list_robots() and not Path(what).exists()) or (Path(what) / "robot.urdf").is_file():
        return show(robot_of(what))
    others = {_name_of(path): _motion(path) for path in ghosts}
    if len(others) < len(ghosts):
        raise InvalidInput("two ghosts of one name; their folders, or files, need different names")
    shown = _motion(Path(what))
    return show(shown, None if isinstance(shown, Plan) else robot, ghosts=others, fps=fps)


def _own_robot(robot: str | None, hydrodynamics: Path | None) -> Robot | None:
    if robot is None:
        if hydrodynamics is not None:
            raise InvalidInput("--hydrodynamics goes with --robot URDF; give both")
        return None
    return robot_of(robot, hydrodynamics)


def _motion(path: Path) -> Record | Plan:
    """The record of a folder or file, or else the plan."""
    folder = path if path.is_dir() else path.parent
    settle(folder)
    file = _kept(folder, ("record.npz", "plan.npz", "plan.json")) if path.is_dir() else path
    readers: tuple[Callable[[Path], Record | Plan], ...] = (Record.load, Plan.load)
    wrong: list[str] = []
    for read in readers[1:] if file.suffix == ".json" else readers:
        try:
            return read(file)
        except InvalidInput as error:
            wrong.append(str(error))
    with suppress(InvalidInput):
        MissionPlan.load(file)
        wrong[0] = (
            f"{file}: a plan of a mission, which is shown once flown; give the folder of `run NAME --follow PLAN`"
        )
    raise InvalidInput(wrong[0])


def _kept(folder: Path, names: tuple[str, ...]) -> Path:
    found = [folder / name for name in names if (folder / name).is_file()]
    if not found:
        raise InvalidInput(
            f"{folder}: holds no {' or '.join(names)}; give the folder of a run, a plan or a robot, or a robot's name"
        )
    return found[0]


def _name_of(path: Path) -> str:
    """What tells a run from others: the name of its folder."""
    return (path if path.is_dir() else path.parent if path.stem in ("record", "plan") else path).resolve().name
