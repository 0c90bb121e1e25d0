"""A wrong argument is named, in one line, by the call that took it: thousands of wrong calls of everything public.

No argument may be of a type that nothing here takes; of other wrong values some are right somewhere.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from public_surface import Call, surface
from valid_calls import EXPENSIVE, REFUSES, STARRED, owner_of, right_arguments

from uvms_ocp.exceptions import UvmsError

CALLS = surface()
WORDS = {
    "limit": ("threshold",),
    "q0": ("q",),
    "start": ("q",),
    "reference": ("q",),
    "posture": ("joints",),
    "waypoints": ("way points?",),
    "quantities": ("quantity",),
    "p": ("parameters",),
    "order": ("task",),
    "density": ("water_density",),
    "dt": ("control period",),
    "factor": ("break",),
    "floor_z": ("z",),
    "heights": ("height",),
    "joints": ("joint",),
    "position": ("goal",),
}
"""What messages call a parameter."""
N_TRIED = 7  # of the wrong values, for each parameter, beside the wrong types
WRONG_TYPES = (object(), 1j, ...)
ACCEPTED = {("PassThrough.__call__", "command"): "not read, and taken only to stand where an `Estimator` does"}
"""Parameters that may be of any type, and why."""
WRONG: tuple[Any, ...] = (
    *WRONG_TYPES,
    None,
    "nonsense",
    "",
    b"bytes",
    "a\0b",
    "two\nlines",
    True,
    0,
    -1,
    3,
    10**30,
    0.5,
    -1.0,
    1e308,
    float("nan"),
    float("inf"),
    (),
    [],
    {},
    [object()],
    ["a", "b"],
    [1.0, [2.0, 3.0]],
    {"nonsense": 1.0},
    {3: object()},
    np.zeros(0),
    np.zeros(2),
    np.zeros((2, 3)),
    np.zeros(1000),
    np.full(3, np.nan),
    np.full((3, 3), np.inf),
    np.array(["a"]),
    np.array([object()]),
    lambda: None,
)


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.title)
def test_wrong_arguments_are_named(call: Call) -> None:
    right = right_arguments(call)
    if call.title not in EXPENSIVE:
        _right(call, right)
    rng = np.random.default_rng(sum(map(ord, call.title)))
    wrong = [fault for name in call.parameters for fault in _faults(call, right, name, rng)]
    assert not wrong, f"{len(wrong)} of {call.title}\n" + "\n".join(wrong)


def test_the_surface_is_large() -> None:
    assert sum(len(call.parameters) for call in CALLS) > 800


@pytest.mark.parametrize(("title", "name"), ACCEPTED)
def test_what_may_be_of_any_type_is_taken(title: str, name: str) -> None:
    call = next(call for call in CALLS if call.title == title)
    for value in WRONG_TYPES:
        _run(call, {**right_arguments(call), name: value})


def _right(call: Call, right: dict[str, Any]) -> None:
    try:
        _run(call, right)
    except UvmsError:
        assert call.title in REFUSES
    else:
        assert call.title not in REFUSES


def _faults(call: Call, right: dict[str, Any], name: str, rng: np.random.Generator) -> Iterator[str]:
    """Answers to wrong values of one parameter that break the promise."""
    if call.parameters[name].kind in STARRED:
        return
    chosen = () if call.title in EXPENSIVE else rng.permutation(len(WRONG))[:N_TRIED]
    for value in (*WRONG_TYPES, *(WRONG[i] for i in chosen)):
        try:
            _run(call, {**right, name: value})
            if any(value is wrong for wrong in WRONG_TYPES) and (call.title, name) not in ACCEPTED:
                yield f"{name} = {value!r}: accepted"
        except (UvmsError, TypeError) as error:
            text = str(error)
            if "\n" in text or not _named(name, value, text):
                yield f"{name} = {value!r}: {type(error).__name__}: {text}"
        except Exception as error:
            yield f"{name} = {value!r}: {type(error).__name__}: {error}"


def _named(name: str, value: Any, text: str) -> bool:
    """Whether a message says which argument it is about: by its name, in the words of the field, or by what was given."""
    words = (name, name.replace("_", " "), *WORDS.get(name, ()))
    given = [repr(value)] if not isinstance(value, (int, float, np.ndarray)) else []
    given += [value] if isinstance(value, str) and len(value) > 1 else []
    return any(re.search(rf"(?<!\w){word}(?!\w)", text) for word in words) or any(item in text for item in given)


def _run(call: Call, arguments: dict[str, Any]) -> None:
    if call.owner is None:
        call.function(**arguments)
    else:
        call.function(owner_of(call), **arguments)
