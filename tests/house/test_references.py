"""Citations: one page, every key resolves, every entry is cited."""

from __future__ import annotations

import re

import package_ast as house

from uvms_ocp import references

KEY = re.compile(r"\[([A-Z][A-Za-z]+[0-9]{4}[a-z]?)[\],]")
SLOPPY = re.compile(r"\((?:[A-Z][\w'. ]+,? (?:and |& )?)+(?:19|20)\d\d\)")


def test_every_key_resolves_and_every_entry_is_cited() -> None:
    known = set(KEY.findall(references.__doc__ or ""))
    texts = [p.read_text(encoding="utf-8") for p in house.ROOT.rglob("*.[ch]")]
    texts += [
        path.read_text(encoding="utf-8") for path in house.modules() if path.name != "references.py"
    ]
    cited = {key for text in texts for key in KEY.findall(text)}
    assert cited <= known, f"unknown: {cited - known}"
    assert known <= cited, f"never cited: {known - cited}"


def test_citations_have_keys() -> None:
    loose = [
        f"{p.name}: {m}"
        for p in house.modules()
        for m in SLOPPY.findall(p.read_text(encoding="utf-8"))
    ]
    assert loose == []
