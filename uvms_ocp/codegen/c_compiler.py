"""Find the C compiler of this machine, and run it with a limit of time."""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache

from uvms_ocp.codegen.cache import cache_folder
from uvms_ocp.codegen.compiler_log import warn_of_missing_compiler, warn_once
from uvms_ocp.errors import InvalidInput

HUNG: set[str] = set()
"""Compilers that have hung, which are not called again."""
_TIMEOUT = 300.0
"""[s] Time after which a compiler is stopped: ten times what the longest of ours takes."""
_VERSION_TIMEOUT = 30.0
"""[s] Time after which a compiler is stopped that is asked for its version."""
_MAX_OUTPUT = 2000
"""[bytes] of what a compiler writes that are kept."""
_STARTING = threading.RLock()
"""Held while a compiler is started, so that no fork happens in between."""
_RUNNING = set[subprocess.Popen[bytes]]()
"""Compilers that run."""


@lru_cache(maxsize=1)
def find_compiler() -> str | None:
    """Return the path of the compiler: that of ``CC``, or the first of cc, gcc and clang; None
    where there is none (logged once).
    """
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        compiler = shutil.which(name) if name else None
        if compiler:
            return compiler
    warn_of_missing_compiler()
    return None


def has_compiler() -> bool:
    """Check that there is a compiler that has not been found to hang, and a folder for what it
    makes.
    """
    return find_compiler() not in {None, *HUNG} and cache_folder()[0] is not None


def warn_if_slower() -> None:
    """Log once that there is no compiler or no cache, before starting processes that log
    nothing.
    """
    if find_compiler() is not None:
        folder, reason = cache_folder()
        if folder is None:
            warn_once(reason)


def compilation_key(texts: Sequence[str], flags: Sequence[str], compiler: str) -> str:
    """Hash all that decides what a compiler makes: texts, flags, the compiler itself and the
    machine.
    """
    identity = (*texts, *flags, compiler, _version(compiler), platform.machine(), sys.platform)
    return hashlib.sha256("\0".join(identity).encode()).hexdigest()


@lru_cache(maxsize=4)
def _version(compiler: str) -> str:
    with suppress(OSError):
        return run_compiler([compiler, "--version"], min(_VERSION_TIMEOUT, compile_timeout()))[1]
    return ""


def compile_timeout() -> float:
    """Return the time [s] after which a compiler is stopped: ``UVMS_OCP_COMPILE_TIMEOUT``. Raises
    `InvalidInput` where that is no time.
    """
    configured = os.environ.get("UVMS_OCP_COMPILE_TIMEOUT", "")
    try:
        seconds = float(configured or _TIMEOUT)
    except ValueError:
        seconds = -1.0
    if not 0.0 < seconds < 1e9:
        raise InvalidInput(
            f"UVMS_OCP_COMPILE_TIMEOUT = {configured!r}; give seconds, such as {_TIMEOUT:g}"
        )
    return seconds


def run_compiler(command: Sequence[str], seconds: float) -> tuple[int, str]:
    """Run a compiler for at most that many `seconds` [s]; return its code and the end of what it
    wrote on both outputs.

    Raises `OSError` where it cannot be run, and `subprocess.TimeoutExpired` where it was stopped,
    with all its children.
    """
    with tempfile.TemporaryFile() as output:
        with _STARTING:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            _RUNNING.add(process)
        try:
            code = process.wait(seconds)
        except BaseException:  # Ctrl-C too, which does not reach a session of its own
            _kill(process)
            raise
        finally:
            _RUNNING.discard(process)
        size = output.seek(0, os.SEEK_END)
        output.seek(max(0, size - _MAX_OUTPUT))
        return code, output.read().decode(errors="replace")


def refuse_compilers() -> None:
    """Let no compiler begin any more: threads that try wait for ever."""
    _STARTING.acquire()


def stop_compilers() -> None:
    """Stop all compilers that run, with their children."""
    for process in _RUNNING.copy():
        _kill(process)


def _kill(process: subprocess.Popen[bytes]) -> None:
    if sys.platform == "win32":
        process.kill()
    else:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _forget_compilers() -> None:
    """Forget in a fork the compilers that run, which are those of its parent."""
    _RUNNING.clear()
    _STARTING.release()


if sys.platform != "win32":
    # A fork in the middle of a start would hold open the pipe by which the starting thread hears
    # that its compiler runs.
    os.register_at_fork(
        before=_STARTING.acquire,
        after_in_parent=_STARTING.release,
        after_in_child=_forget_compilers,
    )
