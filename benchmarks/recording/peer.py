"""What the script of a peer does: the problem of a file in, the outcome into another. For the
standard library only.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any


def run_peer(description: str | None, solve: Callable[[Any, int], object]) -> None:
    """Call ``solve(problem, repeats)`` with what the command line names."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("problem", type=Path)
    parser.add_argument("result", type=Path)
    parser.add_argument("--repeats", type=int, required=True)
    arguments = parser.parse_args()
    problem = json.loads(arguments.problem.read_text())
    outcome = solve(problem, arguments.repeats)
    arguments.result.write_text(json.dumps(outcome))
