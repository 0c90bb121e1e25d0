"""A file of a campaign, of rows, a record or a copy."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from uvms_ocp.output.claim import in_one_line
from uvms_ocp.output.durable import replacing


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """As `replacing` gives it. Raises `OutputError` where the disk refuses."""
    with in_one_line(path, "free some space"), replacing(path) as file:
        yield file
