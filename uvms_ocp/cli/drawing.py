"""Write figures and scenes of a record, on two processors at a time: Matplotlib and meshcat keep one
busy each.
"""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import partial
from importlib import import_module
from multiprocessing import active_children, get_context
from pathlib import Path
from pickle import PicklingError

from uvms_ocp.errors import OutputError, plain_line
from uvms_ocp.record.output import RECORD
from uvms_ocp.record.record import Record
from uvms_ocp.robot.robot import Robot
from uvms_ocp.viz.thinning import thinned

Job = Callable[[], object]
"""Function that writes one figure or scene."""

SCENE = "scene"
"""Name of the 3-D scene among those of the figures."""

_COPIES = 2  # processes that draw at a time
_DIE_WITH_PARENT = 1  # `PR_SET_PDEATHSIG` of Linux

_DRAWINGS = dict[str, Job]()
"""Jobs of a copy of the process, which its own copies find here: they need not be sent."""


@contextmanager
def drawer(*, needed: bool = True) -> Iterator[Callable[..., list[str]]]:
    """Yield the function that writes all figures and scenes, and returns a line for each that
    failed, which says why.

    It takes the functions that write them, by name, each of which may be called twice, and the
    status to show meanwhile; what the disk refuses is raised. On Linux, with processors for them,
    copies of this process write. The first copy imports what draws, which takes half a second,
    while this process works; the others are copied from it.
    """
    in_copies = needed and sys.platform == "linux" and (os.cpu_count() or 1) >= _COPIES
    context = get_context("fork" if in_copies else None)
    pool = ProcessPoolExecutor(1, context, _load_drawing, (os.getpid(),))
    earlier_children = active_children()
    # Python warns of the threads of libraries, which only wait for work.
    with warnings.catch_warnings(action="ignore", category=DeprecationWarning):
        if in_copies:
            pool.submit(int)  # any job starts the copy
    copies = set(active_children()).difference(earlier_children)

    def draw(
        drawings: Mapping[str, Job], status: AbstractContextManager[object] | None = None
    ) -> list[str]:
        # A copy may be killed, and a job may be one that cannot be sent: then this process draws.
        copy_failures = (BrokenProcessPool, PicklingError, AttributeError, TypeError)
        with status or nullcontext(), suppress(*copy_failures):
            if in_copies:
                return pool.submit(_draw_in_copies, drawings).result()
        problems = [_attempt(name, job) for name, job in drawings.items()]
        return [problem for problem in problems if problem]

    try:
        yield draw
    finally:
        for copy in copies:
            copy.kill()
        pool.shutdown(cancel_futures=True)


def _load_drawing(parent: int) -> None:
    """Import what draws, in the copy of which the others are made."""
    _end_with(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # what is stopped by hand is drawn
    sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115 - for as long as the copy lives
    for module in ("run_figures", "scene.show"):
        import_module(f"uvms_ocp.viz.{module}")
    gc.freeze()  # or every look for garbage goes through all of it


def _end_with(parent: int) -> None:
    """End this copy as soon as its parent ends, so that a command that is killed leaves none."""
    ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def _draw_in_copies(drawings: Mapping[str, Job]) -> list[str]:
    # Copies of a copy: the first has imported Matplotlib and meshcat while the run went on, which
    # each file would else wait half a second for. It never ran the simulation, and so has none of
    # its threads, with which a copy may hang: that is why this process itself is not copied again.
    _DRAWINGS.update(drawings)
    with ProcessPoolExecutor(_COPIES, get_context("fork"), _end_with, (os.getpid(),)) as pool:
        return [problem for problem in pool.map(_attempt, drawings) if problem]


def _attempt(name: str, draw: Job | None = None) -> str:
    """Draw a file; returns why it failed, nothing where it is drawn."""
    try:
        (draw or _DRAWINGS[name])()
    except (OSError, OutputError):
        raise
    except Exception as error:
        return plain_line(f"{name}: not drawn, {type(error).__name__}: {error}")
    return ""


def drawings_of(
    record: Record,
    robot: Robot,
    folder: Path,
    figures: Iterable[str],
    ghosts: Mapping[str, Record] | None = None,
) -> Mapping[str, Job]:
    """Return the function that writes each file, by its name, the slowest first.

    figures: names of figures, and `SCENE`. ghosts: records that are drawn in the scene, too, by
    name. A record that stands in the folder, and may be larger than memory, is read from there by
    what draws the scene.
    """
    figure_names = list(figures)
    jobs = dict[str, Job]()
    if SCENE in figure_names:
        path = folder / RECORD
        jobs["scene.html"] = partial(
            _write,
            "scene.show",
            "write_scene",
            path if path.is_file() else record,
            robot,
            folder / "scene.html",
            ghosts=ghosts or {},
        )
    thin_record = thinned(record)
    figure_folder = folder / "figures"
    for name in figure_names:
        if name != SCENE:
            jobs[f"figures/{name}.png"] = partial(
                _write, "run_figures", "write_figure", thin_record, name, figure_folder
            )
    return jobs


def _write(
    module: str, function: str, record: Record | Path, *arguments: object, **options: object
) -> None:
    """Call a function of `uvms_ocp.viz` with a record, which is loaded here if a path is given."""
    if isinstance(record, Path):
        loaded = Record.load(record)
    else:
        loaded = record
    # By name: to import it at the top would load Matplotlib in every command, before anything is run.
    write = getattr(import_module(f"uvms_ocp.viz.{module}"), function)
    write(loaded, *arguments, **options)
