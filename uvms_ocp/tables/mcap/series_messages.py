"""A message for every tick of a series, with a field for every column: what is written is read again to the last digit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

_KINDS = {"f": ("TYPE_DOUBLE", "f8"), "i": ("TYPE_INT64", "i8"), "u": ("TYPE_UINT64", "u8"), "b": ("TYPE_BOOL", "?")}
"""Of fields and of their values, by the kind of an array: wide enough for all of its kind."""
_RESERVED = range(19000, 20000)  # numbers that fields may not have


def series_message(name: str, kind: str, columns: Sequence[str]) -> Any:
    """The class of the messages of a series; kind: of its array, "f", "i", "u" or "b"."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    title = field_names([name])[0]
    file = descriptor_pb2.FileDescriptorProto(name=f"uvms_ocp/{title}.proto", package="uvms_ocp", syntax="proto3")
    message = file.message_type.add(name=title)
    own = descriptor_pb2.FieldDescriptorProto
    for number, column in zip(_numbers(len(columns)), field_names(columns), strict=True):
        message.field.add(
            name=column, number=number, type=getattr(own, _KINDS[kind][0]), label=own.Label.Value("LABEL_OPTIONAL")
        )
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"uvms_ocp.{title}"))


def field_names(columns: Sequence[str]) -> list[str]:
    """Names that a message may have, each once."""
    found: list[str] = []
    for column in columns:
        plain = re.sub(r"\W", "_", column, flags=re.ASCII) or "_"
        plain = f"_{plain}" if plain[0].isdigit() else plain
        found.append(plain if plain not in found else f"{plain}_{len(found) + 1}")
    return found


def values_of(messages: Sequence[Any], dtype: str, n_axes: int) -> np.ndarray:
    """The series (n, k), or (n,) with one axis, of its messages; dtype: as numpy writes it. Raises `ValueError` for another."""
    wanted = np.dtype(dtype)
    if wanted.kind not in _KINDS:
        raise ValueError(f"a series of {dtype[:20]!r}")
    fields = [field.name for field in messages[0].DESCRIPTOR.fields]
    rows = [[getattr(message, field) for field in fields] for message in messages]
    found = np.array(rows, dtype=_KINDS[wanted.kind][1]).reshape(len(rows), -1).astype(wanted)
    return found[:, 0] if n_axes == 1 else found


def _numbers(n: int) -> list[int]:
    allowed = (k for k in range(1, n + 1 + len(_RESERVED)) if k not in _RESERVED)
    return [number for number, _ in zip(allowed, range(n), strict=False)]
