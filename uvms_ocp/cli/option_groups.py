"""Turn a dataclass among the parameters of a command into options, one for each field."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import Any, get_type_hints


def expand_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return the command with an option for each field of those parameters that are dataclasses.

    typer reads the options of a command from its signature.
    """
    declared = signature(command, eval_str=True).parameters.values()
    groups = dict[str, Any]()
    group_parameters = dict[str, list[Parameter]]()
    parameters = list[Parameter]()
    for parameter in declared:
        if is_dataclass(parameter.annotation):
            options = _fields_as_parameters(parameter.annotation)
            groups[parameter.name] = parameter.annotation
            group_parameters[parameter.name] = options
            parameters += options
        else:
            parameters.append(parameter.replace(kind=Parameter.KEYWORD_ONLY))

    @wraps(command)
    def expanded(**options: Any) -> None:
        arguments = dict[str, Any]()
        for name, group in groups.items():
            values = {option.name: options.pop(option.name) for option in group_parameters[name]}
            arguments[name] = group(**values)
        command(**arguments, **options)

    expanded.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    expanded.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    return expanded


def _fields_as_parameters(group: Any) -> list[Parameter]:
    hints = get_type_hints(group, include_extras=True)
    parameters = []
    for field in fields(group):
        parameters.append(
            Parameter(
                field.name,
                Parameter.KEYWORD_ONLY,
                default=field.default,
                annotation=hints[field.name],
            )
        )
    return parameters


def defaults_of(kind: type[Any]) -> dict[str, Any]:
    """Return defaults of the fields of a dataclass that have one, for options that are to have the
    same.
    """
    return {field.name: field.default for field in fields(kind) if field.default is not MISSING}
