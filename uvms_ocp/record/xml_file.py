"""Read XML as a tree of elements: bounded in size, depth and number, without entities that
multiply.
"""

from __future__ import annotations

import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.untrusted import decoded, read_bytes

LARGEST_XML = 16 << 20
"""[B] largest file; robots of 50 links have 0.2 MB."""
MOST_ELEMENTS = 50_000
"""Largest number of elements of a file; robots of 50 links have 3,000."""
DEEPEST_XML = 32
"""A URDF has 5 levels, what simulators add to it 8."""

_PREFIXED_TAG = re.compile(r"(</?[A-Za-z_][\w.-]*):")
_PREFIXED_ATTRIBUTE = re.compile(r"(\s[A-Za-z_][\w.-]*):([\w.-]+\s*=\s*[\"'])")
_ENCODING_NAMES = rb"us-ascii|latin-?1|(?:iso-?8859|windows|cp)-?\d+|euc-\w+|shift_jis|big5|gb\w+"
_DECLARED_ENCODING = re.compile(
    rb"""\s*<\?xml[^>]*\sencoding\s*=\s*["'](""" + _ENCODING_NAMES + rb""")["']""",
    re.IGNORECASE,
)


def read_xml(path: Path | str) -> ElementTree.Element:
    """Read the root element of a file.

    Raises `OSError`, and `InvalidInput` in one line for what is no file, no XML or beyond the
    bounds.
    """
    return _parsed(read_xml_text(Path(path)))


def read_xml_with_any_prefix(path: Path | str) -> ElementTree.Element:
    """Read a file as `read_xml` does, with prefixes of names as part of them: readers that know no
    namespaces take prefixes that are declared nowhere. Raises `InvalidInput` as `read_xml` does.
    """
    text = read_xml_text(Path(path))
    text = _PREFIXED_TAG.sub(r"\1_", text)
    return _parsed(_PREFIXED_ATTRIBUTE.sub(r"\1_\2", text))


def _parsed(text: str) -> ElementTree.Element:
    parser = ElementTree.XMLParser(target=_BoundedTreeBuilder())
    try:
        parser.feed(text)
        root: ElementTree.Element = parser.close()
    except ElementTree.ParseError as error:
        raise InvalidInput(f"the XML is broken ({error})") from None
    return root


def read_xml_text(path: Path) -> str:
    """Read the text of an XML file in the encoding that it declares, in UTF-8 or UTF-16 where it
    declares none.

    Raises `OSError`, and `InvalidInput` in one line for what is no file, no text in that encoding
    or too large.
    """
    content = read_bytes(path, LARGEST_XML)
    declaration = _DECLARED_ENCODING.match(content)
    if declaration:
        encoding = declaration[1].decode()
    elif content[:2] in (BOM_UTF16_LE, BOM_UTF16_BE):
        encoding = "UTF-16"
    else:
        encoding = "UTF-8"
    return decoded(content, encoding)


class _BoundedTreeBuilder(ElementTree.TreeBuilder):
    """Raises `InvalidInput` beyond the bounds, while the text is read."""

    def __init__(self) -> None:
        super().__init__()
        self._depth = 0
        self._n_elements = 0

    def start(self, tag: str, attrs: dict[str, str], /) -> ElementTree.Element:
        self._depth += 1
        self._n_elements += 1
        if self._depth > DEEPEST_XML:
            raise InvalidInput(f"deeper than {DEEPEST_XML} levels")
        if self._n_elements > MOST_ELEMENTS:
            raise InvalidInput(f"more than {MOST_ELEMENTS} elements")
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ElementTree.Element:
        self._depth -= 1
        return super().end(tag)

    def doctype(self, name: str, pubid: str | None, system: str | None) -> NoReturn:
        """Refuse entities, which are defined here, as a few lines of them stand for gigabytes."""
        raise InvalidInput("a <!DOCTYPE> is not read; remove it")
