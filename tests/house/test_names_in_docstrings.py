"""Every name that a docstring or a page writes in backticks exists: a reader who follows it finds
it.
"""

from __future__ import annotations

import builtins
import re
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import package_ast as house
import pytest

_BACKTICKED = re.compile(r"(?<!`)`([A-Za-z_][\w.]*)(?:\(\))?`(?!`)")
_WORD = re.compile(r"[A-Za-z_]\w*")
_COMMENT = re.compile(r"#.*")
_DEFINED = re.compile(r"^(?:class |def )?([A-Za-z_]\w*)", re.MULTILINE)
_CLASS = re.compile(
    r"^class (\w+)(?:\[[^\]]*\])?(?:\(([^)]*)\))?:.*?(?=^\S|\Z)", re.MULTILINE | re.S
)
_FILE = re.compile(r"\.(yaml|yml|json|toml|csv|npz|py|c|h|html|md|urdf)$")
_DATA = ("csv", "toml", "c", "h", "yaml")
_BLOCK = re.compile(r"^```.*?^```$|^ {4}.*?$", re.MULTILINE | re.S)
_TOP = house.PROJECT
_PAGES = (_TOP / "README.md", _TOP / "CONTRIBUTING.md", *(house.ROOT / "reference").rglob("*.md"))
_EXAMPLES = {
    *("TASK.quantity", "NAME_1", "payload2", "payload2.mass", "joint3_position"),  # by number
    *("left_Controller", "left_controller", "left_controller_step", "left_replay"),  # an export
    *("vel_x_mm_s", "vx_ref", "HeadingSet", "depth_setpoint", "press_kpa"),  # columns of others
    *("q_least", "v_mean", "add_subdirectory"),  # made of two words; of CMake
    *("UVMS_OCP_PEERS", "UVMS_OCP_POOL_RECORDINGS", "UVMS_OCP_DRIVEN_RECORDINGS"),  # benchmarks
    "UVMS_OCP_DRAW",  # tests
}
"""Names on pages that stand for a user's own, or that code puts together."""


def test_names_in_backticks_exist_in_all_modules() -> None:
    dead = []
    for path in house.modules():
        text = path.read_text(encoding="utf-8")
        for name in _dead_names(text):
            dead.append(f"{path.relative_to(house.ROOT)}: `{name}`")
    assert not dead, f"{len(dead)} names\n" + "\n".join(dead)


@pytest.mark.parametrize("folder", ["tests", "benchmarks"])
def test_names_in_backticks_exist_in_tests_and_benchmarks(folder: str) -> None:
    paths = sorted((_TOP / folder).rglob("*.py"))
    assert paths
    words = set[str]()
    for path in paths:
        words |= set(_WORD.findall(_code(path)))
    dead = []
    for path in paths:
        if path.samefile(__file__):  # which has some that are nowhere
            continue
        for docstring in path.read_text(encoding="utf-8").split('"""')[1::2]:
            for name in _BACKTICKED.findall(docstring):
                if not _exists(name, words):
                    dead.append(f"{path.relative_to(_TOP)}: `{name}`")
    assert dead == []


@pytest.mark.parametrize("page", _PAGES, ids=lambda page: page.stem)
def test_names_in_backticks_exist_on_pages(page: Path) -> None:
    """Or stand in a block of the page, as names of an example do."""
    text = page.read_text(encoding="utf-8")
    words = {folder.name for folder in (_TOP / "robots").iterdir()}
    for block in [*_codes(), *_BLOCK.findall(text)]:
        words |= set(_WORD.findall(block))
    names = set(_BACKTICKED.findall(text)) - _EXAMPLES
    assert [name for name in sorted(names) if not _exists(name, words)] == []


