"""The command ``cache``, and how other commands show what is being compiled and what the compiler
warns of.
"""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from logging.handlers import MemoryHandler
from typing import Annotated, cast

import typer

from uvms_ocp.cli.exit_codes import BAD_INPUT
from uvms_ocp.errors import InvalidInput

_LOGGER = logging.getLogger("uvms_ocp.codegen.compile")
_LINES = cast(logging.Handler, logging.lastResort)


@contextmanager
def show_compilation(show: Callable[[str], None]) -> Iterator[None]:
    """Call `show` with a few words about each library that is compiled in the block."""

    def show_progress(record: logging.LogRecord) -> bool:
        if record.levelno < logging.WARNING:
            show(record.getMessage())
        return True

    former_level = _LOGGER.level
    _LOGGER.addFilter(show_progress)
    _LOGGER.setLevel(logging.INFO)
    try:
        yield
    finally:
        _LOGGER.removeFilter(show_progress)
        _LOGGER.setLevel(former_level)


def _warns(record: logging.LogRecord) -> bool:
    """Check that a line of the log is a warning, not progress."""
    from uvms_ocp.codegen.compiler_log import PROGRESS  # which has logged it

    return not getattr(record, PROGRESS, False)


@contextmanager
def warned_behind_errors() -> Iterator[None]:
    """Run a command in the block, and print on stderr whatever of compilation made it slower, unless
    it ends with an error, which is then the only line.

    On a terminal warnings are printed at once, with what is being compiled, and an error comes last.
    """
    if sys.stderr is not None and sys.stderr.isatty():
        handler: logging.Handler = _LINES  # which Rich puts above its bars
    else:
        handler = MemoryHandler(sys.maxsize, sys.maxsize, target=_LINES, flushOnClose=False)
        handler.setLevel(logging.WARNING)
        handler.addFilter(_warns)
    _LOGGER.addHandler(handler)
    try:
        yield
        handler.flush()
    except SystemExit as end:
        if end.code != BAD_INPUT:
            handler.flush()
        raise
    finally:
        _LOGGER.removeHandler(handler)


def cache(clear: Annotated[bool, typer.Option("--clear", help="Remove them all.")] = False) -> None:
    """Show the folder of compiled libraries, how many there are, their size, and how long ago they
    were used.

    It keeps itself below 1 GB: those used longest ago are removed. What is removed is compiled
    again when it is needed. Raises `InvalidInput` where there is no folder for it.
    """
    from uvms_ocp.codegen.cache import cache_folder, cached_libraries, shrink_cache

    folder, reason = cache_folder()
    if folder is None:
        raise InvalidInput(f"{reason}; set UVMS_OCP_CACHE to a folder that can be written")
    if clear:
        paths = shrink_cache(folder, 0.0)
    else:
        paths = cached_libraries(folder)
    statuses = paths.values()
    n_libraries = sum(path.suffix == ".so" for path in paths)
    size = sum(status.st_size for status in statuses)
    text = f"libraries: {n_libraries}, {size / 1e6:.1f} MB"
    if clear:
        text = f"removed {text}"
    if statuses:
        days = (time.time() - min(status.st_mtime for status in statuses)) / 86400.0
        text = f"{text}, the oldest used {days:.1f} days ago"
    typer.echo(f"{folder}: {text}")
