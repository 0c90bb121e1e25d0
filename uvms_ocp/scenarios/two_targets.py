"""Two tool poses in one mission, with a move of the vehicle between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import Finite, Point, checked
from uvms_ocp.mission.conditions import Transition
from uvms_ocp.mission.phase import Phase
from uvms_ocp.scenario import Scenario, pose_at
from uvms_ocp.scenarios.case1 import case1

_APPROACH = np.array([-1.4025, 0.0752, 1.886])  # [m] from a target to its way point


@checked
def two_targets(*, second: Point = (13.6, 36.2, -39.886), second_yaw: Finite = -0.7, **options: Any) -> Scenario:
    """Case 1 twice: tool pose 1, then the vehicle takes off, moves 1.8 m, lands again and reaches tool pose 2.

    second (3,) [m]: the second target in W, second_yaw [rad]: the heading of the vehicle at its way point. Phases are
    A1 to D1 and A2 to D2, over one hierarchy; goals belong to the phases. Both tool errors end below the thresholds of
    `case1`, whose options apply.
    """
    defaults: dict[str, Any] = {"duration": 240.0}
    scenario = case1(**{**defaults, **options})
    target = np.asarray(second, dtype=float)
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, second_yaw)
    goals = {
        "PC": pose_at(tuple(target + turn @ _APPROACH), (0.0, -0.06, second_yaw)),
        "AT": target,
        "T": pose_at(tuple(target), (np.pi, 0.0, second_yaw)),
    }
    once = scenario.mission.phases
    phases = (*_renamed(once, "1", after="A2"), *_renamed(_with_goals(once, goals), "2", after=None))
    markers = {**scenario.markers, "second target": tuple(target.tolist())}
    return replace(scenario, name="two_targets", mission=replace(scenario.mission, phases=phases), markers=markers)


def _with_goals(phases: Sequence[Phase], goals: dict[str, Any]) -> tuple[Phase, ...]:
    return tuple(replace(phase, goals=goals) for phase in phases)


def _renamed(phases: Sequence[Phase], suffix: str, after: str | None) -> tuple[Phase, ...]:
    """Phases whose names end in `suffix`; the last leads on to `after`, if given, and not to the end of the mission."""
    names = {phase.name: phase.name + suffix for phase in phases}
    return tuple(
        replace(
            phase,
            name=names[phase.name],
            transitions=tuple(_retargeted(transition, names, after) for transition in phase.transitions),
        )
        for phase in phases
    )


def _retargeted(transition: Transition, names: dict[str, str], after: str | None) -> Transition:
    if transition.to in names:
        return replace(transition, to=names[transition.to])
    return transition if after is None else replace(transition, to=after)
