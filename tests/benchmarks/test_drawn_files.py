"""Drawn robot files: each goes from the file through all commands, or is refused in one line for a
reason that is true.
"""

from __future__ import annotations

import numpy as np
import pytest
from studies.drawn_files import (
    REASONS,
    URDF,
    WATER,
    drawn_files,
    reason_of,
    run_file,
    sound,
    totals,
)

from uvms_ocp.campaign.jobs import Row

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")


def rows_of(seeds: range) -> list[Row]:
    return [run_file(case) for case in drawn_files(n=len(seeds), seed=seeds.start).cases]


def check(rows: list[Row]) -> None:
    for row in rows:
        told = f"seed {row['seed']}, {row['first']} and {row['second']}: {row['text']}"
        assert row["outcome"] in ("through", "refused"), told
        assert (row["outcome"] == "through") == (not row["text"]), told
        assert not row["text"] or reason_of(row["text"]), told
        assert "\n" not in row["text"]


@pytest.fixture
def not_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """What runs for two seconds is not worth compiling."""
    monkeypatch.setattr("uvms_ocp.codegen.c_compiler.find_compiler", lambda: None)


@pytest.mark.sampled
@pytest.mark.usefixtures("not_compiled")
@pytest.mark.parametrize("seed", [1, 17])
def test_a_drawn_file_goes_through_or_has_a_reason(seed: int) -> None:
    check(rows_of(range(seed, seed + 1)))


@pytest.mark.slow
@pytest.mark.usefixtures("not_compiled")
@pytest.mark.parametrize("first", range(1000, 1036, 6))
def test_drawn_files_go_through_or_have_a_reason(first: int) -> None:
    check(rows_of(range(first, first + 6)))


@pytest.mark.parametrize("arms", [0, 1, 2])
def test_every_change_changes_a_sound_robot(arms: int) -> None:
    """Else a pair would be drawn of one."""
    rng = np.random.default_rng(0)
    for name, change in URDF.items():
        drawn = sound(arms)
        before = [(e.tag, dict(e.attrib)) for e in sound(arms).urdf.iter()]
        change(drawn, rng)
        changed = [(e.tag, dict(e.attrib)) for e in drawn.urdf.iter()] != before
        assert changed or (arms == 0 and name in _OF_ARMS), name


_OF_ARMS = (
    "no tip",
    "two ends",
    "camera on the wrist",
    "fingers",
    "continuous joints",
    "a prismatic joint",
    "a planar joint",
    "zero range",
    "range without 0",
    "no limits",
    "limits of 0",
    "a joint that mimics",
)


def test_totals_count_each_file_under_both_of_its_changes() -> None:
    first = next(iter(URDF))
    second = next(iter(WATER))
    rows = [
        {"first": first, "second": second, "outcome": "through"},
        {"first": first, "second": "x", "outcome": "fault"},
    ]
    total = {row["change"]: row for row in totals(rows)}
    assert (total[first]["through"], total[first]["fault"], total[second]["files"]) == (1, 1, 1)
    assert (total["all"]["files"], total["all"]["through"]) == (2, 1)


@pytest.mark.parametrize("reason", REASONS)
def test_a_reason_is_found_in_what_is_said(reason: str) -> None:
    assert reason_of(f"load: x.urdf: {REASONS[reason]} so") == reason
    assert reason_of("load: nothing is known") == ""
