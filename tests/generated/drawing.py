"""Strategies that draw the same on every machine, out of booleans alone.

Of the integers, floats, texts and bytes of its own Hypothesis takes one in twenty from constants in
the source of those modules that happen to be loaded and that are not in site-packages: other inputs
where the package is installed in another way or after another test. What is drawn in lists of them
counts too. Its booleans know nothing of that.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Any, TypeVar

from hypothesis import strategies as st

T = TypeVar("T")
_EVEN = 2  # bits more than needed, so that all values are about as likely
_ODD_FLOATS = (
    *(0.0, -0.0, 1.0, -1.0, 0.5, 2.0, math.pi, 1e-9, 1e9, 1e16, 1e30, 1e155, 1e-155),
    *(
        5e-324,
        2.2250738585072014e-308,
        1.7976931348623157e308,
        -1.7976931348623157e308,
        1.0000000000000002,
    ),
    *(math.inf, -math.inf, math.nan, -math.nan),
)
_ODD_LETTERS = (
    "\0\x00\t\n\r\x1b\x7f\x85\xa0\xad\u0130\u0301\u0660\u200b\u202e\u2028\ufeff\uffff"
    "\U0001f41f\U0010ffff"
)
_LETTERS = "".join(map(chr, range(32, 127)))
_LAST_LETTER = 0x10FFFF
_SURROGATES = range(0xD800, 0xE000)


def integers(largest: int, smallest: int = 0) -> st.SearchStrategy[int]:
    """Whole numbers from `smallest` to `largest`, about evenly; the simplest is `smallest`."""
    n = largest - smallest + 1
    bits = (largest - smallest).bit_length()
    if n != 1 << bits:
        bits += _EVEN
    return _bits(bits).map(lambda drawn: smallest + (drawn * n >> bits))


def _bits(n: int) -> st.SearchStrategy[int]:
    return st.tuples(*[st.booleans()] * n).map(
        lambda bits: sum(bit << k for k, bit in enumerate(reversed(bits)))
    )


def chosen(values: Sequence[T]) -> st.SearchStrategy[T]:
    """One of the values."""
    return integers(len(values) - 1).map(lambda k: values[k])


def either(*strategies: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """What one of the strategies draws."""
    return integers(len(strategies) - 1).flatmap(lambda k: strategies[k])


def _float_of(pattern: int) -> float:
    """Of the first 16 of 64 bits: sign, exponent and the beginning of the mantissa."""
    return float(struct.unpack(">d", (pattern << 48).to_bytes(8, "big"))[0])


def floats() -> st.SearchStrategy[float]:
    """Any: odd ones, everyday ones, and ones of every size."""
    return either(
        chosen(_ODD_FLOATS),
        integers(8191, -8192).map(lambda n: n / 64.0 + 0.1),
        _bits(16).map(_float_of),
    )


def shares() -> st.SearchStrategy[float]:
    """From 0 to 1, both included."""
    return _bits(10).map(lambda n: n / 1023.0)


def _letter(code: int) -> str:
    return "\ufffd" if code in _SURROGATES else chr(code)


def letters() -> st.SearchStrategy[str]:
    """Any that can be written as UTF-8; every second one is on keyboards."""
    return either(
        chosen(_LETTERS),
        chosen(_LETTERS),
        chosen(_ODD_LETTERS),
        integers(_LAST_LETTER).map(_letter),
    )


def texts(alphabet: str = "", *, min_size: int = 0, max_size: int) -> st.SearchStrategy[str]:
    """From `min_size` to `max_size` letters of an alphabet, or of any."""
    letter = chosen(alphabet) if alphabet else letters()
    return st.lists(letter, min_size=min_size, max_size=max_size).map("".join)


def binary(*, min_size: int = 0, max_size: int) -> st.SearchStrategy[bytes]:
    """From `min_size` to `max_size` bytes."""
    return st.lists(integers(255), min_size=min_size, max_size=max_size).map(bytes)
