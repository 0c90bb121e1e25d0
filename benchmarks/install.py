"""What an install takes on the disk, package by package: ``python benchmarks/install.py``.

Writes install.csv, one row per package that the package asks for itself, install_packages.csv, one
row per package, and install.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib.metadata import Distribution, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from recording.report import Report, Row, Table, begin, parser_of

PACKAGE = "uvms-ocp"
PROSE = """
`pip install {package}` without extras: {n} packages beside it, {total:.0f} MB of files as they were
installed, without what Python compiles of them later. *own_MB*: of the package alone; *with_MB*:
with all that it brings, directly or not; *alone_MB*: of that, what nothing else brings, and what
would go if it went.
"""
DIRECT = {
    "package": "",
    "version": "",
    "own_MB": ".0f",
    "with_MB": ".0f",
    "alone_MB": ".0f",
    "brings": "",
}
ALL = {"package": "", "version": "", "MB": ".1f", "brought_by": ""}


def needs(of: Distribution) -> list[str]:
    """Names of the packages that one needs here, without its extras."""
    names = list[str]()
    for text in of.requires or ():
        requirement = Requirement(text)
        if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
            names.append(canonicalize_name(requirement.name))
    return names


def megabytes(of: Distribution) -> float:
    """Sum up the files [MB] of a package but for byte code, each once: wheels have no links, and
    copies of libraries in their place.
    """
    sizes = dict[Path, int]()
    for file in of.files or ():
        path = Path(str(of.locate_file(file)))
        if file.suffix != ".pyc" and path.is_file():
            sizes[path] = path.stat().st_size
    return sum(sizes.values()) / 1e6


def all_of(roots: Iterable[str], graph: Mapping[str, list[str]]) -> set[str]:
    """Collect these packages and all that they bring."""
    packages = set[str]()
    waiting = list(roots)
    while waiting:
        name = waiting.pop()
        if name not in packages:
            packages.add(name)
            waiting += graph[name]
    return packages


def main() -> None:
    """Look, and write."""
    _, run = begin(parser_of(__doc__))
    direct = needs(distribution(PACKAGE))
    parts = dict[str, Distribution]()
    waiting = list(direct)
    while waiting:
        name = waiting.pop()
        if name not in parts:
            parts[name] = distribution(name)
            waiting += needs(parts[name])
    graph = {name: needs(part) for name, part in parts.items()}
    sizes = {name: megabytes(part) for name, part in parts.items()}
    brought_by = {name: all_of([name], graph) for name in direct}

    def size(names: Iterable[str]) -> float:
        return sum(sizes[name] for name in names)

    rows: list[Row] = []
    for name in sorted(direct, key=lambda name: -size(brought_by[name])):
        brought = brought_by[name]
        remaining = [package for package in direct if package != name]
        by_others = all_of(remaining, graph)
        rows.append(
            {
                "package": name,
                "version": parts[name].version,
                "own_MB": sizes[name],
                "with_MB": size(brought),
                "alone_MB": size(brought - by_others),
                "brings": len(brought) - 1,
            }
        )
    packages: list[Row] = []
    for name in sorted(parts, key=lambda name: -sizes[name]):
        origins = [origin for origin in direct if name in brought_by[origin]]
        packages.append(
            {
                "package": name,
                "version": parts[name].version,
                "MB": sizes[name],
                "brought_by": ", ".join(origins),
            }
        )
    run.write(
        Report(
            name="install",
            title="What an install takes",
            prose=PROSE.format(package=PACKAGE, n=len(parts), total=size(parts)),
            tables=[Table(rows=rows, columns=DIRECT), Table(rows=packages[:15], columns=ALL)],
            data={"install": rows, "install_packages": packages},
        )
    )


if __name__ == "__main__":
    main()
