"""What the processors did meanwhile: the share of them that other programs used."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

_STAT = Path("/proc/stat")
# columns of idle and of waiting for disks; from here on, time is counted twice
_IDLE = (3, 4)
_GUEST = 8


@dataclass(frozen=True, kw_only=True, slots=True)
class ProcessorTimes:
    """Times since the machine and this process started, of all processors together."""

    total: float
    """[s]"""
    busy: float
    """[s] with any program, or taken away by the host of a virtual machine."""
    own: float
    """[s] with this process and those of its children that have ended."""

    @staticmethod
    def now() -> ProcessorTimes | None:
        """None where the system does not tell."""
        if not _STAT.exists():
            return None
        ticks = [int(word) for word in _STAT.read_text().split("\n", 1)[0].split()[1:]][:_GUEST]
        hertz, own = os.sysconf("SC_CLK_TCK"), os.times()
        return ProcessorTimes(
            total=sum(ticks) / hertz,
            busy=(sum(ticks) - sum(ticks[column] for column in _IDLE)) / hertz,
            own=own.user + own.system + own.children_user + own.children_system,
        )

    def others_until(self, later: ProcessorTimes) -> float:
        """[%] of all processors that other programs used between the two."""
        total = later.total - self.total
        if total <= 0.0:
            return 0.0
        return max(0.0, 100.0 * (later.busy - self.busy - (later.own - self.own)) / total)


def processor_name() -> str:
    """Of the first processor, empty where the system does not tell."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    return next(
        (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), ""
    )
