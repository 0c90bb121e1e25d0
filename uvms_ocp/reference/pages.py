"""From Markdown to pages: formulas become MathML, names in full become links to their documentation."""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Any

from uvms_ocp.reference.links import address_of
from uvms_ocp.reference.rooms import CITED

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
