"""What the processors did meanwhile: the share of them that other programs used."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

_STAT = Path("/proc/stat")
_IDLE = (3, 4)  # columns of idle time and of waiting for disks
_GUEST = 8  # column from which on time is counted twice


@dataclass(frozen=True, kw_only=True, slots=True)
class ProcessorTimes:
    """Times since the machine and this process started, of all processors together."""

    total: float
    """[s]"""
    busy: float
    """[s] with any program, or taken away by the host of a virtual machine."""
    ours: float
    """[s] with this process and those of its children that have ended."""

    @staticmethod
    def now() -> ProcessorTimes | None:
        """Read the times until now; None where the system does not tell."""
        if not _STAT.exists():
            return None
        first_line = _STAT.read_text().split("\n", 1)[0]
        ticks = [int(word) for word in first_line.split()[1:]][:_GUEST]
        idle_ticks = sum(ticks[column] for column in _IDLE)
        ticks_per_second = os.sysconf("SC_CLK_TCK")
        process = os.times()
        return ProcessorTimes(
            total=sum(ticks) / ticks_per_second,
            busy=(sum(ticks) - idle_ticks) / ticks_per_second,
            ours=process.user + process.system + process.children_user + process.children_system,
        )

    def others_until(self, later: ProcessorTimes) -> float:
        """[%] of all processors that other programs used between the two."""
        total = later.total - self.total
        if total <= 0.0:
            return 0.0
        return max(0.0, 100.0 * (later.busy - self.busy - (later.ours - self.ours)) / total)


def processor_name() -> str:
    """Read the name of the first processor, empty where the system does not tell."""
    info = Path("/proc/cpuinfo")
    if not info.exists():
        return ""
    for line in info.read_text().splitlines():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return ""
