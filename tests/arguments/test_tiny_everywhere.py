"""Every public call takes vehicles as small as they come: without joints, with one thruster, one joint or one
link in water. It answers, or refuses in one line.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import valid_calls
from public_surface import surface
from tiny_robots import TINY, robot_of, scenario_of
from valid_calls import EXPENSIVE, owner_of, right_arguments

from uvms_ocp.errors import UvmsError
from uvms_ocp.robot.robot import Robot

NEEDING_MORE = ("OcpResult", "ocp_record", "ocp_report")
"""Calls whose valid arguments are of an arm that has a joint."""
CALLS = [
    call for call in surface() if call.title not in (*EXPENSIVE, "Task.residual", *NEEDING_MORE)
]
"""All but those that take long, and one that takes the symbols of the same task."""


def _forget() -> None:
    """Forget what valid calls have made of another robot."""
    for value in vars(valid_calls).values():
        if hasattr(value, "cache_clear"):
            value.cache_clear()


@pytest.fixture
def tiny(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Robot]:
    robot = robot_of(TINY[request.param])
    scenario = scenario_of(robot, "kinematic")
    _forget()
    for name in ("scenario", "robot", "arm", "q"):
        function: Any = {
            "scenario": lambda: scenario,
            "robot": lambda: robot,
            "arm": lambda: robot,
            "q": lambda: scenario.start.copy(),
        }[name]
        monkeypatch.setattr(valid_calls, name, function)
    yield robot
    monkeypatch.undo()
    _forget()


@pytest.mark.slow
@pytest.mark.parametrize("tiny", ["no joints", "one wet link", "one thruster"], indirect=True)
def test_every_public_call_answers_or_refuses(
    tiny: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    del tiny
    monkeypatch.chdir(tmp_path)  # some calls write files
    faults = []
    for call in CALLS:
        try:
            arguments = right_arguments(call)
            function = call.function
            if call.owner is not None:
                function = getattr(owner_of(call), function.__name__)
            function(**arguments)
        except UvmsError as error:
            if "\n" in str(error):
                faults.append(f"{call.title}: {error}")
        except Exception as error:
            faults.append(f"{call.title}: {type(error).__name__}: {error}")
    assert not faults, "\n".join(faults)
