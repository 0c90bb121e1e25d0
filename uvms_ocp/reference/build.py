"""Build the reference: pages of the guide, of theory and of what the code states, and pages of all
packages by pdoc.

Formulas in Markdown become MathML, and names in full links to their documentation.
"""

from __future__ import annotations

import json
import re
import sys
import warnings
from collections.abc import Collection, Iterator, Sequence
from importlib.resources import files
from pathlib import Path

from uvms_ocp.errors import InvalidInput, OutputError
from uvms_ocp.reference.cited_names import CITED, address_of, documented_modules
from uvms_ocp.reference.generated_pages import generated_pages

ORDER = (
    *("notation", "motion", "thrusters", "tasks", "hierarchy", "tick", "missions", "force"),
    *("estimation", "trajectories", "collision", "optimal_control"),
)
"""Pages of theory in their order: each builds on those before."""
GUIDE = (
    *("commands_by_example", "your_robot", "your_parts", "python", "your_task"),
    "your_channel",
    *("campaigns", "your_variation", "mission_plans", "plans_by_optimal_control"),
    *("nmpc_in_your_loop", "faults", "recordings", "limitations"),
)
"""Pages on how to use it, in their order."""

Contents = dict[str, list[tuple[str, str]]]
"""Addresses and titles of pages, by heading."""

_FOLDER = files("uvms_ocp.reference")
_DISPLAY_FORMULA = re.compile(r"\$\$(.+?)\$\$", re.DOTALL)
_INLINE_FORMULA = re.compile(r"(?<![\\$\w])\$([^$\n]+?)\$(?!\w)")
_PRIVATE_LINK = re.compile(r'<a href="[^"]*#_[^"]*">(.*?)</a>', re.DOTALL)
_MOST_WARNINGS = 20
"""Warnings of the generator that an error quotes."""


def build_reference(folder: Path | str) -> Path:
    """Write the reference into a folder, which it makes; returns its first page.

    Raises `InvalidInput` where the generator is not installed, where it warns, `NameNotFound` for
    names that are cited and are not there, and `OutputError` where the folder cannot be written.
    """
    try:
        import latex2mathml.converter  # noqa: F401 - only whether it is there
        import pdoc.render
    except ImportError as error:
        raise InvalidInput(
            f'{error.name} is not installed; run: pip install "uvms-ocp[reference]"'
        ) from error
    folder = Path(folder)
    sections = {
        "Guide": guide_pages(),
        "Theory": theory_pages(),
        "Files and commands": generated_pages(),
    }
    texts = list[str]()
    for pages in sections.values():
        texts += pages.values()
    modules = documented_modules("\n".join(texts))
    pdoc.render.configure(docformat="markdown", show_source=True, search=True)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            pdoc.pdoc(*_modules_with_pages(modules), output_directory=folder)
        _clean_module_pages(folder)
        _write_pages(folder, sections, modules)
    except OSError as error:
        raise OutputError(
            f"{folder}: cannot be written ({error}); choose another folder"
        ) from error
    if caught:
        first_lines = [str(item.message).splitlines()[0] for item in caught[:_MOST_WARNINGS]]
        raise InvalidInput(f"the reference has {len(caught)} faults: {'; '.join(first_lines)}")
    return folder / "index.html"


def guide_pages() -> dict[str, str]:
    """Return the Markdown of all pages on how to use it by name, in their order."""
    return _read_pages("guide", GUIDE)


def theory_pages() -> dict[str, str]:
    """Return the Markdown of all pages of theory by name, in their order."""
    return _read_pages("theory", ORDER)


def _read_pages(folder: str, names: Sequence[str]) -> dict[str, str]:
    return {name: _read(folder, f"{name}.md") for name in names}


def _read(folder: str, name: str) -> str:
    return (_FOLDER / folder / name).read_text(encoding="utf-8")


def _modules_with_pages(modules: tuple[str, ...]) -> Iterator[str]:
    """Yield all but modules that share their name with an export of their package: they come with
    the package.
    """
    for name in modules:
        package, _, leaf = name.rpartition(".")
        if package not in modules or leaf not in getattr(sys.modules[package], "__all__", ()):
            yield name


def _clean_module_pages(folder: Path) -> None:
    """Take links to private bases of classes, which lead nowhere, and Pydantic's word for a needed
    field from the generator's pages.
    """
    for path in folder.rglob("*.html"):
        text = _PRIVATE_LINK.sub(r"\1", path.read_text(encoding="utf-8"))
        path.write_text(text.replace("PydanticUndefined", "needed"), encoding="utf-8")


def _write_pages(
    folder: Path, sections: dict[str, dict[str, str]], modules: tuple[str, ...]
) -> None:
    """Write the pages in Markdown as HTML, an index that searches them, and the first page."""
    contents: Contents = {}
    search_index = []
    for heading, pages in sections.items():
        contents[heading] = []
        for name, text in pages.items():
            address = f"{name}.html"
            contents[heading].append((address, title_of(text)))
            search_index.append((address, title_of(text), text))
    contents["Python"] = [
        (f"{name.replace('.', '/')}.html", name.removeprefix("uvms_ocp.")) for name in modules
    ]
    script = f"window.pages = {json.dumps(search_index)};\n"
    (folder / "pages.js").write_text(script, encoding="utf-8")
    first_page = _read("theory", "first_page.md")
    for address, title, text in (*search_index, ("index.html", "uvms_ocp", first_page)):
        page = page_of(title, body_of(text, modules), contents)
        (folder / address).write_text(page, encoding="utf-8")


def title_of(text: str) -> str:
    """Return the first heading of a page in Markdown."""
    return text.splitlines()[0].lstrip("# ").strip()


def page_of(title: str, body: str, contents: Contents) -> str:
    """Return a whole page in the look of those that the generator makes."""
    from pdoc.render import env

    template = env.from_string(_read("assets", "page.html.jinja2"))
    css = _read("assets", "page.css")
    return str(template.render(title=title, body=body, contents=contents, css=css))


def body_of(text: str, modules: Collection[str]) -> str:
    """Return the HTML of a page in Markdown.

    Raises `NameNotFound` for a name that is cited and is not there.
    """
    from pdoc.render_helpers import to_html

    formulas: list[str] = []

    def mark_display(match: re.Match[str]) -> str:
        return _mark_formula(formulas, match[1], "block")

    def mark_inline(match: re.Match[str]) -> str:
        return _mark_formula(formulas, match[1], "inline")

    def link(match: re.Match[str]) -> str:
        name = match[1]
        return f"[`{name.removeprefix('uvms_ocp.')}`]({address_of(name, modules)})"

    text = _DISPLAY_FORMULA.sub(mark_display, text)
    text = _INLINE_FORMULA.sub(mark_inline, text)
    text = CITED.sub(link, text)
    # Links between pages, which sites of sources follow too.
    text = re.sub(r"\((\w+)\.md\)", r"(\1.html)", text)
    html = str(to_html(text))
    return re.sub(r"formula(\d+)mark", lambda match: formulas[int(match[1])], html)


def _mark_formula(formulas: list[str], latex: str, display: str) -> str:
    """Keep a formula out of the way of Markdown, which takes underscores for its own."""
    from latex2mathml.converter import convert

    formulas.append(convert(latex.strip(), display=display))
    return f"formula{len(formulas) - 1}mark"
