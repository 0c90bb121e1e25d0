"""The whole reference: pages of all rooms by pdoc, pages of theory and tables, and one that leads to all of them."""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Iterator, Sequence
from importlib.resources import files
from pathlib import Path

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput, OutputError
from uvms_ocp.reference.links import broken_links
from uvms_ocp.reference.pages import Contents, body_of, page_of, title_of
from uvms_ocp.reference.rooms import documented_modules
from uvms_ocp.reference.tables import generated_pages

ORDER = (
    *("notation", "motion", "thrusters", "tasks", "hierarchy", "tick", "missions", "force"),
    *("estimation", "trajectories", "collision", "optimal_control"),
)
"""Of the pages of theory, which build on those before."""
GUIDE = ("commands_by_example", "python", "campaigns", "mission_plans", "faults", "recordings", "limitations")
"""Pages on how to use it, in their order."""
_PRIVATE = re.compile(r'<a href="[^"]*#_[^"]*">(.*?)</a>', re.DOTALL)
_MOST_FAULTS = 20  # that are told


def theory_pages() -> dict[str, str]:
    """Markdown of all pages of theory by name, in their order."""
    return _pages_of("theory", ORDER)


def guide_pages() -> dict[str, str]:
    """Markdown of all pages on how to use it by name, in their order."""
    return _pages_of("guide", GUIDE)


def _pages_of(folder: str, names: Sequence[str]) -> dict[str, str]:
    place = files("uvms_ocp.reference") / folder
    return {name: (place / f"{name}.md").read_text(encoding="utf-8") for name in names}


@checked
def build_reference(folder: Path | str) -> Path:
    """Write the reference into a folder, which it makes; returns its first page.

    Raises `InvalidInput` where the generator is not installed, where it warns and for links that lead nowhere,
    `NameNotFound` for names that are cited and are not there, and `OutputError` where the folder cannot be written.
    """
    try:
        import latex2mathml.converter  # noqa: F401 - only whether it is there
        import pdoc.render
    except ImportError as error:
        raise InvalidInput(f'{error.name} is not installed; run: pip install "uvms-ocp[reference]"') from error
    folder = Path(folder)
    written = {"Guide": guide_pages(), "Theory": theory_pages(), "Files and commands": generated_pages()}
    modules = documented_modules("\n".join(text for pages in written.values() for text in pages.values()))
    pdoc.render.configure(docformat="markdown", show_source=True, search=True)
    try:
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            pdoc.pdoc(*_asked_for(modules), output_directory=folder)
        _without_private_links(folder)
        _write_pages(folder, written, modules)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written ({error}); choose another folder") from error
    wrong = [*(str(item.message).splitlines()[0] for item in told), *broken_links(folder)]
    if wrong:
        raise InvalidInput(f"the reference has {len(wrong)} faults: {'; '.join(wrong[:_MOST_FAULTS])}")
    return folder / "index.html"


def _asked_for(modules: tuple[str, ...]) -> Iterator[str]:
    """All but those that share their name with what their room exports: they come with the room."""
    for name in modules:
        room, _, own = name.rpartition(".")
        if room not in modules or own not in getattr(sys.modules[room], "__all__", ()):
            yield name


def _without_private_links(folder: Path) -> None:
    """Classes name their private bases, which have no place to lead to."""
    for path in folder.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        path.write_text(_PRIVATE.sub(r"\1", text), encoding="utf-8")


def _write_pages(folder: Path, written: dict[str, dict[str, str]], modules: tuple[str, ...]) -> None:
    contents: Contents = {
        heading: [(f"{name}.html", title_of(text)) for name, text in pages.items()]
        for heading, pages in written.items()
    }
    contents["Python"] = [(f"{name.replace('.', '/')}.html", name.removeprefix("uvms_ocp.")) for name in modules]
    for name, text in (item for pages in written.values() for item in pages.items()):
        page = page_of(title_of(text), body_of(text, modules), contents)
        (folder / f"{name}.html").write_text(page, encoding="utf-8")
    (folder / "index.html").write_text(page_of("uvms_ocp", body_of(_first_page(), modules), contents), encoding="utf-8")


def _first_page() -> str:
    return (files("uvms_ocp.reference") / "theory" / "first_page.md").read_text(encoding="utf-8")
