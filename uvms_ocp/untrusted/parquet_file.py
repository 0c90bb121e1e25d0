"""What a Parquet file says of itself, looked at before any of it is unpacked: a few bytes may stand for gigabytes of rows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.untrusted.array_file import DENSEST, SMALL

_NUMBERS = ("is_integer", "is_floating", "is_boolean", "is_timestamp")


def require_numbers(file: Any, path: Path, columns: Sequence[str]) -> None:
    """Raise `InvalidInput` where these columns of a `pyarrow.parquet.ParquetFile` are none of numbers, or far larger than it.

    Raises `NameNotFound` for a column that there is not.
    """
    from pyarrow import types

    schema = file.schema_arrow
    for name in columns:
        if name not in schema.names:
            raise NameNotFound(f"column of {path.name}", name, schema.names)
        kind = schema.field(name).type
        if not any(getattr(types, test)(kind) for test in _NUMBERS):
            raise InvalidInput(f"{path}: column {name} holds {str(kind)[:60]}; numbers are read")
    size = 8 * file.metadata.num_rows * len(columns)
    if size > max(SMALL, DENSEST * path.stat().st_size):
        raise InvalidInput(
            f"{path}: {size / 1e9:.3g} GB of numbers in {path.stat().st_size / 1e6:.3g} MB; "
            f"at most {DENSEST} times a file are read"
        )
