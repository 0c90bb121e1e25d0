"""Read logs of PX4 (ULog) by pyulog; topics are its messages, NAME_1 for the second instance of one."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.errors import optional_module
from uvms_ocp.identification.logged_message import FieldsWithUnits, Message


def ulog_messages(path: Path, topics: Collection[str], *_: object) -> Iterator[Message]:
    """Yield the messages of some topics of a log."""
    for topic, columns in _ulog(path).items():
        if topic not in topics:
            continue
        fields = defaultdict[str, list[list[float]]](list)
        for name, column in columns.items():
            fields[re.sub(r"\[\d+\]$", "", name)].append(column.tolist())
        rows_of_fields: list[Iterable[Any]] = []
        for elements in fields.values():
            if len(elements) == 1:
                rows_of_fields.append(elements[0])
            else:
                rows_of_fields.append(zip(*elements, strict=True))
        for row in zip(*rows_of_fields, strict=True):
            content = FieldsWithUnits(zip(fields, row, strict=True))
            content.units = {"timestamp": "us"}
            yield Message(topic, 1000 * content["timestamp"], content)


def ulog_topics(path: Path) -> Collection[str]:
    """Return the topics of a log."""
    return _ulog(path).keys()


def _ulog(path: Path) -> dict[str, Mapping[str, np.ndarray]]:
    """Read the columns of all topics of a log."""
    pyulog = optional_module("pyulog", "a ULog of PX4", '"uvms-ocp[ulog]"')
    with path.open("rb") as file:
        instances = pyulog.ULog(file).data_list
    columns_by_topic = {}
    for instance in instances:
        topic = instance.name
        if instance.multi_id:
            topic = f"{instance.name}_{instance.multi_id}"
        columns_by_topic[topic] = instance.data
    return columns_by_topic
