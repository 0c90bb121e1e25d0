"""Tell users, once per process, what makes their code slower, and what takes long to compile.

All of it is logged by one logger, ``uvms_ocp.codegen.compile``: no compiler, one that fails, hangs
or writes garbage, a full disk, a cache that cannot be written or whose libraries cannot be loaded.
"""

from __future__ import annotations

import logging
import threading
from functools import lru_cache
from pathlib import Path

PROGRESS = "progress"
"""Attribute of records that are logged as warnings to be seen, and warn of nothing."""
LONG = 2.0
"""[s] Time of silence that looks like a hang."""
_PACE = 1.2e-6
"""[s] Time that a byte of long code takes to compile."""
_SLOWER = "everything works, only slower"
"""Consequence of a missing compiler, in a warning."""
_SAID: set[str] = set()
"""Warnings that have been logged, each once."""
_log = logging.getLogger("uvms_ocp.codegen.compile")


def warn_once(event: str, detail: str = "") -> None:
    """Warn that code will be slower because of an event, the first time that it happens.

    detail: what is told beside the event, and may differ from one time to the next.
    """
    if not threading.main_thread().is_alive():  # its compiler was ended with it
        return
    if event in _SAID:
        return
    _SAID.add(event)
    text = f"{event} ({detail})" if detail else event
    _log.warning("%s: %s", text, _SLOWER)


def warn_of_missing_compiler() -> None:
    """Warn that there is no compiler; the caller looks for one once."""
    _log.warning("no C compiler found (CC, cc, gcc, clang): %s", _SLOWER)


@lru_cache(maxsize=1)
def announce_first_compilation(cache_folder: Path) -> None:
    """Say that code is compiled for the first time, and where it is kept.

    It is a warning, as Python shows those by default: a silent half minute looks like a hang.
    """
    _log.warning(
        "compiling C code for the first time, which takes a while; kept in %s",
        cache_folder,
        extra={PROGRESS: True},
    )


def announce(name: str, size: int) -> None:
    """Log that code of `size` characters is being compiled, and how long it takes where it is
    long.
    """
    _log.info("compiling %s", name)
    seconds = _PACE * size
    if seconds > LONG:
        _log.warning(
            "compiling %s, which takes about %.0f s", name, seconds, extra={PROGRESS: True}
        )
