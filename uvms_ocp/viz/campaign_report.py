"""Report of a campaign as one page of HTML that needs no network."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from itertools import chain
from pathlib import Path
from string import Template
from typing import Any

from uvms_ocp.record.display import cell

_PICTURE = '<figure><img alt="{}" src="data:image/png;base64,{}"></figure>'
_TEXTS = (
    "campaign",
    "success_text",
    "finished",
    "runs",
    "sampler",
    "seed",
    "package",
    "worst_first",
)
"""Keys of the report that the template shows unchanged."""


def report_page(report: Mapping[str, Any], figures: Mapping[str, bytes]) -> str:
    """Return the page of a report, with PNG figures by their titles."""
    parameters = [
        {"parameter": name, "distribution": text} for name, text in report["parameters"].items()
    ]
    pictures = ""
    for name, png in figures.items():
        pictures += _PICTURE.format(escape(name), base64.b64encode(png).decode("ascii"))
    folder = Path(__file__).parent
    return Template((folder / "campaign.html").read_text(encoding="utf-8")).substitute(
        {name: escape(str(report[name])) for name in _TEXTS},
        style=(folder / "campaign.css").read_text(encoding="utf-8"),
        counted=escape("; ".join(report["criterion"])),
        figures=pictures,
        outcomes=_table(report["outcomes"]),
        causes=_table(report["causes"], "No run failed."),
        distributions=_table(report["distributions"], "No run has a figure of merit."),
        sensitivity=_table(report["sensitivity"], report["sensitivity_silent"]),
        n_worst=len(report["worst"]),
        worst=_table(report["worst"], code=("repeat",)),
        parameters=_table(parameters, "Nothing but the seed of each run."),
    )


def _table(rows: Sequence[Mapping[str, Any]], empty: str = "", code: Sequence[str] = ()) -> str:
    """Return a table of HTML; empty: why there is no row."""
    if not rows:
        return f"<p>{escape(empty)}</p>"
    columns = list(dict.fromkeys(chain.from_iterable(rows)))
    head = "".join(f"<th>{escape(name.replace('_', ' '))}</th>" for name in columns)
    lines = []
    for row in rows:
        cells = "".join(_cell(row.get(name), name in code) for name in columns)
        lines.append(f"<tr>{cells}</tr>")
    return f"<table><tr>{head}</tr>{''.join(lines)}</table>"


def _cell(value: Any, is_code: bool) -> str:
    text = escape(value if isinstance(value, str) else cell(value))
    is_number = isinstance(value, int | float) and text != cell(None)
    if is_code:
        return f"<td><code>{text}</code></td>"
    if is_number:
        return f'<td class="n">{text}</td>'
    return f"<td>{text}</td>"
