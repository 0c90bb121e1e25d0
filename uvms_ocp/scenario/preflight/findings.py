"""What pre-flight checks find: findings by severity, and the report of all of them."""

from __future__ import annotations

import enum
import textwrap
from collections.abc import Mapping
from dataclasses import field
from typing import Any

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.record.display import WIDTH, SmallTable, TableDisplay


class Severity(enum.Enum):
    """Severity of a finding."""

    ERROR = "error"
    """The mission cannot be completed as it is."""
    WARNING = "warning"
    """It may fail, or do what was not meant."""
    NOTE = "note"
    """A figure worth knowing."""

    def finding(self, check: str, text: str, phase: str = "", **figures: Any) -> Finding:
        """Make a finding of this severity; figures [m, rad, N] by name."""
        return Finding(severity=self, check=check, phase=phase, text=text, figures=figures)


@checked_dataclass()
class Finding:
    """One result of one check, in one sentence, with its figures (lengths in m, angles in rad,
    forces in N).
    """

    severity: Severity
    check: str
    """Name of the check, such as ``reachability``."""
    text: str
    """Sentence on what was found, and the cure."""
    phase: str = ""
    """Name of the phase concerned; empty for all."""
    figures: Mapping[str, Any] = field(default_factory=dict)
    """Numbers behind the finding [m, rad, N] by name."""


@checked_dataclass(repr=False)
class PreflightReport(TableDisplay):
    """All findings of one mission, errors first."""

    findings: tuple[Finding, ...]

    def __post_init__(self) -> None:
        order = list(Severity)
        findings = sorted(self.findings, key=lambda finding: order.index(finding.severity))
        object.__setattr__(self, "findings", tuple(findings))

    def _table(self) -> SmallTable:
        verdict = "accepted" if self.accepted else "refused"
        head = ("severity", "phase", "check")
        labels = [(item.severity.value, item.phase, item.check) for item in self.findings]
        label_width = 0
        for column in zip(head, *labels, strict=True):
            label_width += 2 + max(len(text) for text in column)
        width = max(WIDTH - label_width - 2, 30)
        rows = []
        for label, item in zip(labels, self.findings, strict=True):
            lines = textwrap.wrap(item.text, width) or [""]
            rows.append((*label, lines[0]))
            rows += [("", "", "", line) for line in lines[1:]]
        return SmallTable(title=f"Pre-flight: {verdict}", head=(*head, "finding"), rows=tuple(rows))

    @property
    def errors(self) -> tuple[Finding, ...]:
        return self._of(Severity.ERROR)

    @property
    def warnings(self) -> tuple[Finding, ...]:
        return self._of(Severity.WARNING)

    @property
    def accepted(self) -> bool:
        """True where no error was found."""
        return not self.errors

    def of_check(self, check: str) -> tuple[Finding, ...]:
        """Return the findings of one check, such as ``reachability``."""
        return tuple(finding for finding in self.findings if finding.check == check)

    def to_dict(self) -> dict[str, Any]:
        """Return the report as values that JSON has."""
        rows = []
        for finding in self.findings:
            rows.append(
                {
                    "severity": finding.severity.value,
                    "check": finding.check,
                    "phase": finding.phase,
                    "text": finding.text,
                    "figures": dict(finding.figures),
                }
            )
        return {"accepted": self.accepted, "findings": rows}

    def _of(self, severity: Severity) -> tuple[Finding, ...]:
        return tuple(finding for finding in self.findings if finding.severity is severity)
