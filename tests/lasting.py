"""Missions that go by time, repeat themselves, and look at the vehicle itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.mission import Above, Below, Phase, Transition
from uvms_ocp.record.meta_values import DONE
from uvms_ocp.scenario.cases.bluerov import reach
from uvms_ocp.scenario.scenario import Scenario

NEAR = Below(quantity="PC.position_error", limit=0.15)
START = (0.0, 0.0, -5.0)


def going_to(name: str, place: Sequence[float], *transitions: Transition) -> Phase:
    """Return a phase that brings the vehicle to a place (3,) [m] in W."""
    gates = dict.fromkeys(("JL", "MAC", "HA", "PC"), 1.0)
    goal = pin.SE3(np.eye(3), np.array(place, dtype=float))
    return Phase(name=name, activations=gates, goals={"PC": goal}, transitions=transitions)


def lasting(*phases: Phase, **options: Any) -> Scenario:
    """Return a mission of these phases of a small vehicle that starts at `START`."""
    scenario = reach(**options)
    return replace(scenario, mission=replace(scenario.mission, phases=phases))


def patrol(*, rounds: int, energy: float = 0.0, **options: Any) -> Scenario:
    """Return so many rounds of a way out, and 2 s at home, or longer where an energy [J] is to be
    used there.
    """
    last = Transition(to=DONE, when=(NEAR, Above(quantity="phase.visits", limit=rounds - 0.5)))
    used = (Above(quantity="phase.energy", limit=energy),) if energy else ()
    home = Transition(to="out", when=(Above(quantity="phase.time", limit=2.0), *used))
    out = going_to("out", (0.5, 0.0, -5.0), last, Transition(to="home", when=(NEAR,)))
    return lasting(out, going_to("home", START, home), **options)
