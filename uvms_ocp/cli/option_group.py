"""Options that several commands share, written once as fields of a dataclass."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, fields
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import Any, get_type_hints


def spread_options(command: Callable[..., None]) -> Callable[..., None]:
    """A command whose first parameter is a dataclass, as one that has the fields of it as options of its own.

    typer reads the options of a command from its signature: first those of the dataclass, then the others.
    """
    first, *own = signature(command, eval_str=True).parameters.values()
    group: Any = first.annotation
    hints = get_type_hints(group, include_extras=True)
    shared = [
        Parameter(field.name, Parameter.KEYWORD_ONLY, default=field.default, annotation=hints[field.name])
        for field in fields(group)
    ]

    @wraps(command)
    def spread(**options: Any) -> None:
        values = {parameter.name: options.pop(parameter.name) for parameter in shared}
        command(group(**values), **options)

    parameters = [*shared, *(parameter.replace(kind=Parameter.KEYWORD_ONLY) for parameter in own)]
    spread.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    spread.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    return spread


def defaults_of(kind: type[Any]) -> dict[str, Any]:
    """Defaults of the fields of a dataclass that have one, for options that are to have the same."""
    return {field.name: field.default for field in fields(kind) if field.default is not MISSING}
