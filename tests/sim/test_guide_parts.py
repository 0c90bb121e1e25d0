"""The plant, sensors and estimator that the guide shows run as printed, and do what they say."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import uvms_ocp as uo

GUIDE = Path(uo.__file__).parent / "reference" / "guide" / "python.md"


def test_the_parts_that_the_guide_shows_run_as_printed_and_the_plant_lags_by_what_it_says() -> None:
    (block,) = [
        block
        for block in re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.S)
        if "class Lagging" in block
    ]
    space: dict[str, Any] = {"uo": uo, "np": np, "replace": replace}
    exec(block, space)
    record = space["record"]
    meta = record.run_meta
    assert (meta.plant, meta.sensors, meta.estimator) == ("Lagging", "Sensors", "trusting")
    assert np.allclose(record["q_estimated"], record["q"], atol=0.01)
    expected = record["v"][:-1] + 5.0 * meta.dt * (record["command"][:-1] - record["v"][:-1])
    assert np.abs(record["v"][1:]).max() > 0.01
    assert np.allclose(record["v"][1:], expected, atol=1e-9)
