"""The house in CONTRIBUTING leads to files and folders that are there."""

from __future__ import annotations

import re
from collections.abc import Iterator
from fnmatch import fnmatch

import package_ast as house

PAGE = house.PROJECT / "CONTRIBUTING.md"
_ROW = re.compile(r"^( {4,10})(\S.*?)  +(\S.*)")
_FILE = re.compile(r"(?<![/\w])(?:\w+_[\w*]+|[\w*]+\.(?:py|js|csv|toml|mplstyle))(?![\w./])")
_BEFORE_COLON = re.compile(r"; ([a-z]\w*):")
_COLUMN = 4  # at which names of packages begin; what is in them stands two further


def test_every_row_of_the_house_names_what_is_there() -> None:
    assert _missing(_named_paths(PAGE.read_text(encoding="utf-8"))) == []


def test_files_named_beside_a_row_are_there() -> None:
    assert _missing(_paths_beside(PAGE.read_text(encoding="utf-8"))) == []


def test_every_package_has_a_row() -> None:
    named = {path.split("/")[0] for path in _named_paths(PAGE.read_text(encoding="utf-8"))}
    packages = {folder.parent.name for folder in house.ROOT.glob("*/__init__.py")}
    assert packages - named == set()


def test_every_file_of_the_package_is_named() -> None:
    words = set(re.findall(r"[\w*]+", PAGE.read_text(encoding="utf-8")))
    patterns = [word for word in words if "*" in word and word.strip("*")]
    unnamed = [
        str(path.relative_to(house.ROOT))
        for path in sorted(house.ROOT.rglob("*.py"))
        if not path.stem.startswith("__")
        and path.stem not in words
        and not any(fnmatch(path.stem, pattern) for pattern in patterns)
    ]
    assert unnamed == []


def test_a_name_that_is_nowhere_is_told_in_either_column() -> None:
    page = """Each row has a folder.

    robot/              files
      limits              of joints; no_limits, signals: channels
      nowhere             of nobody; neither: nothing
    sim/                plant_of_old, faults.toml

    robots/ NAME/       others
"""
    assert _missing(_named_paths(page)) == ["robot/nowhere.py"]
    assert _missing(_paths_beside(page)) == [
        "robot/**/no_limits.*",
        "robot/**/neither.*",
        "sim/**/plant_of_old.*",
    ]


def _missing(paths: Iterator[str]) -> list[str]:
    return [path for path in paths if not list(house.ROOT.glob(path))]


def _named_paths(page: str) -> Iterator[str]:
    """Patterns of the files and folders in the first column of the house, within the package."""
    for folders, names, _ in _rows_of(page):
        for name in names:
            is_module = not name.endswith("/") and "." not in name
            path = "/".join([*folders, name.rstrip("/")])
            yield f"{path}.py" if is_module else path


def _paths_beside(page: str) -> Iterator[str]:
    """Patterns of the files that the second column names, within the folder of their row: words with
    an underscore or an ending, and what stands before a colon.
    """
    for folders, names, text in _rows_of(page):
        inside = [name.rstrip("/") for name in names if name.endswith("/")]
        for name in _FILE.findall(text) + _BEFORE_COLON.findall(text):
            file = name if "." in name else f"{name}.*"
            yield "/".join([*folders, *inside, "**", file])


def _rows_of(page: str) -> Iterator[tuple[list[str], list[str], str]]:
    """Folders above each row of the house, the names in its first column, and the text beside."""
    block = page.partition("Each row has")[2].partition("\n    robots/")[0]
    folders: list[str] = []
    for line in block.splitlines():
        row = _ROW.match(line)
        if row is not None:
            depth = (len(row[1]) - _COLUMN) // 2
            folders = folders[:depth]
            names = row[2].split(", ")
            yield folders, names, row[3]
            if names[0].endswith("/"):
                folders = [*folders, names[0].rstrip("/")]
        elif line.startswith("    ") and line.strip():  # the text of the row above goes on
            yield folders, [], line.strip()
