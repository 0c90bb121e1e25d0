"""Case 1 on both plants with three solvers, and a plan of each method, come to what was
recorded.
"""

from __future__ import annotations

import json
from typing import Any

import pytest
from outlines import OUTLINES, RECORDED

pytestmark = pytest.mark.slow

TOLERANCES = {
    "_s": (0.05, 0.0),
    "_m": (1e-4, 0.02),
    "_rad": (1e-4, 0.02),
    "_j": (0.0, 0.02),
    "_n": (0.0, 0.02),
}
"""Absolute and relative, by unit: last bits differ from one processor to the next, and what follows
from them a little.
"""
OUTLINES_ON_RECORD = json.loads(RECORDED.read_text(encoding="utf-8"))


def near(name: str, value: Any) -> Any:
    if isinstance(value, dict):
        return {key: near(name, entry) for key, entry in value.items()}
    if not isinstance(value, float):
        return value
    absolute, relative = next(limits for unit, limits in TOLERANCES.items() if name.endswith(unit))
    return pytest.approx(value, abs=absolute, rel=relative)


@pytest.mark.parametrize("name", OUTLINES)
def test_numbers_stay_unless_they_are_recorded_anew_with_a_reason(name: str) -> None:
    computed = OUTLINES[name]()
    recorded = OUTLINES_ON_RECORD["outlines"][name]
    phases = recorded.pop("phases", {})
    ends = {phase: near("end_s", end) for phase, end in phases.items()}
    assert computed.pop("phases", {}) == ends
    assert computed == {key: near(key, value) for key, value in recorded.items()}


def test_what_moved_the_numbers_is_told() -> None:
    assert len(OUTLINES_ON_RECORD["reason"].split()) > 3
    assert list(OUTLINES_ON_RECORD["outlines"]) == list(OUTLINES)
