"""Threads that share a planner, or two planners of one transcription, get their own plans."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.terms import AtRest, Effort, Posture
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers.nlp.options import NlpOptions

ROUNDS = 20


def problem(x: float) -> OcpProblem:
    """Of a planar robot, which ends near the posture of a place x [m]."""
    return single_phase(
        robot=load_robot("planar5"),
        start=State(q=np.zeros(5), v=np.zeros(5)),
        duration=4.0,
        n_steps=8,
        levels=[OcpLevel(name="posture", terms=(Posture(q=np.full(5, x)), Effort(weight=0.01)))],
        constraints=(AtRest(),),
        water=False,
    )


@pytest.fixture
def restless() -> Iterator[None]:
    """Threads take turns a thousand times as often as usual."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(interval)


@pytest.mark.slow
@pytest.mark.parametrize("plugin", ["ipopt", "stagewise"])
@pytest.mark.parametrize("sharing", ["planner", "transcription"])
def test_threads_get_their_own_plans(restless: None, plugin: str, sharing: str) -> None:
    options = NlpOptions(plugin=plugin)
    one = Planner(problem(0.1), options)
    other = (
        one
        if sharing == "planner"
        else Planner(problem(0.1), options, transcription=one.transcription)
    )
    asked = [replace(one.problem, levels=problem(x).levels) for x in (0.1, -0.3)]
    alone = [
        planner.plan(given).trajectory.q for planner, given in zip((one, other), asked, strict=True)
    ]

    def wrong(planner: Planner, given: OcpProblem, wanted: np.ndarray) -> int:
        found = [planner.plan(given).trajectory.q for _ in range(ROUNDS)]
        return sum(not np.allclose(q, wanted, atol=1e-9) for q in found)

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(wrong, (one, other), asked, alone)) == [0, 0]
