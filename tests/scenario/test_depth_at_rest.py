"""A vehicle whose depth no thruster holds is refused for its trim only where that changes its depth for long:
what tilts as it rises is held by what rights it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studies.drawn_conditions import drawn_conditions, out_of_trim
from studies.drawn_robots import drawn_body, drawn_scenario, write_robot

from uvms_ocp.scenario.preflight import Severity

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")


def test_a_vehicle_that_tilts_as_it_rises_is_not_refused_for_its_trim(tmp_path: Path) -> None:
    """It completes its mission with thrust to spare: 690 kg that are 23 N too light."""
    rng = np.random.default_rng(17)
    body = drawn_body(rng)
    conditions = drawn_conditions(17)
    robot = out_of_trim(write_robot(body, rng, tmp_path), conditions, tmp_path)
    findings = drawn_scenario(robot, body, rng, conditions).check().findings
    (finding,) = [finding for finding in findings if "too light" in finding.text]
    assert finding.severity is Severity.WARNING
    assert finding.figures["way_m"] == pytest.approx(0.066, rel=0.05)
