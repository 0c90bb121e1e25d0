"""Build the reference: pages of all packages by pdoc, pages of theory, and tables with formulas and links."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import re
import sys
import warnings
from collections.abc import Collection, Iterator, Sequence
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import unquote, urlsplit

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput, NameNotFound, OutputError
from uvms_ocp.reference.tables import generated_pages

# Which modules the reference documents: rooms with what they export, and what docstrings and theory refer to.

ROOT = Path(__file__).resolve().parents[1]
_APART = ("robots", "templates", "reference", "cli")
CITED = re.compile(r"`(uvms_ocp(?:\.\w+)+)`")
"""A name in full, as docstrings and pages write it."""


def exported_names(init: Path) -> tuple[str, ...]:
    """The names that a room passes on, by ``from x import Y as Y`` in its ``__init__.py``."""
    imports = (
        node for node in ast.walk(ast.parse(init.read_text(encoding="utf-8"))) if isinstance(node, ast.ImportFrom)
    )
    return tuple(alias.name for node in imports for alias in node.names if alias.asname == alias.name)


def documented_modules(pages: str) -> tuple[str, ...]:
    """Rooms that export something, and all modules that their docstrings, those of the modules so found, and `pages` refer to.

    Each room gets its exports as ``__all__``, which is how the generator knows them.
    """
    found: dict[str, None] = {}
    for init in sorted(ROOT.rglob("__init__.py")):
        parts = init.parent.relative_to(ROOT).parts
        names = exported_names(init)
        if names and not set(_APART) & set(parts):
            room = importlib.import_module(".".join(("uvms_ocp", *parts)))
            vars(room)["__all__"] = [name for name in names if not inspect.ismodule(getattr(room, name))]
            found[room.__name__] = None
    waiting = [*_modules_of(pages), *(name for room in list(found) for name in _modules_of(_source_of(room)))]
    while waiting:
        module = waiting.pop()
        if module not in found:
            found[module] = None
            waiting += _modules_of(_source_of(module))
    return tuple(sorted(found))


def _modules_of(text: str) -> list[str]:
    return [place_of(name)[0].__name__ for name in CITED.findall(text)]


def _source_of(module: str) -> str:
    return inspect.getsource(importlib.import_module(module))


def place_of(name: str) -> tuple[ModuleType, str]:
    """The module of a name in full, and the rest of it. Raises `NameNotFound` where there is no such thing."""
    parts = name.split(".")
    n = next(k for k in range(len(parts), 0, -1) if _is_module(".".join(parts[:k])))
    thing: object = importlib.import_module(".".join(parts[:n]))
    module = thing
    for part in parts[n:]:
        fields = getattr(thing, "__annotations__", {})
        if not hasattr(thing, part) and part not in fields:
            raise NameNotFound(f"name in {'.'.join(parts[:n])}", part, [key for key in dir(thing) if key[0] != "_"])
        thing = getattr(thing, part, None)
    assert isinstance(module, ModuleType)
    return module, ".".join(parts[n:])


def _is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


# Links of the reference: from a name to its place, and which of a folder's links lead nowhere.

_LEADING = ("href", "src")


def address_of(name: str, modules: Collection[str]) -> str:
    """Where the reference has a name in full, from its top folder: on the page of its module. Raises `NameNotFound`."""
    module, rest = place_of(name)
    page = f"{module.__name__.replace('.', '/')}.html" if module.__name__ in modules else "index.html"
    return f"{page}#{rest}" if rest else page


class _Page(HTMLParser):
    """Links of a page, and the anchors it offers."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = {""}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in _LEADING and value:
                self.links.append(value)
            elif name in ("id", "name") and value:
                self.anchors.add(value)


def broken_links(folder: Path) -> tuple[str, ...]:
    """``page: link`` of every link between pages of the folder that leads nowhere."""
    pages = {path.resolve(): _Page(path.read_text(encoding="utf-8")) for path in folder.rglob("*.html")}
    return tuple(
        f"{path.relative_to(folder.resolve())}: {link}"
        for path, page in pages.items()
        for link in page.links
        if not _leads_somewhere(link, path, pages)
    )


def _leads_somewhere(link: str, path: Path, pages: dict[Path, _Page]) -> bool:
    parts = urlsplit(link)
    if parts.scheme:
        return True
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if target in pages:
        return unquote(parts.fragment) in pages[target].anchors
    return target.is_file()


# From Markdown to pages: formulas become MathML, names in full become links to their documentation.

_DISPLAY = re.compile(r"\$\$(.+?)\$\$", re.DOTALL)
_INLINE = re.compile(r"(?<![\\$\w])\$([^$\n]+?)\$(?!\w)")
_PAGE = """{% extends "frame.html.jinja2" %}
{% block title %}{{ title }}{% endblock %}
{% block style %}{{ super() | safe }}<style>{{ css | safe }}</style>{% endblock %}
{% block nav %}
<h2>uvms_ocp</h2>
{% for heading, entries in contents.items() %}<h3>{{ heading }}</h3>
<ul>{% for address, text in entries %}<li><a href="{{ address }}">{{ text }}</a></li>{% endfor %}</ul>
{% endfor %}
{% endblock %}
{% block content %}<main class="pdoc"><section class="module-info"><div class="docstring">{{ body | safe }}</div></section></main>
{% endblock %}"""
_CSS = """math[display=block] { margin: 1.2em 0; font-size: 1.15em; }
math { font-family: "Latin Modern Math", "STIX Two Math", "Cambria Math", math; }
.docstring table { display: block; overflow-x: auto; } .docstring td { vertical-align: top; }
nav.pdoc ul { padding-left: 0; } .docstring { max-width: 62rem; }"""
Contents = dict[str, list[tuple[str, str]]]
"""By heading, addresses and titles of pages."""


def body_of(text: str, modules: Collection[str]) -> str:
    """The HTML of a page in Markdown. Raises `NameNotFound` for a name that is cited and is not there."""
    from pdoc.render_helpers import to_html

    formulas: list[str] = []
    for pattern, display in ((_DISPLAY, "block"), (_INLINE, "inline")):
        text = pattern.sub(lambda found, how=display: _mark(formulas, found[1], how), text)  # type: ignore[misc]
    text = CITED.sub(lambda found: f"[`{_short(found[1])}`]({address_of(found[1], modules)})", text)
    html = str(to_html(text))
    return re.sub(r"formula(\d+)mark", lambda found: formulas[int(found[1])], html)


def _mark(formulas: list[str], latex: str, display: str) -> str:
    """Kept out of the way of Markdown, which takes underscores for its own."""
    from latex2mathml.converter import convert

    formulas.append(convert(latex.strip(), display=display))
    return f"formula{len(formulas) - 1}mark"


def _short(name: str) -> str:
    return name.removeprefix("uvms_ocp.")


def page_of(title: str, body: str, contents: Contents) -> str:
    """A whole page in the look of those that the generator makes."""
    from pdoc.render import env

    values: dict[str, Any] = {"title": title, "body": body, "contents": contents, "css": _CSS}
    return str(env.from_string(_PAGE).render(**values))


def title_of(text: str) -> str:
    """The first heading of a page in Markdown."""
    return text.splitlines()[0].lstrip("# ").strip()


# The whole reference: pages of all rooms by pdoc, pages of theory and tables, and one that leads to all of them.

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
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            pdoc.pdoc(*_asked_for(modules), output_directory=folder)
        _without_private_links(folder)
        _write_pages(folder, written, modules)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written ({error}); choose another folder") from error
    wrong = [*(str(item.message).splitlines()[0] for item in warned), *broken_links(folder)]
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
