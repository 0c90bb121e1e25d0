"""Tell the senders of one topic apart: systems and components of MAVLink, publishers and connections
of ROS, instances of a sensor, and the frames that messages name.

A mapping picks one of them by ``rows``, as by fields of the messages.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Any

import yaml

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.identification.message_fields import steps_of, value_at

Identity = Mapping[str, float | str]
"""Fields and values that identify a sender, such as ``{system: 1, component: 1}``."""

_FRAMES = ("header.frame_id", "child_frame_id", "frame_id")
"""Fields in which messages of ROS and Foxglove name their frames."""
_FRAME_STEPS = tuple((name, steps_of(name)) for name in _FRAMES)
_MOST_LISTED = 6  # senders that an error names


class SenderCount:
    """Count of the messages of one channel by their senders."""

    def __init__(self) -> None:
        self._counts: Counter[tuple[tuple[str, float | str], ...]] = Counter()

    def add(self, identity: Identity, content: Any) -> None:
        """Count one message, by who sent it and by the frames that it names."""
        frames = _frames_of(content)
        self._counts[(*identity.items(), *frames)] += 1

    def require_single(self, where: str, rows: Mapping[str, float | str]) -> None:
        """Check that there is a single sender; rows: conditions by which a mapping picks messages
        so far.

        Raises InvalidInput with the senders that there are, and the rows that pick the one with
        most messages.
        """
        if len(self._counts) < 2:
            return
        senders = [(dict(names), n) for names, n in self._counts.most_common()]
        telling = _telling_names([names for names, _ in senders])
        listed = []
        for names, n in senders[:_MOST_LISTED]:
            listed.append(f"{_as_yaml(names, telling)} ({n} messages)")
        if len(senders) > _MOST_LISTED:
            listed.append(f"{len(senders) - _MOST_LISTED} more")
        first, _ = senders[0]
        pick = _as_yaml({**rows, **first}, (*rows, *telling))
        raise InvalidInput(
            f"{where} comes from {len(senders)} senders: {', '.join(listed)}; choose one, such as"
            f" rows: {pick}"
        )


def _frames_of(content: Any) -> Iterator[tuple[str, str]]:
    """Yield the frames that a message names, by the paths of their fields."""
    for name, steps in _FRAME_STEPS:
        try:
            frame = value_at(content, steps)
        except NameNotFound:
            continue
        if isinstance(frame, str):
            yield name, frame


def _telling_names(senders: list[dict[str, float | str]]) -> tuple[str, ...]:
    """Choose names by which all senders differ: the first one that does alone, or all that are not
    the same throughout.
    """
    names = tuple(dict.fromkeys(chain.from_iterable(senders)))
    for name in names:
        values = {sender.get(name) for sender in senders}
        if len(values) == len(senders):
            return (name,)
    varying = []
    for name in names:
        values = {sender.get(name) for sender in senders}
        if len(values) > 1:
            varying.append(name)
    return tuple(varying)


def _as_yaml(values: Mapping[str, float | str], names: tuple[str, ...]) -> str:
    """Write some of the values as a mapping of YAML in one line."""
    chosen = {name: values[name] for name in dict.fromkeys(names) if name in values}
    return yaml.safe_dump(chosen, default_flow_style=True, sort_keys=False, width=10_000).strip()
