"""Functions that are written as source, with the parameters of another function: what runs at every
tick has no time for `*args` and `**kwargs`, which take ten times as long to pass on.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

_STARS: dict[Any, str] = {
    inspect.Parameter.VAR_POSITIONAL: "*",
    inspect.Parameter.VAR_KEYWORD: "**",
}


NOT_GIVEN: Any = object()
"""Value of an argument that a call does not give although it is needed."""


def written_function(source: str, name: str, names: Mapping[str, Any]) -> Any:
    """Return the function `name` that the source defines; `names` are its globals."""
    # By `exec`, as nothing but source makes a function whose parameters are not known beforehand;
    # `dataclasses` makes constructors in this way. The source is made of names of parameters and
    # fields, and of the ranges and shapes that signatures declare: no text of a file gets here.
    scope = dict(names)
    exec(source, scope)
    return scope[name]


class ParameterSource(NamedTuple):
    """The parameters of a function, as source."""

    declaration: str
    """Text with which a ``def`` declares the parameters: ``self, q, t=_default_t, *, dt``."""
    arguments: str
    """Text with which a call passes them on: ``self, q, t, dt=dt``."""
    defaults: dict[str, Any]
    """Values of the defaults, by their names in `declaration`, which are ``_default_`` and the
    parameter.
    """


def is_required(parameter: inspect.Parameter) -> bool:
    """Return whether a call has to give an argument for the parameter, of a method `self` apart."""
    if parameter.kind in _STARS or parameter.name in ("self", "cls"):
        return False
    return parameter.default is parameter.empty


def parameter_source(
    function: Callable[..., Any], *, all_optional: bool = False
) -> ParameterSource:
    """Write the parameters of a function as source.

    all_optional: with the default `NOT_GIVEN` where the function has none, so that a call without
    a required argument gets through to where it is named.
    """
    declarations = []
    arguments = []
    defaults = {}
    has_star = False
    for name, parameter in inspect.signature(function).parameters.items():
        stars = _STARS.get(parameter.kind, "")
        is_keyword_only = parameter.kind is parameter.KEYWORD_ONLY
        if is_keyword_only and not has_star:
            declarations.append("*")
        has_star = has_star or is_keyword_only or stars == "*"
        if all_optional and is_required(parameter):
            declarations.append(f"{name}=_default_{name}")
            defaults[f"_default_{name}"] = NOT_GIVEN
        elif parameter.default is parameter.empty:
            declarations.append(f"{stars}{name}")
        else:
            defaults[f"_default_{name}"] = parameter.default
            declarations.append(f"{stars}{name}=_default_{name}")
        if is_keyword_only:
            arguments.append(f"{name}={name}")
        else:
            arguments.append(f"{stars}{name}")
    return ParameterSource(", ".join(declarations), ", ".join(arguments), defaults)
