"""The name of an export, which stands before every identifier that other C can see."""

from __future__ import annotations

import re
from collections.abc import Collection

from uvms_ocp.errors import InvalidInput

_LONGEST = 63  # characters that C99 promises to tell apart
_PERMITTED = re.compile(rf"[A-Za-z]\w{{0,{_LONGEST - 1}}}", re.ASCII)
_KEYWORD = re.compile(
    "auto|break|case|char|const|continue|default|do|double|else|enum|extern|float|for|goto|if|inline"
    "|int|long|register|restrict|return|short|signed|sizeof|static|struct|switch|typedef|union"
    "|unsigned|void|volatile|while"
)
_STRUCTURE = re.compile(r"^\} (\w+);$", re.MULTILINE)
_FUNCTION = re.compile(r"^((?:[A-Za-z_]\w*[ *]+)+)(\w+)\(", re.MULTILINE)
_INTERNAL = re.compile(r"\b(?:static|typedef|INLINE)\b")
_WORD = re.compile(r'(?<![\w.">])[A-Za-z_]\w*')


def export_name(requested: str | None, mission: str) -> str:
    """Return the name that was asked for, or one like that of the `mission`.

    Raises `InvalidInput` for one that is no C identifier, or that C keeps for itself.
    """
    if requested is None:
        return _name_like(mission)
    if not _PERMITTED.fullmatch(requested) or _KEYWORD.fullmatch(requested):
        raise InvalidInput(
            f"name = {requested!r}; give an identifier of C: letters, digits and _, a letter first,"
            f" {_LONGEST} at most, no keyword"
        )
    return requested


def _name_like(mission: str) -> str:
    """Return the letters and digits of a name, as an identifier of C."""
    name = re.sub(r"\W+", "_", mission, flags=re.ASCII).strip("_")
    if not name:
        return "mission"
    if not name[0].isalpha():
        name = f"m_{name}"
    name = name[:_LONGEST]
    if _KEYWORD.fullmatch(name):
        return f"{name}_"
    return name


def structures_in(code: str) -> set[str]:
    """Return the names of the structures that C code as kernels have it declares."""
    return set(_STRUCTURE.findall(code))


def functions_in(code: str) -> set[str]:
    """Return the names of the functions that C code declares or defines for other files, at the
    beginning of a line each.
    """
    return {name for kind, name in _FUNCTION.findall(code) if not _INTERNAL.search(kind)}


def with_prefix(code: str, prefix: str, identifiers: Collection[str]) -> str:
    """Return C code with the prefix before these identifiers, but not where they are fields or
    texts.
    """

    def replace(word: re.Match[str]) -> str:
        if word[0] in identifiers:
            return f"{prefix}{word[0]}"
        return word[0]

    return _WORD.sub(replace, code)
