"""How far each sensor can be trusted, and why."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from uvms_ocp.arguments import checked


class Trust(enum.IntEnum):
    """Of one channel."""

    GOOD = 0
    """Its readings are used."""
    SUSPECT = 1
    """Something speaks against it: its readings are used with care, or not for the moment."""
    LOST = 2
    """Its readings are not used."""


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelHealth:
    """What is thought of one channel."""

    channel: str
    """Its name, a field of `Readings`."""
    trust: Trust
    why: str = ""
    """A few words with the figures; empty where it is good."""
    since: float = 0.0
    """[s] since when."""
