"""Defaults are a promise: none changes unless it is recorded anew, with a reason."""

from __future__ import annotations

import json

from defaults import RECORDED, defaults

KEPT = json.loads(RECORDED.read_text(encoding="utf-8"))


def test_no_default_changes_in_passing() -> None:
    assert defaults() == KEPT["defaults"], "record anew: python tests/arguments/defaults.py --reason WHY"


def test_what_moved_the_defaults_is_told() -> None:
    assert len(KEPT["reason"].split()) > 3
