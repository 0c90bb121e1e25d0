"""Benchmarks in processes of their own, with another interpreter or without a C compiler."""

from __future__ import annotations

import compileall
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import uvms_ocp

_HIDDEN = {"PATH": "", "CC": ""}
_FOLDER = Path(__file__).parents[1]


def run_script(
    python: Path | str,
    script: Path,
    *words: object,
    compiler: bool = True,
    cache: Path | None = None,
) -> None:
    """Run a script of these folders in its own process; raises `CalledProcessError` where it fails.

    compiler: False hides the C compiler, so that step functions run in CasADi's virtual machine.
    cache: of compiled code, for which nobody waits; that of this process by default.
    """
    import_paths = [str(_FOLDER)]
    inherited = os.environ.get("PYTHONPATH")
    if str(python) == sys.executable and inherited:
        import_paths.append(inherited)  # the same package as this process
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(import_paths)}
    if cache is not None:
        environment |= {"UVMS_OCP_CACHE": str(cache), "UVMS_OCP_WAIT_FOR_COMPILER": ""}
    if not compiler:
        environment |= _HIDDEN
    subprocess.run([str(word) for word in (python, script, *words)], check=True, env=environment)


def as_installed(cache: Path | str) -> dict[str, str]:
    """Environment of commands that find byte code, as those of an installed package do, and wait
    for no compiler.

    cache: of compiled code.
    """
    compileall.compile_dir(str(Path(uvms_ocp.__file__).parent), quiet=2)
    environment = os.environ | {"UVMS_OCP_CACHE": str(cache), "UVMS_OCP_WAIT_FOR_COMPILER": ""}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    return environment


def hide_compiler() -> None:
    """Hide the compiler from this process, before anything is compiled: a quick run does not wait
    for it.
    """
    os.environ.update(_HIDDEN)


@contextmanager
def compiled_once() -> Iterator[Path]:
    """Keep what is compiled from here on in a folder that is gone afterwards, and do not optimize
    it: it runs once.
    """
    with tempfile.TemporaryDirectory() as folder:
        os.environ |= {"UVMS_OCP_CACHE": folder, "UVMS_OCP_CFLAGS": "-O0"}
        yield Path(folder)
