"""What pre-flight and export cannot say of parts that are not the toolkit's."""

from __future__ import annotations

from collections.abc import Iterator

from uvms_ocp.preflight.findings import Finding, Severity
from uvms_ocp.preflight.setup import Setup

_TELLS = {
    "plant": "forces, floor and obstacles are judged by the robot's files, which it may not follow; no part of an export",
    "sensors": "accuracy is judged by their specs; no part of an export",
    "estimator": "accuracy is judged by the toolkit's filter; no part of an export, which begins at its measurements",
    "controller": "the mission is judged as the hierarchy would fly it; it has no form in C, so that it cannot be exported",
}
"""By what the part is."""


def check_own_parts(setup: Setup) -> Iterator[Finding]:
    """A note on each."""
    for what, name in setup.own_parts.items():
        yield Finding(severity=Severity.NOTE, check="parts", text=f"{what} {name} is your own: {_TELLS[what]}")
