"""Citations: one page, every key resolves, every entry is cited."""

from __future__ import annotations

import re

import package_ast as house

from uvms_ocp import references

KEY = re.compile(r"\[([A-Z][A-Za-z]+[0-9]{4}[a-z]?)[\],]")
SLOPPY = re.compile(r"\((?:[A-Z][\w'. ]+,? (?:and |& )?)+(?:19|20)\d\d\)")


def test_every_key_resolves_and_every_entry_is_cited() -> None:
    listed = set(KEY.findall(references.__doc__ or ""))
    cited = set()
    for path in (*house.ROOT.rglob("*.[ch]"), *house.modules()):
        if path.name != "references.py":
            cited.update(KEY.findall(path.read_text(encoding="utf-8")))
    assert cited <= listed, f"unknown: {cited - listed}"
    assert listed <= cited, f"never cited: {listed - cited}"


def test_citations_have_keys() -> None:
    loose = []
    for path in house.modules():
        text = path.read_text(encoding="utf-8")
        loose += [f"{path.name}: {citation}" for citation in SLOPPY.findall(text)]
    assert loose == []
