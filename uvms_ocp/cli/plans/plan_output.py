"""What a plan of any method writes and prints."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from uvms_ocp.cli.options import NOT_COMPLETED
from uvms_ocp.cli.printing import console_of, print_json, print_paths
from uvms_ocp.exceptions import plain_line
from uvms_ocp.model.robot import Robot
from uvms_ocp.output import claimed
from uvms_ocp.record import Record

_FIGURES = ("vehicle_motion", "joint_motion", "clearance", "efforts")
_FILES = (  # of any plan; which of them there are depends on the method and on what came of it
    *("report.json", "plan.npz", "plan.csv", "plan.json", "record.npz", "scene.html"),
    *(f"figures/{name}.png" for name in _FIGURES),
)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MadePlan:
    """A plan of any method, ready to be written."""

    robot: Robot
    report: dict[str, Any]
    record: Record | None
    """The motion; None where there is none."""
    good: bool
    """The goal is reached and nothing touches."""
    save: Callable[[Path], object]
    """Writes what only this method has into a folder; called where there is a motion."""

    def write(self, folder: Path) -> None:
        """The report always, the rest where there is a motion; a colliding one is worth looking at."""
        from uvms_ocp.viz.plan_figures import write_plan_figures
        from uvms_ocp.viz.scene.show import write_scene

        (folder / "report.json").write_text(json.dumps(self.report, indent=2) + "\n")
        if self.record is None:
            return
        self.save(folder)
        self.record.save(folder / "record.npz")
        write_plan_figures(self.record, folder / "figures")
        write_scene(self.record, self.robot, folder / "scene.html")


Tell = Callable[[str], None]
"""Told how far the search is, to show while it goes on."""


def put_out(make: Callable[[Tell], MadePlan], out: Path, as_json: bool) -> None:
    """Make the plan, write it to the folder `out` and print what came of it; exit where it is not good."""
    console = console_of(stderr=as_json)
    with claimed(out, _FILES) as claim:
        with console.status("planning") as status:
            made = make(lambda text: status.update(plain_line(f"planning: {text}")))
        with claim.staged() as staging:
            made.write(staging)
        written = claim.written()
    _print_plan(console, made, written)
    if as_json:
        print_json(made.report)
    if not made.good:
        raise typer.Exit(NOT_COMPLETED)


def _print_plan(console: Console, made: MadePlan, paths: list[Path]) -> None:
    report = made.report
    status = report["status"] + (f" ({report['reason']})" if "reason" in report else "")
    console.print(plain_line(f"plan: {status}; advice: {report['advice']}"))
    if made.record is not None:
        least = report["min_clearance_m"]
        near = "" if least is None else f", {least:.3g} m between {report['min_clearance_between']} "
        near += "" if least is None else f"at {report['min_clearance_at_s']:.2f} s"
        found = f"{report['duration_s']:.1f} s long{near}; found in {report['solve_time_s']:.2f} s"
        console.print(plain_line(found))
    if unshaped := report["links_without_shape"]:
        text = (
            f"{', '.join(unshaped)}: no collision shape in the robot's file, so that nothing is said of what they touch"
        )
        console.print(plain_line(text), style="yellow")
    if report.get("peak_thrust_n") is not None:
        energy = report["energy_j"]
        taken = "- J (not known)" if energy is None else f"{energy:.0f} J"
        console.print(f"{taken}, thrust up to {report['peak_thrust_n']:.0f} N")
    print_paths(console, paths)
