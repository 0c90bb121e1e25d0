"""Faults and notes of a URDF, collected so that all are told at once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from uvms_ocp.errors import RobotDataError

_T = TypeVar("_T")


class Findings:
    """All faults of one file, and the parts of it that are left out without harm."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.faults: list[str] = []
        self.notes: list[str] = []

    def attempt(self, check: Callable[..., _T], *args: Any) -> _T | None:
        """Return the result of a check; `None` where it raises, and its error becomes a fault of
        the file.
        """
        try:
            return check(*args)
        except RobotDataError as error:
            self.faults += error.problems
            return None

    def refuse(self) -> None:
        """Raise ``RobotDataError`` with all faults, if there are any."""
        if self.faults:
            raise RobotDataError(self.path, *dict.fromkeys(self.faults))
