"""How a plan ends does not depend on how busy the machine is: iterations end a search, a time only
where one is asked for.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import pytest

from uvms_ocp.mission_plan import plan_mission, planner
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.request import OcpRequest
from uvms_ocp.scenario.cases import case1
from uvms_ocp.solvers.nlp.options import NlpOptions

DAY = 86_400.0  # [s]


def test_no_search_has_a_time_limit_by_default() -> None:
    (of_request,) = (item.default for item in fields(OcpRequest) if item.name == "time_limit")
    assert (planner.OPTIONS.time_limit, NlpOptions().time_limit, of_request) == (DAY, DAY, DAY)


@pytest.mark.slow
def test_no_solve_of_a_mission_plan_has_a_time_limit_that_was_not_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nor has that which keeps links apart, which come near each other there."""
    limits = list[float]()

    class Watched(Planner):
        def __init__(self, problem: Any, options: NlpOptions, **more: Any) -> None:
            limits.append(options.time_limit)
            super().__init__(problem, options, **more)

    monkeypatch.setattr(planner, "Planner", Watched)
    assert plan_mission(case1(), duration=45.0).solved
    assert len(limits) > 1
    assert set(limits) == {DAY}
