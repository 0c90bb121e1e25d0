"""The report of a campaign as one page of HTML, which needs no network."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em; color: #1a1a1a }
h1 { font-size: 1.5em } h2 { font-size: 1.15em; margin-top: 2em }
table { border-collapse: collapse; font-size: 13px; display: block; overflow-x: auto }
td, th { padding: .25em .7em; border-bottom: 1px solid #ddd; text-align: left; vertical-align: top }
td.n { text-align: right; font-variant-numeric: tabular-nums } img { max-width: 100%; margin: .5em 0 }
.rate { font-size: 1.35em } code { background: #f3f3f3; padding: .1em .3em }
"""
_SAME = "Nothing but the seed of each run."


def report_page(report: Mapping[str, Any], figures: Mapping[str, bytes]) -> str:
    """A page of a report, with PNG figures by their titles."""
    title = f"Campaign {report['campaign']}"
    state = f"{report['finished']} of {report['runs']} runs are finished"
    drawn = f"sampler {report['sampler']}, seed {report['seed']}, uvms_ocp {report['package']}"
    parts = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="rate">Success: {escape(report["success_text"])}</p>',
        f"<p>Counted as success: {escape('; '.join(report['criterion']))}. {escape(state)}; {escape(drawn)}.</p>",
        *(_figure(name, png) for name, png in figures.items()),
        "<h2>Outcomes</h2>" + _table(report["outcomes"]),
        "<h2>Causes of failure</h2><p>Causes that differ in their numbers alone are one; the numbers are those of the run that "
        "is named.</p>" + _table(report["causes"], "No run failed."),
        "<h2>Distributions</h2>" + _table(report["distributions"], "No run has a figure of merit."),
        "<h2>Sensitivity</h2><p>Spearman's rank correlation is a first look; a PAWN index that is not clearly above its "
        "floor says nothing; s1 and st are Sobol' indices, of their own design only.</p>"
        + _table(report["sensitivity"], report["sensitivity_silent"]),
        f"<h2>The {len(report['worst'])} worst runs</h2><p>Worst first: {escape(report['worst_first'])}.</p>"
        + _table(report["worst"], code=("repeat",)),
        "<h2>What was varied</h2>"
        + _table([{"parameter": name, "distribution": text} for name, text in report["parameters"].items()], _SAME),
    ]
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>{_STYLE}</style>'
    return f"<!doctype html><html><head>{head}</head><body>{''.join(parts)}</body></html>\n"


def _figure(name: str, png: bytes) -> str:
    data = base64.b64encode(png).decode("ascii")
    return f'<figure><img alt="{escape(name)}" src="data:image/png;base64,{data}"></figure>'


def _table(rows: Sequence[Mapping[str, Any]], empty: str = "", code: Sequence[str] = ()) -> str:
    """empty: why there is no row."""
    if not rows:
        return f"<p>{escape(empty)}</p>"
    columns = list(dict.fromkeys(name for row in rows for name in row))
    head = "".join(f"<th>{escape(name.replace('_', ' '))}</th>" for name in columns)
    body = "".join(f"<tr>{''.join(_cell(row.get(name), name in code) for name in columns)}</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def _cell(value: Any, is_code: bool) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "<td>-</td>"
    if isinstance(value, int | float):
        return f'<td class="n">{value:.4g}</td>' if isinstance(value, float) else f'<td class="n">{value}</td>'
    text = escape(str(value))
    return f"<td><code>{text}</code></td>" if is_code else f"<td>{text}</td>"
