"""Join commands that come in parts, such as a topic for each thruster: rows at the union of their times,
each part held from its last sample, from where all are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.tables import TableColumns
from uvms_ocp.identification.text_files import MOST_ROWS


def joined_parts(
    key: str, parts: Sequence[TableColumns | float], names: Sequence[str]
) -> TableColumns:
    """Join the parts of a channel: times [s] and values (n, 1 + k) [unit of the channel] of each, or a
    number that stands for one; names: of the parts, where they have any.

    Samples that are not finite are left out: a part is held over them. Raises InvalidInput for
    parts that have no sample or no time in common, and for a part of one name with several numbers.
    """
    samples = []
    for number, part in enumerate(parts, start=1):
        if isinstance(part, TableColumns):
            where = f"{key}: part {number} of {len(parts)}"
            if names and part.values.shape[1] != 2:
                raise InvalidInput(
                    f"{where}: {part.values.shape[1] - 1} numbers given; allowed: one, as it has a name"
                )
            samples.append(_in_order(where, part.values))
    times = np.unique(np.concatenate([rows[:, 0] for rows in samples]))
    begin = max(rows[0, 0] for rows in samples)
    if begin > min(rows[-1, 0] for rows in samples):
        raise InvalidInput(
            f"{key}: one of its parts begins at {begin:.10g} s, after another has ended; give parts"
            " of one clock"
        )
    unknown = float(begin - times[0])
    times = times[times >= begin]
    if len(times) > MOST_ROWS:
        raise InvalidInput(
            f"{key}: {len(times)} times of all its parts; allowed: {MOST_ROWS}; give recordings one"
            " by one"
        )
    columns = [times]
    remaining = iter(samples)
    for part in parts:
        if isinstance(part, TableColumns):
            rows = next(remaining)
            last = np.searchsorted(rows[:, 0], times, side="right") - 1
            columns += list(rows[last, 1:].T)
        else:
            columns.append(np.full(len(times), part))
    tables = [part for part in parts if isinstance(part, TableColumns)]
    layouts = dict.fromkeys(table.layout for table in tables if table.layout)
    return TableColumns(
        values=np.column_stack(columns),
        units=(),
        remarks=tuple(dict.fromkeys(chain.from_iterable(table.remarks for table in tables))),
        layout="; ".join(layouts),
        stated_unit=", ".join(dict.fromkeys(t.stated_unit for t in tables if t.stated_unit)),
        notes=(
            *dict.fromkeys(chain.from_iterable(table.notes for table in tables)),
            (
                f"{key}: {len(parts)} parts, each held from its last sample, all known"
                f" {unknown:.3g} s after the first"
            ),
        ),
    )


def _in_order(where: str, rows: np.ndarray) -> np.ndarray:
    """Return the finite rows (n, 1 + k) in the order of their times; of several at one time, the last."""
    rows = rows[np.isfinite(rows).all(axis=1)]
    if not len(rows):
        raise InvalidInput(f"{where} has no sample; give a number in its place")
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    is_last = np.r_[np.diff(rows[:, 0]) > 0.0, True]
    return rows[is_last]
