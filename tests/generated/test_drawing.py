"""Inputs are the same wherever the tests run."""

from __future__ import annotations

import importlib.util
import math
import re
import sys
from pathlib import Path
from typing import Any

import pytest
from drawing import binary, either, floats, integers, letters, shares, texts
from hypothesis import given, settings, strategies as st
from promises import CHANGES, DAMAGES, damaged

ALLOWED = {"booleans", "tuples", "lists", "composite", "DrawFn", "SearchStrategy"}
"""What Hypothesis draws by booleans, or does not draw at all."""
ALL = {
    "integers": integers(10**12, -(10**12)),
    "floats": floats(),
    "shares": shares(),
    "letters": letters(),
    "text": texts(max_size=12),
    "data": binary(max_size=12),
    "either": either(integers(3), texts("abc", max_size=2)),
    "damages": DAMAGES,
    "changes": CHANGES.map(lambda change: change.__qualname__),
    "damaged": damaged({"a": [1.0, 2.0], "b": {"c": "d"}}),
}


def drawn(strategy: st.SearchStrategy[Any], n: int = 60) -> list[str]:
    """So many values."""
    values = []

    @settings(derandomize=True, max_examples=n)
    @given(strategy)
    def collect(value: Any) -> None:
        values.append(repr(value))

    collect()
    return values


@pytest.mark.sampled
@pytest.mark.parametrize("name", ALL)
def test_values_do_not_depend_on_what_else_is_loaded(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such as a package that is worked on in its folder, with numbers and texts in it."""
    before = drawn(ALL[name])
    path = tmp_path / f"own_{name}.py"
    path.write_text(
        "VALUES ="
        f" {[*range(3, 4000, 7), *(f'text {k}' for k in range(50)), *(k / 7 for k in range(1, 300))]}"
    )
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, path.stem, module)
    spec.loader.exec_module(module)
    assert drawn(ALL[name]) == before
    assert len(set(before)) > 3


@pytest.mark.parametrize(
    "path", sorted(Path(__file__).parent.glob("*.py")), ids=lambda path: path.stem
)
def test_nothing_else_of_hypothesis_is_drawn(path: Path) -> None:
    assert set(re.findall(r"\bst\.(\w+)", path.read_text())) <= ALLOWED


def test_whole_numbers_are_all_there_and_none_else() -> None:
    assert {int(value) for value in drawn(integers(9, -3), 200)} == set(range(-3, 10))


def test_floats_are_odd_small_large_and_ordinary() -> None:
    values = [float(value) for value in drawn(floats(), 300)]
    assert any(map(math.isnan, values))
    assert any(map(math.isinf, values))
    sizes = [abs(value) for value in values if math.isfinite(value) and value]
    assert min(sizes) < 1e-100 < 1e100 < max(sizes)
    assert sum(1e-3 <= size <= 200.0 for size in sizes) >= 60
