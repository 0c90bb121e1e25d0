"""Links of the reference: from a name to its place, and which of a folder's links lead nowhere."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from uvms_ocp.reference.rooms import place_of

_LEADING = ("href", "src")


def address_of(name: str, modules: Collection[str]) -> str:
    """Where the reference has a name in full, from its top folder: on the page of its module. Raises `NameNotFound`."""
    module, rest = place_of(name)
    page = f"{module.__name__.replace('.', '/')}.html" if module.__name__ in modules else "index.html"
    return f"{page}#{rest}" if rest else page


class _Page(HTMLParser):
    """What a page refers to, and what it can be referred to by."""

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


def outside_links(folder: Path) -> Iterator[str]:
    """Scripts, styles and pictures that a page would load from a network."""
    for path in folder.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        yield from (f"{path.name}: {word}" for word in ("@import", 'src="http', "src='http") if word in text)
