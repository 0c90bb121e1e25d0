"""Exported controllers of drawn robots on drawn missions repeat what Python told, bit by bit."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from compiler import needs_compiler
from studies.drawn_exports import FUSING, drawn_case, drawn_exports, replayed, run_export, totals

from uvms_ocp.export import export_controller, exported_controller

pytestmark = needs_compiler
SWINGING = 0  # two thrusters for six axes: it swings about pitch and roll, and an arm leans out
SAMPLE = {
    "no joints, two thrusters": 2,
    "fixed base, no thrusters, Icat": 66,
    "swinging, two phases of their own goals": SWINGING,
    "planar, clearance, kinematic": 1,
    "an endless joint, clearance, a moving goal": 3,
    "no joints, twenty a second": 5,
    "planar, Icat, noise": 6,
    "Icat, a finger that follows, a fault": 11,
    "no joints, one thruster, clearance": 17,
    "joints that slide, an abort": 24,
    "no thrusters, kinematic, Icat": 43,
    "fixed base, kinematic, a finger that follows": 31,
    "fixed base, endless joints, a moving goal": 10,
    "no joints, Icat": 40,
}
"""Seeds, by what is drawn from them."""


@pytest.fixture(autouse=True)
def _silence(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.ERROR)


@pytest.mark.slow
@pytest.mark.parametrize("seed", SAMPLE.values(), ids=SAMPLE)
def test_a_sample_of_drawn_controllers_is_the_same_in_c(seed: int) -> None:
    row = run_export({"seed": seed})
    assert row["outcome"] == "the same bits", row["text"]
    assert row["ticks"] > 100


@pytest.mark.slow
def test_flags_of_a_compiler_that_would_fuse_change_no_bit(tmp_path: Path) -> None:
    """Those that would round otherwise whatever the sources say are refused."""
    export_controller(drawn_case(SWINGING, tmp_path), tmp_path / "c", "swinging")
    assert replayed(tmp_path / "c", "swinging", FUSING)["apart"] == 0
    for flag in ("-ffast-math", "-Ofast"):
        with pytest.raises(RuntimeError, match="give other numbers than were recorded"):
            replayed(tmp_path / "c", "swinging", ("-std=c99", flag))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 66, 43], ids=["no joints", "no thrusters", "neither driven"])
def test_in_the_loop_a_drawn_controller_takes_the_place_of_pythons(
    seed: int, tmp_path: Path
) -> None:
    scenario = drawn_case(seed, tmp_path)
    export_controller(scenario, tmp_path / "c")
    flown = replace(scenario, controller=exported_controller(tmp_path / "c")).run()
    record = scenario.run()
    n = len(flown["t"])
    for name in ("q", "command"):
        np.testing.assert_array_equal(flown[name], record[name][:n], err_msg=name)


def test_totals_count_every_export_once_among_all() -> None:
    study = drawn_exports(n=3, seed=7)
    assert [case["seed"] for case in study.cases] == [7, 8, 9]
    row = {
        "solver": "Icat",
        "plant": "dynamic",
        "joints": "planar",
        "thrusters": 0,
        "base": "fixed",
        "follower": False,
        "flags": "",
        "ticks": 5,
    }
    rows = [row | {"outcome": "apart"}, row | {"outcome": "the same bits", "joints": "none"}]
    sums = {total["exports"]: total for total in totals(rows)}
    assert (sums["all"]["drawn"], sums["all"]["apart"], sums["all"]["ticks"]) == (2, 1, 10)
    assert (sums["planar"]["drawn"], sums["without joints"]["the same bits"]) == (1, 1)
