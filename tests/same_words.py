"""What two texts must share that tell of the same, found twice."""

from __future__ import annotations

import re

import pytest

_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
_SHOWN = 1e-2
"""of a number that is shown with three digits."""


def require_same_words(found: str, wanted: str) -> None:
    """The same words, and numbers that are the same as far as they are shown."""
    assert _NUMBER.split(found) == _NUMBER.split(wanted)
    numbers, others = (
        [float(number) for number in _NUMBER.findall(text)] for text in (found, wanted)
    )
    assert numbers == pytest.approx(others, rel=_SHOWN)
