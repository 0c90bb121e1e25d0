"""What is promised for any input: a value that keeps its contract, or a `UvmsError` of one line;
and how many were bad.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from drawing import binary, chosen, either, floats, integers, shares, texts
from hypothesis import strategies as st

from uvms_ocp.errors import UvmsError

T = TypeVar("T")
LONGEST = 2000
"""Characters of a message."""


class Tally:
    """Counts the good and bad inputs of a family that were tried."""

    def __init__(self, *, bad: int, good: int = 1) -> None:
        """How many of each there have to be at least."""
        self.least_bad = bad
        self.least_good = good
        self.good = 0
        self.bad = 0

    def outcome(self, make: Callable[[], T]) -> T | None:
        """What `make` gives; `None` where it refuses as promised. Anything else that it raises is
        let through.
        """
        try:
            value = make()
        except UvmsError as error:
            message = str(error)
            assert message.strip()
            assert len(message.splitlines()) == 1
            assert len(message) <= LONGEST
            self.bad += 1
            return None
        self.good += 1
        return value

    def check(self) -> None:
        """Enough bad inputs, and some good ones, so that it is not all refused at the door."""
        assert self.bad >= self.least_bad, f"{self.bad} bad, {self.good} good"
        assert self.good >= self.least_good, f"{self.bad} bad, {self.good} good"


ODD: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 3, 1 << 70, -(10**90), 10**99),
    *(0.0, -0.0, 0.5, -1.5, 1e-320, 1e308, -1e308, float("inf"), float("-inf"), float("nan")),
    *(
        "",
        " ",
        "x",
        "yes",
        "1",
        "1e3",
        "1_0",
        "nan",
        "base_link",
        "\n",
        "\u0660",
        "é\u202e",
        "{",
        "$",
        "a" * 300,
    ),
    *(
        [],
        [0.0],
        [0.0] * 3,
        [1.0] * 6,
        [[1.0] * 6] * 6,
        [None],
        [[]],
        {},
        {"a": 1},
        {"": None},
        [{}] * 3,
    ),
)
"""Values that somebody will write where something else belongs."""


def paths(value: Any, start: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Where something stands in nested lists and mappings, below `start`."""
    if isinstance(value, dict):
        items = list(value.items())
    elif isinstance(value, list):
        items = list(enumerate(value))
    else:
        return [start]
    below = [start]
    for key, item in items:
        below += paths(item, (*start, key))
    return below


def changed(value: Any, path: tuple[Any, ...], change: Callable[[Any, Any], None]) -> Any:
    """A copy in which `change(container, key)` was done to what stands at the path."""
    if isinstance(value, dict):
        copy: Any = dict(value)
    else:
        copy = list(value)
    if len(path) == 1:
        change(copy, path[0])
    else:
        copy[path[0]] = changed(value[path[0]], path[1:], change)
    return copy


def _replace(new: Any) -> Callable[[Any, Any], None]:
    def change(container: Any, key: Any) -> None:
        container[key] = new

    return change


def _remove(container: Any, key: Any) -> None:
    del container[key]


def _repeat(container: Any, key: Any) -> None:
    if isinstance(container, list):
        container.append(container[key])
    else:
        container[f"{key}_"] = container[key]


def _rename(container: Any, key: Any) -> None:
    if isinstance(container, dict):
        container[f"{key}"[:-1] or "z"] = container.pop(key)
    else:
        container.reverse()


CHANGES: st.SearchStrategy[Callable[[Any, Any], None]] = either(
    chosen(ODD).map(_replace),
    floats().map(_replace),
    texts(max_size=8).map(_replace),
    chosen([_remove, _repeat, _rename]),
)


@st.composite
def damaged(draw: st.DrawFn, whole: Any, max_changes: int = 3) -> Any:
    """Nested lists and mappings with one to `max_changes` changes."""
    value = whole
    for _ in range(draw(integers(max_changes, 1))):
        places = [path for path in paths(value) if path]
        if not places:
            break
        value = changed(value, draw(chosen(places)), draw(CHANGES))
    return value


Damage = tuple[str, float, float, bytes]
"""What happens to a file, from where to where in shares of its length, and what is written
there.
"""
DAMAGES: st.SearchStrategy[Damage] = st.tuples(
    chosen(["cut", "overwrite", "flip", "twice", "without", "nothing"]),
    shares(),
    shares(),
    binary(min_size=1, max_size=6),
)


def damaged_bytes(whole: bytes, damage: Damage) -> bytes:
    """Cut off, overwritten, changed by a bit, repeated or shortened."""
    kind, *shares_of_length, new = damage
    start, end = sorted(round(share * len(whole)) for share in shares_of_length)
    flipped = bytes(byte ^ (1 << new[0] % 8) for byte in whole[start : start + 1])
    results = {
        "cut": whole[:start],
        "overwrite": whole[:start] + new + whole[start + len(new) :],
        "flip": whole[:start] + flipped + whole[start + 1 :],
        "twice": whole[:end] + whole[start:],
        "without": whole[:start] + whole[end:],
        "nothing": whole,
    }
    return results[kind]
