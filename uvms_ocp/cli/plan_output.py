"""Write the files of a plan and print its figures, by whatever method it was found."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from uvms_ocp.cli.drawing import SCENE, drawer, drawings_of
from uvms_ocp.cli.exit_codes import INTERRUPTED, NOT_COMPLETED
from uvms_ocp.cli.printing import busy, console_of, print_json, print_paths
from uvms_ocp.errors import plain_line
from uvms_ocp.interrupts import Interrupted
from uvms_ocp.record.output import RECORD, claim_folder
from uvms_ocp.record.record import Record
from uvms_ocp.robot import Robot
from uvms_ocp.viz.figure_names import PLAN_NAMES

Progress = Callable[[str], None]
"""Callback with how far the search is, to show while it goes on."""

_FILES = ("report.json", "plan.npz", "plan.csv", "plan.json", RECORD, "scene.html")
"""Files that a plan may write beside its figures; which of them depends on the method and the
outcome.
"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlanOutput:
    """A plan of any method, ready to be written and printed."""

    robot: Robot
    """Robot that moves."""
    report: dict[str, Any]
    """Contents of ``report.json``."""
    record: Record | None
    """Record of the motion; None where there is none."""
    good: bool
    """True where the goal is reached and nothing touches."""
    stopped: bool = False
    """True where Ctrl-C ended the search: the best plan so far is written."""
    save: Callable[[Path], object] | None
    """Function that writes the files of this method alone into a folder; None where there are
    none.
    """
    show: Callable[[Console, PlanOutput], object]
    """Function that prints the figures of the plan."""

    def write(self, folder: Path) -> list[str]:
        """Write all but the drawings into the folder, the report even of a plan that failed.

        Returns the names of the files.
        """
        (folder / "report.json").write_text(json.dumps(self.report, indent=2) + "\n")
        if self.save is not None:
            self.save(folder)
        if self.record is not None:
            self.record.save(folder / RECORD)
        return [path.name for path in folder.iterdir()]


def make_and_write_plan(make: Callable[[Progress], PlanOutput], out: Path, as_json: bool) -> None:
    """Make the plan, write it to the folder `out` and print its figures; exit where it is not good.

    The plan is safe before it is drawn; a colliding one is worth looking at.
    """
    console = console_of(stderr=as_json)
    figures = tuple(f"figures/{name}.png" for name in PLAN_NAMES)
    not_drawn = list[str]()
    with claim_folder(out, (*_FILES, *figures)) as claim, drawer() as draw:
        with busy(console, "planning") as show:
            output = make(lambda text: show(plain_line(f"planning: {text}")))
        with claim.staged() as staging:
            files = output.write(staging)
        if output.record is not None:
            with claim.staged(keep=files) as staging:
                drawings = drawings_of(output.record, output.robot, staging, (SCENE, *PLAN_NAMES))
                not_drawn = draw(drawings)
        written = claim.written()
    _print_plan(console, output, written)
    for line in not_drawn:
        console.print(line, style="yellow", markup=False)
    if as_json:
        print_json(output.report)
    if output.stopped:
        raise typer.Exit(INTERRUPTED)
    if not output.good:
        raise typer.Exit(NOT_COMPLETED)


def _print_plan(console: Console, output: PlanOutput, paths: list[Path]) -> None:
    report = output.report
    reason = f" ({report['reason']})" if "reason" in report else ""
    console.print(plain_line(f"plan: {report['status']}{reason}; advice: {report['advice']}"))
    output.show(console, output)
    print_paths(console, paths)


def best_so_far(search: Callable[[], Any]) -> tuple[Any, bool]:
    """Return the result of a search, or its best so far where Ctrl-C ended it, and whether Ctrl-C
    did.
    """
    try:
        return search(), False
    except Interrupted as stop:
        return stop.result, True
