"""What a scene draws is what was recorded, at every time, of every scenario that is shipped."""

from __future__ import annotations

import base64
import json
import re
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import umsgpack
from compiler import long_without_compiler

from uvms_ocp.scenario.cases import SCENARIOS
from uvms_ocp.viz import show

FPS = 25.0
# [m, -] keys that lines between others miss by 0.5e-3 are left out, and frames lie between rows
_MISSED = 1.5e-3


def _block(page: str, name: str) -> Any:
    (encoded,) = re.findall(
        rf'<script type="application/json" id="{name}">(.*?)</script', page, re.DOTALL
    )
    return json.loads(encoded)


def _tracks(page: str) -> dict[tuple[str, str], Any]:
    """Times [s] and values of what is animated, by its node and property."""
    commands = [umsgpack.unpackb(base64.b64decode(blob)) for blob in _block(page, "commands")]
    (command,) = [animation for animation in commands if animation["type"] == "set_animation"]
    tracks_by_path = {}
    for animation in command["animations"]:
        for track in animation["clip"]["tracks"]:
            times = np.array([key["time"] for key in track["keys"]]) / animation["clip"]["fps"]
            tracks_by_path[animation["path"].split("/")[-1], track["name"]] = (
                times,
                np.array([key["value"] for key in track["keys"]]),
            )
    return tracks_by_path


@pytest.mark.slow
@long_without_compiler
@pytest.mark.parametrize("name", SCENARIOS)
def test_links_and_quantities_are_those_of_the_record(name: str) -> None:
    scenario = SCENARIOS[name](duration=4.0)
    record = scenario.run()
    model = scenario.robot.model
    page = show(record, scenario.robot, fps=FPS).html
    details = _block(page, "details")
    tracks = _tracks(page)
    data = model.createData()
    t = record["t"] - record["t"][0]
    for row in range(0, len(t), max(1, len(t) // 60)):
        pin.forwardKinematics(model, data, record["q"][row])
        for joint in range(1, model.njoints):
            node = f"{joint:02d} {model.names[joint]}"
            times, places = tracks[node, ".position"]
            shown = [np.interp(t[row], times, column) for column in places.T]
            np.testing.assert_allclose(
                shown, data.oMi[joint].translation, atol=_MISSED, err_msg=f"{node} at {t[row]:g} s"
            )
            times, turns = tracks[node, ".quaternion"]
            turn = np.array([np.interp(t[row], times, column) for column in turns.T])
            expected = pin.SE3ToXYZQUAT(data.oMi[joint])[3:]
            np.testing.assert_allclose(
                abs(turn @ expected) / np.linalg.norm(turn), 1.0, atol=_MISSED**2
            )
    rows = np.searchsorted(t, np.array(details["times"]) - 1e-3)
    readouts = {item["label"]: item["values"] for item in details["readouts"]}
    for k, quantity in enumerate(record.meta.quantities):
        task, _, kind = quantity.rpartition(".")
        values = record["quantities"][rows, k]
        if np.isfinite(values).any():
            shown = np.array(readouts[f"{task} {kind.replace('_', ' ')}".strip()], dtype=float)
            np.testing.assert_allclose(shown, values, rtol=6e-3, atol=1e-12, err_msg=quantity)
