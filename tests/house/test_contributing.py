"""The house in CONTRIBUTING leads to files and folders that are there."""

from __future__ import annotations

import re
from collections.abc import Iterator

import package_ast as house

PAGE = house.PROJECT / "CONTRIBUTING.md"
_ROW = re.compile(r"^( {4,})(\S.*?)  +\S")
_COLUMN = 4  # at which names of packages begin; what is in them stands two further


def test_every_row_of_the_house_names_what_is_there() -> None:
    missing = [str(path) for path in _named_paths(PAGE.read_text(encoding="utf-8"))]
    missing = [path for path in missing if not list(house.ROOT.glob(path))]
    assert missing == []


def test_every_package_has_a_row() -> None:
    named = {path.split("/")[0] for path in _named_paths(PAGE.read_text(encoding="utf-8"))}
    packages = {folder.parent.name for folder in house.ROOT.glob("*/__init__.py")}
    assert packages - named == set()


def _named_paths(page: str) -> Iterator[str]:
    """Patterns of the files and folders in the first column of the house, within the package."""
    block = page.partition("A row says")[2].partition("\n    robots/")[0]
    folders: list[str] = []
    for line in block.splitlines():
        row = _ROW.match(line)
        if row is None:
            continue
        depth = (len(row[1]) - _COLUMN) // 2
        del folders[depth:]
        names = row[2].split(", ")
        for name in names:
            is_module = not name.endswith("/") and "." not in name
            path = "/".join([*folders, name.rstrip("/")])
            yield f"{path}.py" if is_module else path
        if names[0].endswith("/"):
            folders.append(names[0].rstrip("/"))
