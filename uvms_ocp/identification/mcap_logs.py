"""Read messages of MCAP files: JSON, protobuf and messages of ROS 2."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.json_logs import load_json
from uvms_ocp.identification.logged_message import Message, connection_identity
from uvms_ocp.identification.ros_logs import ros_decoder
from uvms_ocp.record import mcap_reading


def mcap_contents(
    path: Path, topics: Collection[str], definitions: Path | None, _: list[str]
) -> Iterator[Message]:
    """Yield the messages of some topics. Raises InvalidInput for an unknown encoding."""
    decoders: dict[tuple[str, int], Callable[[bytes], Any]] = {}
    channels_of_topic = defaultdict[str, list[int]](list)
    for schema, channel, message in mcap_reading.mcap_messages(path, topics):
        key = (channel.message_encoding, channel.schema_id)
        if key not in decoders:
            decoders[key] = _decoder(channel, schema, definitions)
        publisher = channel.metadata.get("callerid", "")
        sender = connection_identity(publisher, channel.id, channels_of_topic[channel.topic])
        content = decoders[key](message.data)
        yield Message(channel.topic, message.log_time, content, sender)


def _decoder(channel: Any, schema: Any, definitions: Path | None) -> Callable[[bytes], Any]:
    """Return the function that decodes the messages of a channel. Raises InvalidInput for another
    encoding.
    """
    if channel.message_encoding == "json":
        return load_json
    if channel.message_encoding == "cdr" and schema is not None:
        return ros_decoder(schema.name, schema.encoding, schema.data.decode(), definitions)
    from mcap_protobuf.decoder import DecoderFactory

    decoder: Callable[[bytes], Any] | None = DecoderFactory().decoder_for(
        channel.message_encoding, schema
    )
    if decoder is None:
        encoding = channel.message_encoding[:40]
        raise InvalidInput(
            f"{channel.topic[:80]} is encoded as {encoding!r}; json, protobuf and cdr with a schema are"
            " read"
        )
    return decoder
