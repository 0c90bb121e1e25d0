"""``list``: every name that other commands take."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.table import Table

from uvms_ocp.campaign import STUDIES
from uvms_ocp.cli.options import SOLVERS
from uvms_ocp.cli.printing import console_of, print_json
from uvms_ocp.model.files.library import list_robots
from uvms_ocp.parts.given import PLANTS
from uvms_ocp.scenarios import SCENARIOS


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
        print_json(known)
        return
    table = Table("kind", "names", box=None)
    for kind, names in known.items():
        table.add_row(kind, ", ".join(names))
    console_of().print(table)
