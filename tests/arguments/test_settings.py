"""Settings are a promise: no default and no range changes unless it is recorded anew, with a reason."""

from __future__ import annotations

import json

from settings import RECORDED, defaults, ranges

KEPT = json.loads(RECORDED.read_text(encoding="utf-8"))
ANEW = "record anew: python tests/arguments/settings.py --reason WHY"


def test_no_default_changes_in_passing() -> None:
    assert defaults() == KEPT["defaults"], ANEW


def test_no_setting_takes_other_numbers_in_passing() -> None:
    assert ranges() == KEPT["ranges"], ANEW


def test_what_moved_the_settings_is_told() -> None:
    assert len(KEPT["reason"].split()) > 3
