"""What two texts must share that tell of the same, found twice."""

from __future__ import annotations

import re

import pytest

_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
_SHOWN = 1e-2
"""of a number that is shown with three digits."""


def require_same_words(text: str, expected: str) -> None:
    """The same words, and numbers that are the same as far as they are shown."""
    assert _NUMBER.split(text) == _NUMBER.split(expected)
    numbers = [float(number) for number in _NUMBER.findall(text)]
    expected_numbers = [float(number) for number in _NUMBER.findall(expected)]
    assert numbers == pytest.approx(expected_numbers, rel=_SHOWN)