def test_names_that_are_nowhere_are_found_in_every_docstring() -> None:
    text = (
        '"""`Nowhere`, `Record`, `uvms_ocp.nowhere` and ``code``."""\nX = 1\n"""`nobody_here`"""\n'
        'class C:\n    y: int\n    """`Record.nothing`, `Record.series`"""\n'
        '    def f(self, argument):\n        """`argument`, `X`, `zz_top`, `json.dumps`"""\n'
    )
    expected = ["Nowhere", "uvms_ocp.nowhere", "nobody_here", "Record.nothing", "zz_top"]
    assert list(_dead_names(text)) == expected


def _dead_names(text: str) -> Iterator[str]:
    """Names in the docstrings of a module that neither it nor the package has."""
    parts = text.split('"""')
    code = _COMMENT.sub("", "\n".join(parts[::2]))
    words = set(_WORD.findall(code))
    for docstring in parts[1::2]:
        for name in _BACKTICKED.findall(docstring):
            if not _exists(name, words):
                yield name


def _exists(name: str, words: set[str]) -> bool:
    """Whether a name is a word of the code of its module, or what the package defines: a name at the
    top of a module, an attribute of a class, a module, a word of its tables, or of a library.
    """
    if _FILE.search(name):
        return True
    first, *rest = name.split(".")
    if first == "uvms_ocp":
        return _is_full_name(rest)
    if rest and first in _class_bodies():
        return _has_attribute(first, rest[0])
    is_of_package = first in _public_names() or first in _data_words()
    return first in words or is_of_package or hasattr(builtins, first) or _is_library(first)


def _is_full_name(parts: list[str]) -> bool:
    """Whether the parts lead to a module, and from there to what it defines."""
    place = house.ROOT
    rest = list(parts)
    while rest and (place / rest[0]).is_dir():
        place = place / rest.pop(0)
    if rest and (place / f"{rest[0]}.py").is_file():
        place = place / f"{rest.pop(0)}.py"
    if not rest:
        return True
    if place.is_dir():
        sources = [place / "__init__.py", place / "__init__.pyi"]
    else:
        sources = [place]
    words = set[str]()
    for source in sources:
        if source.is_file():
            words |= set(_WORD.findall(source.read_text(encoding="utf-8")))
    return all(part in words or part in _public_names() for part in rest) and rest[0] in words


def _has_attribute(cls: str, attribute: str) -> bool:
    """Whether one of the classes of that name has an attribute, or a base that is not known here."""
    for bases, body in _class_bodies()[cls]:
        if re.search(rf"\b{attribute}\b", body):
            return True
        for base in _WORD.findall(bases):
            if base in _class_bodies() and base != cls and _has_attribute(base, attribute):
                return True
    return False


def _is_library(name: str) -> bool:
    return name.islower() and find_spec(name) is not None


@cache
def _codes() -> tuple[str, ...]:
    """The code of all modules, without docstrings and comments."""
    return tuple(_code(path) for path in house.modules())


def _code(path: Path) -> str:
    """The code of a module, without docstrings and comments."""
    parts = path.read_text(encoding="utf-8").split('"""')
    return _COMMENT.sub("", "\n".join(parts[::2]))


@cache
def _public_names() -> frozenset[str]:
    """What modules define at their top, and the names of modules and packages."""
    names = {name for path in house.modules() for name in (path.stem, path.parent.name)}
    for code in _codes():
        names |= set(_DEFINED.findall(code))
    return frozenset(names)


@cache
def _class_bodies() -> dict[str, list[tuple[str, str]]]:
    """By name, the bases and the text of each class at the top of a module."""
    bodies: dict[str, list[tuple[str, str]]] = {}
    for code in _codes():
        for match in _CLASS.finditer(code):
            bodies.setdefault(match[1], []).append((match[2] or "", match[0]))
    return bodies


@cache
def _data_words() -> frozenset[str]:
    """Words of the tables and of the files of C beside the modules."""
    words = set[str]()
    for ending in _DATA:
        for path in house.ROOT.rglob(f"*.{ending}"):
            if "robots" not in path.parts:
                words |= set(_WORD.findall(path.read_text(encoding="utf-8")))
    return frozenset(words)
