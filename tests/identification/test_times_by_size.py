"""Times since 1970 say by their size in which unit they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.mapped_recordings import mapped_recording

BEGIN = 1.7e9
"""[s] since 1970."""


@pytest.mark.parametrize(("factor", "unit"), [(1.0, ""), (1e3, "ms"), (1e6, "us"), (1e9, "ns")])
@pytest.mark.parametrize("given", [False, True])
def test_a_time_since_1970_is_read_in_its_unit(
    factor: float, unit: str, given: bool, tmp_path: Path
) -> None:
    t = BEGIN + 0.1 * np.arange(50)
    rows = (
        [f"{round(at * factor)},{0.1 * k},0,0" for k, at in enumerate(t)]
        if unit
        else [f"{at:.3f},0,0,0" for at in t]
    )
    (tmp_path / "log.csv").write_text("\n".join(["stamp,x,y,z", *rows]) + "\n")
    channel = {"time": "stamp", "columns": ["x", "y", "z"]} | (
        {"time_unit": unit} if given and unit else {}
    )
    recording = mapped_recording(
        tmp_path / "log.csv", RecordingMapping.model_validate({"channels": {"position": channel}})
    )
    read = recording.channels["position"].t
    assert read - read[0] == pytest.approx(t - t[0], abs=1e-3)
    lines = [
        f'{{"stamp": {row.split(",")[0]}, "p": [{",".join(row.split(",")[1:])}]}}' for row in rows
    ]
    (tmp_path / "log.jsonl").write_text("\n".join(lines) + "\n")
    channel = channel | {"columns": ["p[0]", "p[1]", "p[2]"]}
    of_lines = mapped_recording(
        tmp_path / "log.jsonl", RecordingMapping.model_validate({"channels": {"position": channel}})
    )
    assert of_lines.channels["position"].t - of_lines.channels["position"].t[0] == pytest.approx(
        t - t[0], abs=1e-3
    )
