"""A message as a file has logged it, whatever the kind of file."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from uvms_ocp.identification.message_senders import Identity


class Message(NamedTuple):
    """One message as logged."""

    topic: str
    """Name of the topic."""
    logged: int
    """[ns] time of logging."""
    content: Any
    """Fields of the message, by their names."""
    sender: Identity = MappingProxyType({})
    """Identity of the sender; empty where the file does not tell senders apart."""


class FieldsWithUnits(dict[str, Any]):
    """Fields of a message whose units the file knows."""

    units: Mapping[str, str]
    """Unit of each field."""


def connection_identity(publisher: str, number: int, numbers: list[int]) -> Identity:
    """Return the publisher of a message, or for a file that names none the place of its connection among
    those of the topic; numbers: connections of the topic so far, which get a new one.
    """
    if publisher:
        return {"publisher": publisher}
    if number not in numbers:
        numbers.append(number)
    return {"connection": numbers.index(number)}
