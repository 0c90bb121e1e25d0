"""Exceptions, and outcomes that come with advice: misuse raises, a numerical result is an
`AdvisedStatus`.

Each message is one line: what was given, what is allowed, what to do. `plain_line` makes one of any
text.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from difflib import get_close_matches
from enum import Enum
from importlib import import_module
from itertools import accumulate
from multiprocessing import current_process
from pathlib import Path
from typing import Any, TypeVar

_LISTED_NAMES = 30  # allowed names up to which a message lists all
_NEAREST_NAMES = 6  # names that it lists of more
_LINE_LENGTH = 900  # characters of the problems of a file that one line holds
_VALUE_LENGTH = 60  # characters of a wrong value

_Status = TypeVar("_Status", bound="AdvisedStatus")


class UvmsError(Exception):
    """Base of every exception that uvms_ocp raises on purpose. It can be pickled, whatever its
    constructor takes.
    """

    def __str__(self) -> str:
        return " ".join(super().__str__().splitlines())

    def __reduce__(self) -> tuple[Any, ...]:
        # By default an exception is made anew by its constructor, which takes other arguments than
        # the message.
        default = super().__reduce__()
        constructor_arguments = default[1]
        state = default[2:]
        return (_unpickled, (type(self), constructor_arguments, self.args), *state)


def _unpickled(
    cls: type[UvmsError], constructor_arguments: tuple[Any, ...], args: tuple[Any, ...]
) -> UvmsError:
    """Make an exception of a class with the `args` that it had, without its constructor."""
    error = cls.__new__(cls, *constructor_arguments)
    error.args = args
    return error


class InvalidInput(UvmsError, ValueError):
    """A value of the wrong shape, type or range."""


class NameNotFound(UvmsError, LookupError):
    """A name that does not exist; the message lists the names that do, or of many the nearest and
    where all are listed.
    """

    def __init__(self, kind: str, given: str, allowed: Iterable[str], listed: str = "") -> None:
        """listed: what tells all names, such as a command."""
        self.kind = kind
        self.given = given
        self.allowed = tuple(allowed)
        close = get_close_matches(str(given), self.allowed, n=1)
        hint = f" Did you mean {close[0]!r}?" if close else ""
        if len(self.allowed) <= _LISTED_NAMES:
            names = ", ".join(self.allowed) or "none"
            super().__init__(f"unknown {kind} {given!r}; known: {names}.{hint}")
            return
        nearest = get_close_matches(str(given), self.allowed, n=_NEAREST_NAMES, cutoff=0.0)
        names = ", ".join(nearest)
        if listed:
            names += f"; {listed} lists them"
        super().__init__(
            f"unknown {kind} {given!r}.{hint} The nearest of {len(self.allowed)}: {names}."
        )


def require_known(kind: str, given: str, known: Collection[str]) -> None:
    """Raise `NameNotFound` for a name that is not among those that are known."""
    if given not in known:
        raise NameNotFound(kind, given, known)


class FrameNotFound(NameNotFound):
    """A frame that the robot does not have."""

    def __init__(self, given: str, allowed: Iterable[str]) -> None:
        super().__init__("frame", given, allowed)
        if given == "tool":
            advice = "`tool: LINK` in hydrodynamics.yaml names it; a vehicle without arm has none"
            self.args = (f"{self.args[0]} {advice}",)


class ArgumentNotFound(NameNotFound, TypeError):
    """An argument that a call does not take."""

    def __init__(self, call: str, given: str, allowed: Iterable[str]) -> None:
        super().__init__(f"argument of {call}", given, allowed)


class ArgumentMissing(UvmsError, TypeError):
    """An argument that a call needs and does not get."""

    def __init__(self, call: str, name: str, allowed: str) -> None:
        super().__init__(f"{call}: {name} is missing; give {allowed}")


class RobotDataError(InvalidInput):
    """A robot file (URDF or YAML) that is missing, broken or physically impossible."""

    def __init__(self, path: Path | str, *problems: str) -> None:
        """problems: all that is wrong with the file, so that it is refused once."""
        self.path = Path(path)
        self.problems = problems
        total_lengths = accumulate(map(len, problems))
        n_fitting = sum(length <= _LINE_LENGTH for length in total_lengths)
        n_shown = max(3, n_fitting)
        texts = list(problems[:n_shown])
        if len(problems) > n_shown:
            texts.append(f"{len(problems) - n_shown} more")
        super().__init__(f"{path}: {'; and '.join(texts)}")

    @property
    def lines(self) -> tuple[str, ...]:
        """One line for each problem."""
        return tuple(plain_line(f"{self.path}: {problem}") for problem in self.problems)


class OutputError(UvmsError, OSError):
    """A place that cannot be written to."""


class NotInstalled(UvmsError, ImportError):
    """A package that is optional and not there; the message says how to get it."""

    def __init__(self, what: str, package: str) -> None:
        super().__init__(
            f"{what} needs the package {package}, which is not installed; pip install {package}"
        )


def optional_module(name: str, what: str, package: str) -> Any:
    """Import a module that only a few calls need. Raises `NotInstalled` without it, which says what
    needs which package.
    """
    try:
        return import_module(name)
    except ImportError:
        raise NotInstalled(what, package) from None


def require_first_reading(what: str) -> None:
    """Raise SystemExit in a spawned process that still imports the script which started it, and
    would spawn again by `what`.
    """
    if getattr(current_process(), "_inheriting", False):
        raise SystemExit(
            f"{what}: its processes read the script again; put the call below if __name__ =="
            ' "__main__":'
        )


def plain_line(text: str, longest: int | None = None) -> str:
    """Return a text that holds names of users' own, on one line, without control characters and
    what no encoding can write.

    longest: number of characters after which it is cut.
    """
    printable = "".join(letter if letter.isprintable() else " " for letter in text)
    plain = " ".join(printable.split())
    if longest is None or len(plain) <= longest:
        return plain
    return plain[: longest - 1] + "…"


def short(value: object) -> str:
    """Return a value as messages show it: on one line, of 60 characters at most."""
    try:
        text = " ".join(repr(value).split())
    except Exception:
        text = f"a {type(value).__name__}"
    if len(text) <= _VALUE_LENGTH:
        return text
    return f"{text[: _VALUE_LENGTH - 3]}..."


# Outcomes that say what to do about them.


class AdvisedStatus(Enum):
    """A numerical outcome. Members are written ``NAME = "value", "advice"``."""

    advice: str
    """Advice on what to do about it, one sentence for the user."""

    def __new__(cls: type[_Status], value: str, advice: str) -> _Status:
        status = object.__new__(cls)
        status._value_ = value
        status.advice = advice
        return status
