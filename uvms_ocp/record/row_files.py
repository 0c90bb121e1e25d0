"""Write the rows of a run to the disk while it goes on, and read series without taking the memory
for all of them.

A folder has one ``.npy`` file for every series, which grows, and ``meta.json``. NumPy's own format
is written as fast as memory is copied, needs no index at its end that a kill would leave out, and
is mapped when it is read; one file for each series, so that what reads a few of them leaves the
others on the disk. Parquet and MCAP give none of these three.
"""

from __future__ import annotations

import mmap
from collections.abc import Iterable, Iterator, Mapping
from io import FileIO
from pathlib import Path
from urllib.parse import quote, unquote

import numpy as np

from uvms_ocp.types import memory_of

META = "meta.json"
_PART = 16 << 20  # [bytes] of rows that are looked at together


def append_rows(folder: Path, rows: Mapping[str, np.ndarray], n_rows: int) -> None:
    """Write rows (n, ...) of every series after the first `n_rows`, or make the files. Raises
    `OSError`.
    """
    for k, (name, part) in enumerate(rows.items()):
        path = folder / f"{k:03d}.{quote(name, safe='')}.npy"
        if not n_rows:
            np.save(path, part)
            continue
        with FileIO(path, "r+") as file:
            file.seek(0, 2)
            unwritten = memoryview(part.tobytes())
            while unwritten:
                # A full disk takes less than was given, and refuses the rest.
                n_written = file.write(unwritten)
                unwritten = unwritten[n_written:]
            file.seek(0)  # last, so that a header never says more than there is
            header = {
                "descr": part.dtype.str,
                "fortran_order": False,
                "shape": (n_rows + len(part), *part.shape[1:]),
            }
            np.lib.format.write_array_header_1_0(file, header)


def read_row_files(folder: Path) -> dict[str, np.ndarray]:
    """Read series (n, ...) by name, mapped, with the rows that all of them have. Raises `OSError`
    and `ValueError`.
    """
    series = dict[str, np.ndarray]()
    for path in sorted(folder.glob("*.npy")):
        _, _, name = path.stem.partition(".")
        series[unquote(name)] = np.load(path, "r")
    n_rows = min(map(len, series.values()), default=0)
    return {name: array[:n_rows] for name, array in series.items()}


def parts(*arrays: np.ndarray, rows: int = 0) -> Iterator[tuple[np.ndarray, ...]]:
    """Give the rows of arrays (n, ...) in parts of so many rows, by default of 16 MB; of mapped
    arrays no other rows stay in memory.
    """
    if not rows:
        row_size = max(array[:1].nbytes for array in arrays)  # [B] of the widest
        rows = max(1, _PART // max(1, row_size))
    for start in range(0, len(arrays[0]), rows):
        yield tuple(array[start : start + rows] for array in arrays)
        forget(arrays)


def forget(arrays: Iterable[np.ndarray]) -> None:
    """Give back the memory of mapped arrays, whose values are read from their files when they are
    needed again.
    """
    for mapped in map(memory_of, arrays):
        if isinstance(mapped, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
            mapped.madvise(mmap.MADV_DONTNEED)
