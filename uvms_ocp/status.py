"""Outcomes that say what to do about them."""

from __future__ import annotations

from enum import Enum
from typing import TypeVar

_Status = TypeVar("_Status", bound="AdvisedStatus")


class AdvisedStatus(Enum):
    """A numerical outcome. Members are written ``NAME = "value", "advice"``."""

    advice: str
    """What to do about it, one sentence for the user."""

    def __new__(cls: type[_Status], value: str, advice: str) -> _Status:
        status = object.__new__(cls)
        status._value_, status.advice = value, advice
        return status
