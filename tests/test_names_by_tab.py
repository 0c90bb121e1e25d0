"""Names are found by Tab: what stands in the brackets of a record, a robot and a campaign, and what
a scenario takes.
"""

from __future__ import annotations

import warnings
from typing import Any

import pytest

import uvms_ocp as uo
from uvms_ocp.campaign import Campaign, Uniform, Variation
from uvms_ocp.errors import NameNotFound

ROBOT = uo.load_robot("girona_maris7")
CAMPAIGN = Campaign(
    scenario="case1",
    variations=[Variation(name, Uniform(0.5, 1.5)) for name in ("water.drag", "water.added_mass")],
)


@pytest.fixture(scope="module")
def completer() -> Any:
    shells = pytest.importorskip("IPython.core.interactiveshell")
    shell = shells.InteractiveShell()
    shell.user_ns.update(uo=uo, robot=ROBOT, campaign=CAMPAIGN)
    return shell.Completer


def found(completer: Any, text: str) -> set[str]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return {completion.text for completion in completer.completions(text, len(text))}


def test_tab_finds_joints_and_varied_values_in_brackets(completer: Any) -> None:
    assert set(ROBOT.joint_names) <= found(completer, 'robot["')
    assert {"water.drag", "water.added_mass"} <= found(completer, 'campaign["')


def test_tab_finds_what_a_scenario_takes(completer: Any) -> None:
    assert {"current=", "duration=", "noise="} <= found(completer, "uo.scenario.case1(")


def test_what_tab_finds_is_there() -> None:
    for name in ROBOT._ipython_key_completions_():
        assert ROBOT[name] is ROBOT.joint(name)
    for name in CAMPAIGN._ipython_key_completions_():
        assert CAMPAIGN[name].name == name
    for value in (ROBOT, CAMPAIGN):
        with pytest.raises(NameNotFound, match="nose"):
            value["nose"]
