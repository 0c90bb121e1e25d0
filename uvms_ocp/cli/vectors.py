"""Options of three numbers, written with commas as others write them: ``--position -3,1,2``."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import typer

_SIZE = 3


def spread(app: typer.Typer, words: Sequence[str]) -> list[str]:
    """The words of a command line with every such option followed by its numbers one by one, as the parser takes them."""
    return list(_spread(words, set(_vectors(typer.main.get_command(app)))))


def _vectors(command: object) -> Iterator[str]:
    """Options of a command, and of those below it, that take three values."""
    for parameter in getattr(command, "params", ()):
        if parameter.nargs == _SIZE:
            yield from parameter.opts
    for below in getattr(command, "commands", {}).values():
        yield from _vectors(below)


def _spread(words: Sequence[str], vectors: Collection[str]) -> Iterator[str]:
    before = ""
    for word in words:
        name, equals, value = word.partition("=")
        if equals and name in vectors:
            yield from (name, *value.split(","))
        elif before in vectors and word.count(",") == _SIZE - 1:
            yield from word.split(",")
        else:
            yield word
        before = word
