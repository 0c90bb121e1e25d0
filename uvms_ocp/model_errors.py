"""Models of what files hold, and what pydantic found wrong in one line: each key with what was
given and what is allowed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from functools import wraps
from itertools import accumulate
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo

from uvms_ocp.errors import InvalidInput, short

_M = TypeVar("_M", bound=BaseModel)
# mistakes, characters of a key
_SHOWN = 3
_LONGEST = 200


class FileModel(BaseModel):
    """Base of what files hold: values that stay as they are, and no other keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def one_line(error: ValidationError, model: type[BaseModel]) -> str:
    """The mistakes of a file read as ``model``, the first few in full."""
    texts = problems_of(error, model)
    n_hidden = len(texts) - _SHOWN
    return "; and ".join(texts[:_SHOWN]) + (f"; and {n_hidden} more" if n_hidden > 0 else "")


def problems_of(error: ValidationError, model: type[BaseModel]) -> list[str]:
    """All mistakes of a file read as ``model``, each with its key."""
    return [
        f"{printable(key)}: {_problem(problem, model)}" for key, problem in _by_key(error).items()
    ]


def one_line_errors(model: type[_M]) -> type[_M]:
    """A model whose constructor raises `InvalidInput` in place of pydantic's own error."""
    construct = model.__init__

    @wraps(construct)
    def init(self: _M, /, **data: Any) -> None:
        try:
            construct(self, **data)
        except ValidationError as error:
            raise InvalidInput(f"{model.__name__}: {one_line(error, model)}") from None

    # Set afterwards, so that pydantic does not call it for the parts of a file, of which it tells
    # the place itself.
    model.__init__ = init  # type: ignore[method-assign, assignment]
    return model


def _by_key(error: ValidationError) -> dict[str, Any]:
    """One problem per key: of the alternatives that a value does not fit, the one that it got
    furthest with.
    """
    problems: dict[str, Any] = {}
    for problem in error.errors(include_url=False):
        key = ".".join(_keys_of(problem)) or "file"
        if key not in problems or len(problem["loc"]) > len(problems[key]["loc"]):
            problems[key] = problem
    # What is wrong inside a value is told by the deepest key.
    above = {
        prefix for key in problems for prefix in accumulate(key.split(".")[:-1], "{}.{}".format)
    }
    return {key: problems[key] for key in problems if key not in above}


def _keys_of(problem: Any) -> list[str]:
    """Return the keys that lead to the problem in the file."""
    location = [str(part) for part in problem["loc"]]
    # pydantic names the alternative that it tried, in brackets; an unknown key, which comes last,
    # may have some of its own.
    last_key = location[-1:] if problem["type"] == "extra_forbidden" else []
    return [
        *(part for part in location[: len(location) - len(last_key)] if "[" not in part),
        *last_key,
    ]


def printable(key: object) -> str:
    """A key or a path as messages show it: as it is where it fits in a line."""
    key = str(key)
    if key.isprintable() and len(key) <= _LONGEST:
        return key
    return short(key)


def _problem(problem: Any, model: type[BaseModel]) -> str:
    if problem["type"] == "missing":
        *section, key = _keys_of(problem)
        model_field = _fields(section, model).get(key)
        return f"missing; give {(model_field and model_field.description) or 'it a value'}"
    if problem["type"] == "extra_forbidden":
        return f"unknown key; {_advice(_keys_of(problem), model)}"
    message = problem["msg"].removeprefix("Value error, ").replace("Input should be", "allowed:")
    return f"given {short(problem['input'])}; {message.partition(', unable to parse')[0]}"


def _advice(path: Sequence[str], model: type[BaseModel]) -> str:
    *section, key = path
    known_keys = sorted(_fields(section, model))
    close = get_close_matches(key, known_keys, n=1)
    if close:
        return f"did you mean {close[0]!r}?"
    return f"known here: {', '.join(known_keys)}"


def _fields(section: Sequence[str], model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Fields that may stand in a section, given by its path in the file."""
    models = [model]
    for part in section:
        fields = [m.model_fields[part] for m in models if part in m.model_fields]
        # Any other part is the name or the number of an entry, whose model is known already.
        if fields:
            models = [m for field in fields for m in _models(field.annotation)]
    return {name: field for m in models for name, field in m.model_fields.items()}


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Models that occur in an annotation such as ``dict[str, A | B]``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models(argument)
