"""The head of a recorded file: by which command, when, with which versions, on which machine, how
undisturbed.
"""

from __future__ import annotations

import os
import platform
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path

from recording.processors import ProcessorTimes, processor_name

PACKAGES = ("uvms_ocp", "numpy", "scipy", "casadi", "pin", "coal")
QUIET = 10.0
"""[%] of the processors; where other programs used more, times are not worth recording."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Head:
    """Command, date, versions, machine and load of a run: what a reader needs to repeat it and to
    trust its times.
    """

    command: str
    date: str
    versions: str
    machine: str
    others: float | None
    """[%] of all processors that other programs used during the run; None where the system does not
    tell.
    """

    @property
    def quiet(self) -> bool:
        """Whether times can be trusted."""
        return self.others is not None and self.others <= QUIET

    @property
    def load(self) -> str:
        """Describe what other programs used, with a warning where that is too much."""
        if self.others is None:
            return (
                "The system does not tell what other programs used of the processors: times may be"
                " partly theirs"
            )
        share = f"Other programs used {self.others:.1f} % of the processors"
        if self.quiet:
            return share
        return f"{share}, more than {QUIET:.0f} %: times are partly theirs, record again"

    def lines(self) -> list[str]:
        """Write the head as lines of text, the same in every file of a run."""
        return [
            f"Written by `{self.command}` on {self.date}.",
            f"{self.versions}.",
            f"{self.machine}.",
            f"{self.load}.",
        ]


@dataclass(frozen=True, slots=True)
class Beginning:
    """Command, date and processor times at the beginning of a run."""

    command: str
    date: datetime = field(default_factory=lambda: datetime.now(timezone.utc))
    processors: ProcessorTimes | None = field(default_factory=ProcessorTimes.now)

    def head(self, peers: Mapping[str, str] | None = None) -> Head:
        """Make the head of what has run since; peers: versions of other packages that were
        measured.
        """
        packages = {name: version(name) for name in PACKAGES}
        packages |= dict(peers or {})
        versions = [f"Python {platform.python_version()}"]
        versions += [f"{name} {number}" for name, number in packages.items()]
        end = ProcessorTimes.now()
        others_share = None
        if self.processors is not None and end is not None:
            others_share = self.processors.others_until(end)
        took = (datetime.now(timezone.utc) - self.date).total_seconds()
        return Head(
            command=self.command,
            date=f"{self.date:%Y-%m-%d %H:%M} UTC, in {took:.0f} s",
            versions=", ".join(versions),
            machine=_machine(),
            others=others_share,
        )


def command_line(arguments: Sequence[str]) -> str:
    """Write a command as typed in the repository; folders and programs of this machine are PATH."""
    script, *words = arguments
    shown = ["PATH" if os.sep in word else word for word in words]
    return shlex.join(["python", f"benchmarks/{Path(script).name}", *shown])


def _machine() -> str:
    threads = os.environ.get("OMP_NUM_THREADS", "as many as there are")
    processors = (
        f"{os.cpu_count()} processors ({processor_name() or platform.processor() or 'unknown'})"
    )
    return f"{platform.system()} {platform.machine()}, {processors}, OMP_NUM_THREADS {threads}"


def this_command() -> str:
    """The command that started this process."""
    return command_line(sys.argv)
