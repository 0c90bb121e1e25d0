"""Logs of PX4 as its logger writes them: formats, subscriptions and data, little endian and
packed.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

Topic = tuple[str, Sequence[float] | np.ndarray, Mapping[str, np.ndarray]]
"""Name, times [s] since the start, and fields: (n,) or, of an array, (n, k)."""


def write_ulog(path: Path, topics: Sequence[Topic], *, cut: int | None = None) -> None:
    """Topics that have the same name are instances of one."""
    parts = [b"ULog\x01\x125\x01" + struct.pack("<Q", 0)]
    rows = list[tuple[float, bytes]]()
    counts = dict.fromkeys((name for name, _, _ in topics), 0)
    for name, _, fields in {topic[0]: topic for topic in topics}.values():
        said = "".join(
            f"float{f'[{x.shape[1]}]' if x.ndim == 2 else ''} {field};"
            for field, x in fields.items()
        )
        parts.append(_message("F", f"{name}:uint64_t timestamp;{said}".encode()))
    for k, (name, t, fields) in enumerate(topics):
        parts.append(_message("A", struct.pack("<BH", counts[name], k) + name.encode()))
        counts[name] += 1
        values = np.column_stack(list(fields.values())).astype("<f4")
        for when, row in zip(t, values, strict=True):
            rows.append(
                (when, _message("D", struct.pack("<HQ", k, round(1e6 * when)) + row.tobytes()))
            )
    path.write_bytes(
        b"".join([*parts, *(one for _, one in sorted(rows, key=lambda one: one[0]))])[:cut]
    )


def _message(kind: str, content: bytes) -> bytes:
    return struct.pack("<HB", len(content), ord(kind)) + content
