"""How far a long benchmark is."""

from __future__ import annotations

import sys


def show_runs(done: int, failed: int, total: int) -> None:
    """Show how far a campaign is; failures are rows, and are told there."""
    show_progress(done, total)


def show_progress(done: int, total: int) -> None:
    """One line on stderr for every twentieth part."""
    if done % max(1, total // 20) == 0:
        sys.stderr.write(f"{done} of {total}\n")
