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
    given = parser.parse_args()
    given.result.write_text(json.dumps(solve(json.loads(given.problem.read_text()), given.repeats)))
