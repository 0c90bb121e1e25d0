"""Print one JSON value on stdout, and nothing else there."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any, TextIO

_OUTPUT: list[TextIO] = []


def print_json(value: Any) -> None:
    """One JSON value on stdout."""
    (_OUTPUT[-1:] or [sys.stdout])[0].write(json.dumps(value, indent=2) + "\n")


@contextmanager
def json_alone_on_stdout() -> Iterator[None]:
    """Send all else that is printed, by missions too, to stderr."""
    _OUTPUT.append(sys.stdout)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        _OUTPUT.pop().flush()
