"""What is being compiled, where a command shows what it does."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console

_LOGGER = "uvms_ocp.functions.compile"


class _Told(logging.Handler):
    def __init__(self, tell: Callable[[str], None], console: Console) -> None:
        super().__init__(logging.INFO)
        self._tell, self._console = tell, console

    def emit(self, record: logging.LogRecord) -> None:
        if record.levelno >= logging.WARNING:
            self._console.print(record.getMessage(), style="yellow", highlight=False, markup=False, soft_wrap=True)
        else:
            self._tell(record.getMessage())


@contextmanager
def told_of_compiling(tell: Callable[[str], None], console: Console) -> Iterator[None]:
    """Inside, `tell` is given what is being compiled, in a few words; warnings are printed on the console."""
    logger = logging.getLogger(_LOGGER)
    before, handler = logger.level, _Told(tell, console)
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
