"""What reports say in words has computed figures only."""

from __future__ import annotations

import re
from importlib import import_module

import pytest
from benchmark_registry import BENCHMARKS

SCRIPTS = sorted({benchmark.script for benchmark in BENCHMARKS})
NAMES = ("Case 1", "case1", "Table 2", "BlueROV2", "Alpha 5")
NO_FIGURE = re.compile(r"\{[^{}]*\}|`[^`]*`|\^[23]\b|" + "|".join(NAMES))
"""What is filled in, code, units and names."""


@pytest.mark.parametrize("script", SCRIPTS)
def test_no_figure_is_typed(script: str) -> None:
    prose: str = import_module(script).PROSE
    typed = NO_FIGURE.sub("", prose)
    assert re.findall(r".{0,30}\d.{0,10}", typed) == []


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_benchmark_says_how_it_is_called(script: str) -> None:
    module = import_module(script)
    assert f"python benchmarks/{script}.py" in (module.__doc__ or "")
    assert module.main.__doc__
