"""Inside a tree: run the tests that stand on stdin, one a line, and write what came of each to the
file given first.
"""

from __future__ import annotations

import json
import resource
import sys
from collections import defaultdict
from pathlib import Path

import pytest

_MEMORY = 12 << 30  # [B] of addresses: a mutant may ask for any amount


class Outcomes:
    """Collects times and failures."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.failed: dict[str, None] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Called by pytest after set-up, call and tear-down of a test."""
        self.seconds[report.nodeid] += report.duration
        if report.failed:
            self.failed[report.nodeid] = None

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Called by pytest for every file that it has looked into."""
        if report.failed:
            self.failed[report.nodeid] = None


def main() -> None:
    """Run and write."""
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    outcomes = Outcomes()
    result, *options = sys.argv[1:]
    tests = [line for line in sys.stdin.read().splitlines() if line]
    code = pytest.main([*options, *tests], plugins=[outcomes])
    outcome = {"code": int(code), "failed": list(outcomes.failed), "seconds": outcomes.seconds}
    Path(result).write_text(json.dumps(outcome))


if __name__ == "__main__":
    main()
