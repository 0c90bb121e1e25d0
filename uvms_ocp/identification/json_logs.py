"""Read lines of JSON, such as a DVL sends: the topic of a line is its `type`."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from functools import partial
from pathlib import Path

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.logged_message import Message
from uvms_ocp.identification.text_files import LONGEST_LINE, MOST_ROWS

load_json = partial(json.loads, parse_int=float)
"""Reads JSON; integers may have any number of digits."""


def json_messages(
    path: Path, topics: Collection[str] | None, _: Path | None, remarks: list[str]
) -> Iterator[Message]:
    """Yield the messages of topics, `None` for all; a last line that breaks off is left out, with a
    remark.

    Raises InvalidInput for too many lines, and for a line that is no JSON.
    """
    with path.open(encoding="utf-8-sig") as file:
        for number, line in enumerate(iter(lambda: file.readline(LONGEST_LINE), ""), 1):
            if number > MOST_ROWS or len(line) == LONGEST_LINE:
                raise InvalidInput(
                    f"{path}: more than {MOST_ROWS} lines, or one of {LONGEST_LINE >> 20} MB"
                )
            if not line.strip():
                continue
            try:
                message = load_json(line)
            except ValueError as error:
                is_unfinished = not line.endswith("\n") and line.count("{") > line.count("}")
                if number > 1 and is_unfinished:  # as where power was cut
                    remarks.append(f"the last line, {number}, breaks off and is left out")
                    return
                raise InvalidInput(
                    f"{path}: line {number} is no JSON ({error}); mend it, or leave it out"
                ) from None
            topic = ""
            if isinstance(message, dict):
                topic = str(message.get("type", ""))
            if topics is None or topic in topics:
                yield Message(topic, number, message)


def json_topics(path: Path) -> Collection[str]:
    """Return the topics of a file."""
    return {message.topic for message in json_messages(path, None, None, [])}
