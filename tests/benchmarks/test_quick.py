"""Every benchmark runs, writes the files it is listed with, and leaves the recorded ones alone."""

from __future__ import annotations

import csv
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from benchmark_registry import BENCHMARKS, ROOT, SCRIPTS, TOOLS, Benchmark
from compiler import long_without_compiler

RESULTS = SCRIPTS / "results"
PATIENCE = 3600.0  # [s] for one that compiles from empty caches beside other programs
READY = [benchmark for benchmark in BENCHMARKS if not benchmark.missing]
MISSING = sorted({benchmark.missing for benchmark in BENCHMARKS if benchmark.missing})
LEFT_OUT = f"{len(BENCHMARKS) - len(READY)} benchmarks, see CONTRIBUTING: {'; '.join(MISSING)}"
ELSEWHERE = []
if MISSING:
    ELSEWHERE.append(pytest.param(None, marks=pytest.mark.skip(reason=LEFT_OUT), id="elsewhere"))
"""One line for what cannot run here."""


def paced(benchmark: Benchmark) -> Any:
    """With its mark: most are long, and one that is not shows the writer of all files at work."""
    if benchmark.script == "calls":
        return benchmark
    return pytest.param(benchmark, marks=pytest.mark.slow)


def run(*words: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.run(
        [sys.executable, *words],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )


def recorded() -> dict[str, tuple[int, int]]:
    """Size and time of change of every recorded file."""
    return {path.name: (path.stat().st_size, path.stat().st_mtime_ns) for path in RESULTS.iterdir()}


@pytest.mark.sampled
@long_without_compiler
@pytest.mark.parametrize("benchmark", [*map(paced, READY), *ELSEWHERE], ids=str)
def test_a_benchmark_writes_its_files_with_one_head(benchmark: Benchmark, tmp_path: Path) -> None:
    before = recorded()
    process = run(*benchmark.words(tmp_path))
    assert process.returncode == 0, process.stderr
    assert recorded() == before
    report = f"{benchmark.files[0]}.md"
    tables = {f"{name}.csv" for name in benchmark.files}
    assert {path.name for path in tmp_path.iterdir()} == {report, *tables}
    head = [line.strip() for line in (tmp_path / report).read_text().splitlines()[2:6]]
    assert head[0].startswith(f"Written by `python benchmarks/{benchmark.script}.py ")
    assert "of the processors" in head[3]
    for name in benchmark.files:
        lines = (tmp_path / f"{name}.csv").read_text().splitlines()
        assert [line.removeprefix("# ") for line in lines[:4]] == head
        rows = list(csv.reader(lines[4:]))
        assert len(rows) > 1
        assert {len(row) for row in rows} == {len(rows[0])}


@pytest.mark.slow
def test_two_versions_can_be_compared(tmp_path: Path) -> None:
    """Every item is computed; two of them once more."""
    script = str(SCRIPTS / "same_numbers.py")
    process = run(script, "--record", str(tmp_path), "--quick")
    assert process.returncode == 0, process.stdout + process.stderr
    again = (
        script,
        "--against",
        str(tmp_path),
        "--quick",
        "--only",
        "kinematic-lexls",
        "minimum-snap",
    )
    process = run(*again)
    assert process.returncode == 0, process.stdout + process.stderr
    assert process.stdout.count("same bits") == 2
    (tmp_path / "minimum-snap.npz").unlink()
    assert run(*again).returncode == 1


def test_every_script_is_listed() -> None:
    listed = {benchmark.script for benchmark in BENCHMARKS}
    assert {path.stem for path in SCRIPTS.glob("*.py")} == {*TOOLS, *listed}


def test_every_recorded_file_has_a_benchmark_that_writes_it() -> None:
    written = set()
    for benchmark in BENCHMARKS:
        written.add(f"{benchmark.files[0]}.md")
        written.update(f"{name}.csv" for name in benchmark.files)
    assert {path.name for path in RESULTS.iterdir()} <= written


def test_a_recorded_file_states_the_command_of_its_benchmark() -> None:
    """Files that were recorded before there were heads have none."""
    scripts = {}
    for benchmark in BENCHMARKS:
        scripts |= dict.fromkeys(benchmark.files, benchmark.script)
    for path in RESULTS.iterdir():
        command = re.search(r"Written by `(.*?)` on ", path.read_text()[:400])
        if command:
            assert command[1].startswith(f"python benchmarks/{scripts[path.stem]}.py")
            assert "--quick" not in command[1]


def test_a_quick_run_must_say_where_to_write() -> None:
    process = run(str(SCRIPTS / "gates.py"), "--quick")
    assert process.returncode == 2
    assert (
        "--quick measures too little to be recorded; give another folder with --out PATH"
        in process.stderr
    )
