"""Print one JSON value on stdout, and nothing else there."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout
from typing import Any, TextIO

_OUTPUT: list[TextIO] = []


def print_json(value: Any) -> None:
    """Print one JSON value on stdout."""
    (_OUTPUT[-1:] or [sys.stdout])[0].write(json.dumps(value, indent=2) + "\n")


@contextmanager
def json_alone_on_stdout() -> Iterator[None]:
    """Send all else that is printed, by missions and the programs that they start too, to
    stderr.
    """
    out = sys.stdout
    with ExitStack() as ends:
        if out is sys.__stdout__ and sys.stderr is not None:
            out = ends.enter_context(open(os.dup(1), "w", encoding="utf-8"))
            ends.callback(os.dup2, out.fileno(), 1)
            os.dup2(2, 1)
        _OUTPUT.append(out)
        ends.callback(lambda: _OUTPUT.pop().flush())
        with redirect_stdout(sys.stderr):
            yield
