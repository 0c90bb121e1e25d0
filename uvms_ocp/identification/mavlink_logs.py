"""Read logs of MAVLink by pymavlink, dataflash (.BIN) and telemetry (.tlog); topics are the types of
messages.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from uvms_ocp.errors import optional_module
from uvms_ocp.identification.logged_message import FieldsWithUnits, Message
from uvms_ocp.identification.message_senders import Identity


def mavlink_messages(path: Path, topics: Collection[str], *_: object) -> Iterator[Message]:
    """Yield the messages of some types of a log."""
    with _mavlink(path) as log:
        for message in iter(lambda: log.recv_match(type=list(topics)), None):
            content = FieldsWithUnits(message.to_dict())
            # The first messages of dataflash say its units, of telemetry the protocol does.
            layout = getattr(message, "fmt", None)
            if layout:
                content.units = dict(zip(layout.columns, layout.units or (), strict=False))
            else:
                content.units = message.fieldunits_by_name
            logged = round(1e9 * message._timestamp)
            yield Message(message.get_type(), logged, content, _mavlink_sender(message, content))


def mavlink_topics(path: Path) -> Collection[str]:
    """Return the types of messages of a log."""
    with _mavlink(path) as log:
        return {message.get_type() for message in iter(log.recv_match, None)} - {"BAD_DATA"}


def _mavlink(path: Path) -> closing[Any]:
    """Open a log."""
    mavutil = optional_module("pymavlink.mavutil", "a log of MAVLink", '"uvms-ocp[mavlink]"')
    return closing(
        mavutil.mavlink_connection(str(path), dialect="ardupilotmega", robust_parsing=True)
    )


def _mavlink_sender(message: Any, content: Mapping[str, Any]) -> Identity:
    """Return system and component of a message of telemetry, and the instance of its sensor."""
    sender: dict[str, float | str] = {}
    layout = getattr(message, "fmt", None)
    if layout:
        instance_field = layout.instance_field
    else:
        instance_field = message.instance_field
        sender["system"] = message.get_srcSystem()
        sender["component"] = message.get_srcComponent()
    if instance_field in content:
        sender[instance_field] = content[instance_field]
    return sender
