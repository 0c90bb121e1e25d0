"""A call of the C compiler that ends: in time, with all that it started, and with little to say."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from typing import IO

from uvms_ocp.exceptions import InvalidInput

_TIMEOUT = 300.0  # [s], ten times what the longest of ours takes
_KEPT = 2000  # [bytes] of what a compiler says


def compile_timeout() -> float:
    """[s] after which a compiler is stopped: ``UVMS_OCP_COMPILE_TIMEOUT``. Raises `InvalidInput` where that is no time."""
    given = os.environ.get("UVMS_OCP_COMPILE_TIMEOUT", "")
    try:
        seconds = float(given or _TIMEOUT)
    except ValueError:
        seconds = -1.0
    if not 0.0 < seconds < 1e9:
        raise InvalidInput(f"UVMS_OCP_COMPILE_TIMEOUT = {given!r}; give seconds, such as {_TIMEOUT:g}")
    return seconds


def call(command: Sequence[str], seconds: float) -> tuple[int, str]:
    """Return code and the end of what was said on both outputs, after at most that many `seconds` [s].

    Raises `OSError` where it cannot be run, and `subprocess.TimeoutExpired` where it was stopped, with all its children.
    """
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=said, stderr=subprocess.STDOUT, start_new_session=True
        )
        try:
            code = process.wait(seconds)
        except BaseException:  # Ctrl-C too, which does not reach a session of its own
            _kill(process)
            raise
        return code, _end(said)


def _kill(process: subprocess.Popen[bytes]) -> None:
    if sys.platform == "win32":
        process.kill()
    else:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _end(said: IO[bytes]) -> str:
    said.seek(max(0, said.seek(0, os.SEEK_END) - _KEPT))
    return said.read().decode(errors="replace")
