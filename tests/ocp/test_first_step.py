"""A start is called impossible only if no duration of the range allows its first step, and always
then.
"""

from __future__ import annotations

import numpy as np
import pytest

from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpLevel, OcpPhase, OcpProblem
from uvms_ocp.ocp.start_checks import impossible_start
from uvms_ocp.ocp.terms import Effort
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers.nlp.options import NlpOptions

N_STEPS = 10
JOINT = 4


@pytest.fixture(scope="module")
def planar() -> Robot:
    return load_robot("planar5")


def approaching(
    robot: Robot, room: float, speed: float, duration: float | tuple[float, float]
) -> OcpProblem:
    """The last joint `room` [rad] before its upper limit, moving at `speed` [rad/s]."""
    q = np.array(robot.configuration())
    v = np.zeros(robot.n_v)
    q[JOINT], v[JOINT] = robot.limits.position_upper[JOINT] - room, speed
    return OcpProblem(
        robot=robot,
        start=State(q=q, v=v),
        phases=(OcpPhase(n_steps=N_STEPS, duration=duration),),
        levels=(OcpLevel(name="effort", terms=(Effort(),)),),
        water=False,
    )


@pytest.mark.slow
def test_a_range_is_possible_exactly_if_one_of_its_durations_is(planar: Robot) -> None:
    rng = np.random.default_rng(2)
    verdicts = []
    for _ in range(200):
        room = rng.uniform(0.0, 0.1)
        speed = rng.uniform(0.0, 1.9)
        shortest, longest = np.sort(rng.uniform(0.05, 30.0, 2) ** rng.choice([0.3, 1.0]))
        durations = np.linspace(shortest, longest, 400)
        alone = [
            impossible_start(approaching(planar, room, speed, float(d))) is None for d in durations
        ]
        verdict = impossible_start(approaching(planar, room, speed, (shortest, longest)))
        # A sample can miss the one duration that works only where it just works.
        if any(alone) or impossible_start(
            approaching(planar, room + 1e-3, speed, (shortest, longest))
        ):
            assert (verdict is None) == any(alone), (room, speed, shortest, longest)
            verdicts.append(verdict is None)
    assert 20 < sum(verdicts) < len(verdicts) - 20


def test_a_start_that_only_short_steps_can_keep_is_planned(planar: Robot) -> None:
    assert impossible_start(approaching(planar, 0.02, 0.3, 1.5))
    plan = Planner(approaching(planar, 0.02, 0.3, (0.05, 1.5)), NlpOptions(time_limit=600.0)).plan()
    assert plan.status is OcpStatus.SOLVED


def test_the_reason_names_the_whole_range_of_steps(planar: Robot) -> None:
    reason = impossible_start(approaching(planar, 0.001, 0.9, (1.0, 1.5)))
    assert reason is not None
    assert "'theta2'" in reason
    assert "first step of 0.1 to 0.15 s" in reason
