"""Names of the folders that results go to."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from uvms_ocp.errors import OutputError


def default_folder(parts: Sequence[str], options: Mapping[str, Any]) -> Path:
    """Return the folder of the results unless another is named.

    parts: command, scenario and the like. They and the options are its name, so that each choice of
    options has a folder of its own.
    """
    option_words = [_option_word(name, value) for name, value in options.items()]
    return Path("uvms_runs", "-".join([*parts, *option_words]))


def _option_word(name: str, value: Any) -> str:
    """Return the part of a folder's name that stands for an option and its value."""
    if isinstance(value, bool):
        return name if value else f"no_{name}"
    if name == "faults":
        return "-".join(_fault_word(str(fault)) for fault in value)
    if isinstance(value, tuple):
        return name + "_".join(str(part) for part in value)
    if name in ("robot", "hydrodynamics"):
        return label(str(value))
    if name == "loading":
        return label("-".join(f"{key}_{word}" for key, word in value.items()))
    return f"{name}{value}"


def _fault_word(text: str) -> str:
    """Return a fault, such as ``altimeter:frozen@8-9.5``, as a word of letters and digits."""
    readable = text.replace("-", "to").replace(".", "p")
    return re.sub(r"\W", "_", readable)


def label(words: str) -> str:
    """Return a name for folders of the name of a scenario, ``FILE.py`` or ``PLACE:NAME``."""
    place, _, attribute = words.partition(":")
    path = Path(place)
    name = path.stem if "." in place else path.name
    parts = [part for part in (name, attribute) if part]
    return re.sub(r"[^\w.]+", "_", "-".join(parts)).strip("_") or "run"


def named_folder(words: str | Path) -> Path:
    """Return the folder that a user names.

    Raises `OutputError` for an empty name, which would mean the working directory, and for line
    breaks and the like, which would be refused only when results are written.
    """
    if not str(words).strip():
        raise OutputError(
            f"{words!r} names no folder for the results; give one, or . for the working directory"
        )
    if any(letter < " " for letter in str(words)):
        raise OutputError(f"{words!r} has control characters; give a folder without")
    return Path(words)
