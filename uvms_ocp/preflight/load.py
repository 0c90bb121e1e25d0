"""Check: what the tool carries can be learnt by this robot, on this plant."""

from __future__ import annotations

from collections.abc import Iterator

from uvms_ocp.control.load.learning import LOAD_FRAME
from uvms_ocp.preflight.findings import Finding, Severity
from uvms_ocp.preflight.setup import Setup

_CHECK = "load"


def check_load(setup: Setup) -> Iterator[Finding]:
    """Where it is to be learnt: an error where nothing can hang, or nothing is observed, and what comes of it elsewhere."""
    if setup.load_bandwidth is None:
        return
    if not setup.with_forces:
        text = "the kinematic plant carries no load, and none is learnt; use the dynamic plant"
        yield Finding(severity=Severity.WARNING, check=_CHECK, text=text)
    elif not setup.robot.has_frame(LOAD_FRAME):
        text = f"the robot has no frame {LOAD_FRAME!r} for a load to be learnt; leave the learning out"
        yield Finding(severity=Severity.ERROR, check=_CHECK, text=text)
    elif setup.load_bandwidth == 0.0:
        text = "a load is learnt from the disturbance observer, which is off; turn it on, or leave the learning out"
        yield Finding(severity=Severity.ERROR, check=_CHECK, text=text)
    elif "controller" in setup.own_parts:
        text = "a controller of your own learns no load by itself; the toolkit's does"
        yield Finding(severity=Severity.WARNING, check=_CHECK, text=text)
    else:
        text = "the load at the tool is learnt: its net weight from forces, its mass once the tool accelerates"
        yield Finding(severity=Severity.NOTE, check=_CHECK, text=text)
