"""A plan as arrays and one text of values, in an ``.npz`` file or all of it in a ``.json`` file; and back, within bounds.

Every number comes back as it was: arrays are stored as they are, texts hold the shortest decimals that round to the same.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ValidationError

from uvms_ocp.exceptions import InvalidInput, OutputError
from uvms_ocp.meta_values import MetaValue, Number, SurroundingsMeta
from uvms_ocp.untrusted.array_file import read_arrays
from uvms_ocp.untrusted.regular_file import read_text
from uvms_ocp.validation import one_line, shown

_TEXT = "summary"
_NO_PLAN = f"no text {_TEXT!r}; give the plan.npz that `Plan.save` wrote"
_LARGEST = 256 << 20  # [B] of a text


class LevelValues(MetaValue):
    """Of one level; see `uvms_ocp.ocp.plan.LevelReport`."""

    name: str
    status: str
    advice: str
    residual: float
    """[-]"""
    iterations: int
    prices: tuple[float, ...] = ()
    """[-]"""


class SolverValues(MetaValue):
    """Of the solver's result beside its arrays; see `uvms_ocp.solvers.nlp.lexicographic_nlp.LexicographicResult`."""

    status: str
    level_status: tuple[str, ...]
    iterations: tuple[int, ...]
    anticipated: bool
    violation: float
    """[-]"""
    solve_time: Number


class ClearanceValues(MetaValue):
    """See `uvms_ocp.collision.conservative_advancement.ClearanceReport`, and `Nearest` for the last three."""

    unshaped: tuple[str, ...] = ()
    collision_free: bool
    undecided: bool
    n_samples: int
    distance: float
    """[m]"""
    time: Number
    pair: str


class PlanValues(MetaValue):
    """What a file of a plan tells beside its arrays."""

    version: Literal["1"] = "1"
    status: str
    reason: str
    advice: str
    robot: str
    duration: Number
    energy: float | None
    """[J]"""
    peak_thrust: float | None
    """[N]"""
    iterations: int
    solve_time: Number
    levels: tuple[LevelValues, ...]
    of_wrench: bool
    surroundings: SurroundingsMeta
    current: tuple[Number, Number, Number]
    solver: SolverValues | None = None
    clearance: ClearanceValues | None = None


Arrays = Mapping[str, np.ndarray]
"""By name."""


def write_plan(target: Path, values: PlanValues, arrays: Arrays) -> Path:
    """Write ``.json`` where the name ends so, else ``.npz``; returns the path. Raises `OutputError`."""
    text = values.model_dump_json()
    if target.suffix != ".json":
        return write_arrays(target, _TEXT, text, arrays)
    lists = {name: array.tolist() for name, array in arrays.items()}
    with _writing(target):
        target.write_text(json.dumps(json.loads(text) | lists), encoding="utf-8")
    return target


def write_arrays(target: Path, key: str, text: str, arrays: Arrays) -> Path:
    """Write a text under a key beside arrays as ``.npz``, with that ending; returns the path. Raises `OutputError`."""
    place = target.with_suffix(".npz")
    with _writing(place), place.open("wb") as file:
        np.savez(file, allow_pickle=False, **{key: np.array(text)}, **arrays)
    return place


@contextmanager
def _writing(target: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OutputError(f"cannot write {target}: {error.strerror}; choose another place") from error


def read_plan(source: Path) -> tuple[PlanValues, dict[str, np.ndarray]]:
    """What `write_plan` wrote; arrays hold finite numbers.

    Raises `InvalidInput`, in one line, for what is no such file, is damaged or too large.
    """
    try:
        values, arrays = _from_text(source) if source.suffix == ".json" else from_arrays(source, _TEXT, _NO_PLAN)
        for name, array in arrays.items():
            if array.dtype != np.float64 or not np.isfinite(array).all():
                raise InvalidInput(f"array {name[:60]!r} is {array.dtype} or not finite; allowed: finite float64")
        return PlanValues.model_validate_json(json.dumps(values), strict=True), arrays
    except ValidationError as error:
        raise InvalidInput(f"{shown(str(source))}: not a plan: {one_line(error, PlanValues)}") from error
    except OSError as error:
        raise InvalidInput(f"{shown(str(source))}: not a plan: {error.strerror}") from error
    except InvalidInput as error:
        raise InvalidInput(f"{shown(str(source))}: not a plan written by uvms_ocp: {error}") from error


def from_arrays(source: Path, key: str, missing: str) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The object in the text under a key, and the arrays beside it, of a file that anyone may have written.

    missing: what to say where there is none. Raises `InvalidInput`.
    """
    arrays = dict(read_arrays(source))
    text = arrays.pop(key, np.zeros(0))
    if text.dtype.kind != "U" or text.shape != ():
        raise InvalidInput(missing)
    return _object(str(text)), arrays


def _from_text(source: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Lists beside the values are the arrays."""
    whole = _object(read_text(source, _LARGEST))
    values = {name: whole.pop(name) for name in PlanValues.model_fields if name in whole}
    try:
        return values, {name: np.atleast_1d(np.array(item, dtype=float)) for name, item in whole.items()}
    except (ValueError, TypeError, OverflowError) as error:
        raise InvalidInput(f"lists that are no arrays of numbers: {str(error)[:100]}") from error


def _object(text: str) -> dict[str, Any]:
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidInput(f"a text that is no JSON: {str(error)[:200]}") from error
    if not isinstance(values, dict):
        raise InvalidInput(f"a text that is a {type(values).__name__}; allowed: an object")
    return values
