"""No Parquet or MCAP file, and no packed CSV, takes more memory than it is allowed."""

from __future__ import annotations

import gzip
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.tables import read_columns
from uvms_ocp.identification.text_files import LONGEST_LINE
from uvms_ocp.record import mcap_reading as mcap_records, table_files as parquet_file
from uvms_ocp.record.mcap_reading import mcap_messages, mcap_topics
from uvms_ocp.record.record import Record

RUN = Path(__file__).parents[1] / "records"
LARGE = 8 << 20


@contextmanager
def little_memory(allowed_bytes: int = 4 << 20) -> Iterator[None]:
    tracemalloc.start()
    yield
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < allowed_bytes


def parquet_of(path: Path, columns: dict[str, Any]) -> Path:
    pa = pytest.importorskip("pyarrow", reason='needs pip install "uvms-ocp[campaign]"')
    pytest.importorskip("pyarrow.parquet").write_table(pa.table(columns), path)
    return path


def test_rows_that_a_parquet_file_holds_in_a_few_bytes_are_refused_unread(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = parquet_of(tmp_path / "a.parquet", {"t": np.zeros(LARGE // 8)})
    assert read_columns(path, ["t"]).shape == (LARGE // 8, 1)
    monkeypatch.setattr(parquet_file, "SMALL", 1 << 20)
    with pytest.raises(InvalidInput, match="at most 400 times a file are read"):
        read_columns(path, ["t"])


def test_a_record_is_refused_by_the_same_law(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pyarrow", reason='needs pip install "uvms-ocp[campaign]"')
    Record.load(RUN / "plan_curve_v0_1.npz").to_parquet(tmp_path / "a.parquet")
    Record.from_parquet(tmp_path / "a.parquet")
    monkeypatch.setattr(parquet_file, "SMALL", 0)
    monkeypatch.setattr(parquet_file, "DENSEST", 0)
    with pytest.raises(InvalidInput, match=r"a\.parquet: .* times a file are read"):
        Record.from_parquet(tmp_path / "a.parquet")


def test_what_is_not_there_is_no_number_whatever_the_column_holds(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    stamps = pa.array([1_700_000_000_000, None], pa.timestamp("ms"))
    path = parquet_of(
        tmp_path / "a.parquet",
        {"t": stamps, "on": pa.array([True, None]), "n": pa.array([3, None])},
    )
    np.testing.assert_array_equal(
        read_columns(path, ["t", "on", "n"]), [[1.7e12, 1.0, 3.0], [np.nan] * 3]
    )


def test_columns_of_text_are_no_numbers(tmp_path: Path) -> None:
    path = parquet_of(tmp_path / "a.parquet", {"t": [0.0, 1.0], "a": ["x", "y"]})
    with pytest.raises(InvalidInput, match="column a holds string; numbers are read"):
        read_columns(path, ["t", "a"])


def test_a_line_without_end_is_refused_before_it_is_whole(tmp_path: Path) -> None:
    with gzip.open(tmp_path / "a.csv.gz", "wb") as file:
        for _ in range(64):
            file.write(b"1" * LONGEST_LINE)
    with little_memory(8 << 20), pytest.raises(InvalidInput, match="a line of more than 1 MB"):
        read_columns(tmp_path / "a.csv.gz", ["t"])


def mcap_of(
    path: Path, data: bytes, compression: str = "ZSTD", uncompressed: int | None = None
) -> Path:
    """One message; uncompressed: what its chunk says of its size [B], instead of the truth."""
    writer = pytest.importorskip("mcap.writer", reason='needs pip install "uvms-ocp[mcap]"')
    with path.open("wb") as file:
        mcap_writer = writer.Writer(
            file, compression=getattr(writer.CompressionType, compression), chunk_size=1 << 30
        )
        mcap_writer.start()
        channel = mcap_writer.register_channel("/a", "json", 0)
        mcap_writer.add_message(channel, 0, data, 0)
        mcap_writer.finish()
    if uncompressed is not None:
        content = bytearray(path.read_bytes())
        place = content.index(b"\x06", 9 + 8 + 4)  # the chunk follows the header
        content[place + 9 + 16 : place + 9 + 24] = uncompressed.to_bytes(8, "little")
        path.write_bytes(bytes(content))
    return path


@pytest.mark.parametrize("compression", ["ZSTD", "LZ4", "NONE"])
def test_messages_are_unpacked_as_they_were(compression: str, tmp_path: Path) -> None:
    path = mcap_of(tmp_path / "a.mcap", b"[1, 2]", compression)
    ((schema, channel, message),) = mcap_messages(path)
    assert (schema, channel.topic, message.data) == (None, "/a", b"[1, 2]")
    assert mcap_topics(path) == ("/a",)
    assert list(mcap_messages(path, {"/b"})) == []


@pytest.mark.parametrize("compression", ["ZSTD", "LZ4"])
def test_a_chunk_that_holds_more_than_it_says_is_refused_unread(
    compression: str, tmp_path: Path
) -> None:
    path = mcap_of(tmp_path / "a.mcap", bytes(LARGE), compression, uncompressed=1000)
    with little_memory(), pytest.raises(InvalidInput, match="does not hold the 1000 bytes"):
        list(mcap_messages(path))


def test_a_chunk_that_says_to_hold_gigabytes_is_refused_unread(tmp_path: Path) -> None:
    path = mcap_of(tmp_path / "a.mcap", bytes(1000), uncompressed=1 << 40)
    with little_memory(), pytest.raises(InvalidInput, match="at most 64 MB are read"):
        list(mcap_messages(path))


def test_many_chunks_that_pack_too_well_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = mcap_of(tmp_path / "a.mcap", bytes(LARGE))
    assert len(list(mcap_messages(path))) == 1
    monkeypatch.setattr(mcap_records, "SMALL", 1 << 20)
    with little_memory(), pytest.raises(InvalidInput, match="at most 400 times a file are read"):
        list(mcap_messages(path))
