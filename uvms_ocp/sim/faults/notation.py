"""Faults as text, ``TARGET:KIND=VALUES@ONSET-END``; ``str`` of a fault is the way back."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

from uvms_ocp.arguments import checked
from uvms_ocp.arguments.kinds import short
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.sim.faults.fault import Fault

_FORM = "TARGET:KIND=VALUES@ONSET-END, such as altimeter:frozen@8, position:bias=5,0,0@10-20 or thruster3:dead@20"
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_TEXT = re.compile(
    r"(?P<target>\w+):(?P<kind>\w+)"
    rf"(?:=(?P<values>{_NUMBER}(?:,{_NUMBER})*))?"
    rf"(?:@(?P<onset>{_NUMBER})(?:-(?P<end>{_NUMBER}))?)?",
    re.ASCII,
)
_LONGEST = 200


@checked
def parse_fault(text: str) -> Fault:
    """The fault that a text describes: without values, onset 0 and no end where these are left out.

    Times in s, values in the units of the kind. Raises `InvalidInput` and `NameNotFound`, in one line.
    """
    found = _TEXT.fullmatch(text.strip()) if len(text) <= _LONGEST else None
    if found is None:
        raise InvalidInput(f"fault {short(text)}; write {_FORM}")
    values = tuple(float(word) for word in found["values"].split(",")) if found["values"] else ()
    onset, end = float(found["onset"] or 0.0), float(found["end"] or math.inf)
    return Fault(target=found["target"], kind=found["kind"], values=values, onset=onset, end=end)


def parse_faults(given: Iterable[str | Fault]) -> tuple[Fault, ...]:
    """Faults, of which some may be texts. Raises `InvalidInput` and `NameNotFound`, in one line."""
    return tuple(fault if isinstance(fault, Fault) else parse_fault(fault) for fault in given)
