"""One doubt about a recording."""

from __future__ import annotations

from dataclasses import dataclass

from uvms_ocp.arguments import checked


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class Doubt:
    """Of which channel, and what speaks against it."""

    channel: str
    problem: str

    def __str__(self) -> str:
        return f"{self.channel}: {self.problem}"
