"""``check-recording``: what is in recordings, and what is doubtful about them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from uvms_ocp.cli.options import Json
from uvms_ocp.cli.printing import console_of, print_json, print_line, table_of
from uvms_ocp.identification.recordings.doubts import doubts
from uvms_ocp.identification.recordings.mapping import read_mapping
from uvms_ocp.identification.recordings.reading import read_recording
from uvms_ocp.identification.recordings.recording import KINDS, Channel, Recording

Recordings = Annotated[
    list[Path],
    typer.Argument(
        metavar="RECORDINGS...", help="CSV, Parquet, MCAP, rosbag2 folders or records of runs, one or more."
    ),
]
MappingFile = Annotated[
    Path | None,
    typer.Option("--mapping", metavar="YAML", help="Where the channels are in files of others; ours need none."),
]
_COLUMNS = ("channel", "columns", "unit", "frame", "from [s]", "to [s]", "rate [Hz]", "delay [s]")


def check_recording(paths: Recordings, mapping: MappingFile = None, as_json: Json = False) -> None:
    """Check recordings: channels, rates, delays, frames, and what is doubtful."""
    found = read_recordings(paths, mapping)
    if as_json:
        print_json({one.name: _told(one) for one in found})
        return
    console = console_of()
    for one in found:
        told = _told(one)
        console.print(table_of(one.name, told["channels"], _COLUMNS))
        for doubt in told["doubts"]:
            print_line(console, f"doubtful: {doubt}")


def read_recordings(paths: list[Path], mapping: Path | None) -> list[Recording]:
    """All of them, by one mapping where they need one. Raises InvalidInput, NameNotFound and NotInstalled."""
    given = None if mapping is None else read_mapping(mapping)
    return [read_recording(path, given) for path in paths]


def _told(recording: Recording) -> dict[str, Any]:
    rows = [_row(name, channel) for name, channel in recording.channels.items()]
    return {"channels": rows, "doubts": [str(doubt) for doubt in doubts(recording)]}


def _row(name: str, channel: Channel) -> dict[str, Any]:
    times = (float(channel.t[0]), float(channel.t[-1]))
    values = (name, channel.values.shape[1], KINDS[name].unit, KINDS[name].frame, *times, channel.rate, channel.delay)
    return dict(zip(_COLUMNS, values, strict=True))
