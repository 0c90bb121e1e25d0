"""XML as a tree of elements: bounded in size, depth and number, without entities that multiply."""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.untrusted.regular_file import read_text

LARGEST = 16 << 20
"""[B] of a file; robots of 50 links have 0.2 MB."""
MOST_ELEMENTS = 50_000
"""Robots of 50 links have 3,000."""
DEEPEST = 32
"""A URDF has 5 levels, what simulators add to it 8."""


class _Bounded(ElementTree.TreeBuilder):
    """Raises `InvalidInput` beyond the bounds, while the text is read."""

    def __init__(self) -> None:
        super().__init__()
        self._depth = 0
        self._elements = 0

    def start(self, tag: str, attrs: dict[str, str], /) -> ElementTree.Element:
        self._depth += 1
        self._elements += 1
        if self._depth > DEEPEST:
            raise InvalidInput(f"deeper than {DEEPEST} levels")
        if self._elements > MOST_ELEMENTS:
            raise InvalidInput(f"more than {MOST_ELEMENTS} elements")
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ElementTree.Element:
        self._depth -= 1
        return super().end(tag)

    def doctype(self, name: str, pubid: str | None, system: str | None) -> NoReturn:
        """Entities are defined here, and a few lines of them stand for gigabytes."""
        raise InvalidInput("a <!DOCTYPE> is not read; remove it")


def read_xml(path: Path | str) -> ElementTree.Element:
    """The root element of a file.

    Raises `OSError`, and `InvalidInput` in one line for what is no file, no XML or beyond the bounds.
    """
    parser = ElementTree.XMLParser(target=_Bounded())
    try:
        parser.feed(read_text(Path(path), LARGEST))
        root: ElementTree.Element = parser.close()
    except ElementTree.ParseError as error:
        raise InvalidInput(f"the XML is broken ({error})") from None
    return root
