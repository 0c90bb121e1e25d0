"""What Case 1 and a plan of each method come to, in a few numbers: ``python
tests/outline/outlines.py --reason WORDS``.

Records `outlines.json` anew, for a change that is meant to move them; the reason is kept beside the
numbers.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from uvms_ocp.cli.commands import app
from uvms_ocp.cli.options import SOLVERS
from uvms_ocp.record.meta_values import PLANTS
from uvms_ocp.report.summary import summarize
from uvms_ocp.scenario.cases.case1 import case1

RECORDED = Path(__file__).with_suffix(".json")
GOAL = ("--tool", "12.2", "37.4", "-39.5", "--position", "11", "37", "-38.5")
PLANS = {"plan curve": ("--sphere", "11.8,37.2,-38.9,0.1"), "plan ocp": ()}
PLANNED = ("status", "collision_free", "duration_s", "min_clearance_m", "energy_j", "peak_thrust_n")


def mission(plant: str, solver: str) -> dict[str, Any]:
    """When the phases of Case 1 end, and how far the tool is off."""
    report = summarize(case1(plant=plant, solver=SOLVERS[solver]()).run())
    return {
        "phases": {phase["name"]: phase["end_s"] for phase in report["phases"]},
        "position_error_m": report["tool_position_error_m"],
        "orientation_error_rad": report["tool_orientation_error_rad"],
    }


def plan(command: str) -> dict[str, Any]:
    """How long it takes, what it costs and where it ends."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "plan"
        words = [*command.split(), *GOAL, *PLANS[command], "--out", str(out)]
        CliRunner().invoke(app, words, catch_exceptions=False)
        report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    figures = {name: report[name] for name in PLANNED if name in report}
    return figures | {"position_error_m": report["tool_error"]["position_m"]}


def _outlines() -> dict[str, Callable[[], dict[str, Any]]]:
    outlines = {}
    for plant in PLANTS:
        for solver in ("active_set", "lexqp", "icat"):
            outlines[f"{plant} {solver}"] = partial(mission, plant, solver)
    for command in PLANS:
        outlines[command] = partial(plan, command)
    return outlines


OUTLINES = _outlines()
"""Functions that compute the numbers, by what they are of."""


def main() -> None:
    """Record all of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--reason", required=True, help="why the numbers move")
    arguments = parser.parse_args()
    outlines = {name: outline() for name, outline in OUTLINES.items()}
    content = json.dumps({"reason": arguments.reason, "outlines": outlines}, indent=2)
    RECORDED.write_text(content + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
