"""Copies of the repository, in which tests run and files are changed; the one in use is never
touched.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
_COPIED = (
    "uvms_ocp",
    "robots",
    "tests",
    "benchmarks",
    "notebooks",
    "pyproject.toml",
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
)
_COMPILER = """#!/bin/sh
# Code that is in the cache is used; where it may not be compiled, what a mutant changes runs in the
# slower way.
[ "$1" = --version ] || [ -z "$MUTANTS_DO_NOT_COMPILE" ] || exit 1
exec cc "$@"
"""
_OPTIONS = ("-q", "-p", "no:cacheprovider", "--no-header", "-o", "addopts=")


@dataclass(frozen=True, kw_only=True, slots=True)
class Outcome:
    """Exit code, failures and times of one run of tests."""

    code: int | None
    """pytest's; `None` where there is none: it crashed, or its time was over."""
    failed: tuple[str, ...]
    """Names of the tests that did not pass, in their order."""
    seconds: dict[str, float]
    """[s] of each test."""
    text: str
    """The last lines of what was printed."""


class Tree:
    """A copy of the repository."""

    def __init__(self, work: Path, name: str) -> None:
        self._work = work
        self.root = work / name
        shutil.rmtree(self.root, ignore_errors=True)
        self.root.mkdir(parents=True)
        for item in _COPIED:
            source = ROOT / item
            target = self.root / item
            if source.is_dir():
                shutil.copytree(
                    source, target, ignore=shutil.ignore_patterns("__pycache__", ".hypothesis")
                )
            elif source.exists():
                shutil.copy2(source, target)
        compiler = work / "compiler"
        compiler.write_text(_COMPILER)
        compiler.chmod(0o700)

    @contextmanager
    def changed(self, file: str, source: str) -> Iterator[None]:
        """Replace the text of a file for a while."""
        path = self.root / file
        before = path.read_bytes()
        try:
            _write(path, source.encode())
            yield
        finally:
            _write(path, before)

    def test(
        self,
        tests: Sequence[str],
        *,
        timeout: float,
        compiles: bool = False,
        options: Sequence[str] = (),
    ) -> Outcome:
        """Run files or single tests in their order; [s] `timeout` of all together.

        compiles: whether code that is not in the cache yet may be compiled.
        """
        with tempfile.TemporaryDirectory(dir=self._work) as folder:
            result = Path(folder) / "outcome.json"
            command = [sys.executable, "-m", "mutants.run_tests", str(result), *_OPTIONS, *options]
            text = _run(command, self.root, self._environment(compiles), "\n".join(tests), timeout)
            if not result.exists():
                return Outcome(code=None, failed=(), seconds={}, text=text)
            outcome = json.loads(result.read_text())
            return Outcome(
                code=outcome["code"],
                failed=tuple(outcome["failed"]),
                seconds=outcome["seconds"],
                text=_last(text),
            )

    def _environment(self, compiles: bool) -> dict[str, str]:
        cache = self._work / "cache"
        cache.mkdir(mode=0o700, exist_ok=True)
        environment = os.environ | {
            "PYTHONPATH": f"{self.root}{os.pathsep}{self.root / 'benchmarks'}",
            "PYTHONHASHSEED": "0",
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
            "CC": str(self._work / "compiler"),
            "UVMS_OCP_CACHE": str(cache),
            "COVERAGE_FILE": str(self._work / "coverage"),
        }
        if not compiles:
            environment |= {"MUTANTS_DO_NOT_COMPILE": "1"}
        return environment


def fingerprint(*folders: str) -> str:
    """Hash all files in folders of the repository."""
    digest = hashlib.sha256()
    paths = list[Path]()
    for folder in folders:
        paths += (ROOT / folder).rglob("*")
    for path in sorted(paths):
        if path.is_file() and "__pycache__" not in path.parts and path.suffix != ".csv":
            digest.update(str(path.relative_to(ROOT)).encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _write(path: Path, content: bytes) -> None:
    """Write a file, and remove the bytecode of what stood there: that is told by time and size,
    which may well be the same.
    """
    path.write_bytes(content)
    for old in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
        old.unlink()


def _run(
    command: list[str], folder: Path, environment: dict[str, str], text: str, timeout: float
) -> str:
    process = subprocess.Popen(
        command,
        cwd=folder,
        env=environment,
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )
    try:
        printed, _ = process.communicate(text, timeout=timeout)
    except subprocess.TimeoutExpired:
        return "its time was over"
    finally:
        _end(process)
    return _last(printed) or f"ended with {process.returncode}"


def _end(process: subprocess.Popen[str]) -> None:
    """The tests and what they started."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        return
    process.wait()


def _last(text: str) -> str:
    return " | ".join(line.strip() for line in text.strip().splitlines()[-3:])
