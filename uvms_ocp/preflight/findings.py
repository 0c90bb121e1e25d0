"""What the checks found."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from uvms_ocp.arguments import checked
from uvms_ocp.shown.small_table import SmallTable, Tabled


class Severity(enum.Enum):
    """How bad a finding is."""

    ERROR = "error"
    """The mission cannot be completed as it is."""
    WARNING = "warning"
    """It may fail, or do what was not meant."""
    NOTE = "note"
    """A figure worth knowing."""


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class Finding:
    """One result of one check, in one sentence, with its figures (lengths in m, angles in rad, forces in N)."""

    severity: Severity
    check: str
    text: str
    phase: str = ""
    """Name of the phase concerned."""
    figures: Mapping[str, Any] = field(default_factory=dict)


@checked
@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class PreflightReport(Tabled):
    """All findings of one mission, errors first."""

    findings: tuple[Finding, ...]

    def __post_init__(self) -> None:
        order = list(Severity)
        ranked = sorted(self.findings, key=lambda finding: order.index(finding.severity))
        object.__setattr__(self, "findings", tuple(ranked))

    def _table(self) -> SmallTable:
        verdict = "accepted" if self.accepted else "refused"
        rows = tuple((item.severity.value, item.phase, item.check, item.text) for item in self.findings)
        return SmallTable(title=f"Pre-flight: {verdict}", head=("severity", "phase", "check", "finding"), rows=rows)

    @property
    def errors(self) -> tuple[Finding, ...]:
        return self._of(Severity.ERROR)

    @property
    def warnings(self) -> tuple[Finding, ...]:
        return self._of(Severity.WARNING)

    @property
    def accepted(self) -> bool:
        """No error was found."""
        return not self.errors

    def of_check(self, check: str) -> tuple[Finding, ...]:
        """The findings of one check, such as ``reachability``."""
        return tuple(finding for finding in self.findings if finding.check == check)

    def to_dict(self) -> dict[str, Any]:
        """JSON values only."""
        rows = [
            {
                "severity": finding.severity.value,
                "check": finding.check,
                "phase": finding.phase,
                "text": finding.text,
                "figures": dict(finding.figures),
            }
            for finding in self.findings
        ]
        return {"accepted": self.accepted, "findings": rows}

    def _of(self, severity: Severity) -> tuple[Finding, ...]:
        return tuple(finding for finding in self.findings if finding.severity is severity)
