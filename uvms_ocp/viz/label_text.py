"""Make labels of names: short, and different where the names differ."""

from __future__ import annotations

from collections.abc import Sequence

from uvms_ocp.errors import plain_line

_SEPARATORS = "_./- "  # characters between the parts of a name


def label_text(name: str, longest: int = 32) -> str:
    """Return a name as a label of at most `longest` letters.

    Matplotlib leaves labels that begin with an underscore out of legends: they get a space in front.
    """
    label = plain_line(name, longest)
    if label.startswith("_"):
        return f" {label}"
    return label


def label_texts(names: Sequence[str], longest: int = 32) -> list[str]:
    """Return labels of at most `longest` letters that differ where names do.

    Names that are the same once they are cut lose the beginning that all share, then their middles;
    where that does not tell them apart, all stand in full.
    """
    begin = _shared_beginning(names)
    candidates = (
        [label_text(name, longest) for name in names],
        [label_text(name[begin:], longest) for name in names],
        [_without_middle(name[begin:], longest) for name in names],
    )
    for labels in candidates:
        if len(set(labels)) == len(set(names)):
            return labels
    return [label_text(name, len(name)) for name in names]


def _shared_beginning(names: Sequence[str]) -> int:
    """Count the letters of the whole words that all names begin with, separators included."""
    shared = 0
    for k, letters in enumerate(zip(*names, strict=False)):
        if len(set(letters)) > 1:
            break
        if letters[0] in _SEPARATORS:
            shared = k + 1
    return shared


def _without_middle(name: str, longest: int) -> str:
    """Return both ends of a name as a label of at most so many letters."""
    if len(name) <= longest:
        return label_text(name, longest)
    n_tail = (longest - 1) // 2
    n_head = longest - 1 - n_tail
    return label_text(f"{name[:n_head]}…{name[len(name) - n_tail :]}", longest)
