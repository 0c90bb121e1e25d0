"""Check: what the tool carries can be learnt by this robot, on this plant."""

from __future__ import annotations

from collections.abc import Iterator

from uvms_ocp.control.load.learnable import require_learnable
from uvms_ocp.exceptions import UvmsError
from uvms_ocp.preflight.findings import Finding, Severity
from uvms_ocp.preflight.setup import Setup

_CHECK = "load"


def check_load(setup: Setup) -> Iterator[Finding]:
    """Where it is to be learnt: an error where our controller would refuse, and what comes of it elsewhere."""
    if setup.load_bandwidth is None:
        return
    if not setup.with_forces:
        text = "the kinematic plant carries no load, and none is learnt; use the dynamic plant"
        yield Finding(severity=Severity.WARNING, check=_CHECK, text=text)
    elif "controller" in setup.own_parts:
        text = "a controller of your own learns no load by itself; the toolkit's does"
        yield Finding(severity=Severity.WARNING, check=_CHECK, text=text)
    else:
        yield _learnt(setup)


def _learnt(setup: Setup) -> Finding:
    try:
        require_learnable(setup.robot, observed=bool(setup.load_bandwidth))
    except UvmsError as error:
        return Finding(severity=Severity.ERROR, check=_CHECK, text=str(error))
    text = "the load at the tool is learnt: its net weight from forces, its mass once the tool accelerates"
    return Finding(severity=Severity.NOTE, check=_CHECK, text=text)
