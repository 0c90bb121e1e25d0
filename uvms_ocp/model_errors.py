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

_SHOWN_PROBLEMS = 3  # of a file, in one line
_LONGEST_KEY = 200  # characters of a key that is shown as it is


class FileModel(BaseModel):
    """Base of what files hold: values that stay as they are, and no other keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def one_line(error: ValidationError, model: type[BaseModel]) -> str:
    """Describe the mistakes of a file read as ``model``, the first few in full."""
    problems = problems_of(error, model)
    texts = problems[:_SHOWN_PROBLEMS]
    n_hidden = len(problems) - len(texts)
    if n_hidden:
        texts.append(f"{n_hidden} more")
    return "; and ".join(texts)


def problems_of(error: ValidationError, model: type[BaseModel]) -> list[str]:
    """Describe all mistakes of a file read as ``model``, each with its key."""
    problems = _deepest_problems(error)
    return [f"{printable(key)}: {_describe(problems[key], model)}" for key in problems]


def one_line_errors(model: type[_M]) -> type[_M]:
    """Make a model's constructor raise `InvalidInput` in place of pydantic's own error."""
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


def _deepest_problems(error: ValidationError) -> dict[str, Any]:
    """Return one problem per key, without those of keys above: of the alternatives that a value
    does not fit, the one that it got furthest with.
    """
    problems: dict[str, Any] = {}
    for problem in error.errors(include_url=False):
        key = ".".join(_keys_of(problem)) or "file"
        if key not in problems or len(problem["loc"]) > len(problems[key]["loc"]):
            problems[key] = problem
    keys_above = set[str]()
    for key in problems:
        parents = key.split(".")[:-1]
        keys_above.update(accumulate(parents, "{}.{}".format))
    return {key: problems[key] for key in problems if key not in keys_above}


def _keys_of(problem: Any) -> list[str]:
    """Return the keys that lead to the problem in the file."""
    location = [str(part) for part in problem["loc"]]
    unknown_key = []
    if problem["type"] == "extra_forbidden":
        unknown_key = [location.pop()]  # which may have brackets of its own
    # pydantic names the alternative that it tried, in brackets.
    keys = [part for part in location if "[" not in part]
    return keys + unknown_key


def printable(key: object) -> str:
    """Return a key or a path as messages show it: as it is where it fits in a line."""
    text = str(key)
    if text.isprintable() and len(text) <= _LONGEST_KEY:
        return text
    return short(text)


def _describe(problem: Any, model: type[BaseModel]) -> str:
    """Say what was given at a key, and what is allowed or to be done there."""
    if problem["type"] == "missing":
        *section, key = _keys_of(problem)
        model_field = _fields(section, model).get(key)
        if model_field is None or not model_field.description:
            return "missing; give it a value"
        return f"missing; give {model_field.description}"
    if problem["type"] == "extra_forbidden":
        return f"unknown key; {_advice(_keys_of(problem), model)}"
    message = problem["msg"].removeprefix("Value error, ").replace("Input should be", "allowed:")
    return f"given {short(problem['input'])}; {message.partition(', unable to parse')[0]}"


def _advice(path: Sequence[str], model: type[BaseModel]) -> str:
    """Name the known key that is nearest to an unknown one, or all that its section may have."""
    *section, key = path
    known_keys = sorted(_fields(section, model))
    close = get_close_matches(key, known_keys, n=1)
    if close:
        return f"did you mean {close[0]!r}?"
    return f"known here: {', '.join(known_keys)}"


def _fields(section: Sequence[str], model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return the fields that may stand in a section, given by its path in the file."""
    models = [model]
    for part in section:
        fields_there = [outer.model_fields[part] for outer in models if part in outer.model_fields]
        # Any other part is the name or the number of an entry, whose model is known already.
        if fields_there:
            models = []
            for model_field in fields_there:
                models += _models(model_field.annotation)
    fields: dict[str, FieldInfo] = {}
    for section_model in models:
        fields |= section_model.model_fields
    return fields


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the models that occur in an annotation such as ``dict[str, A | B]``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models(argument)
