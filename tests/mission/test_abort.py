"""Missions with an abort phase: how it is entered, what it knows, how it ends, and where it
shows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Abort, Below, Phase, Transition
from uvms_ocp.record.meta_values import ABORT, DONE
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.options import abort_phase, with_activations
from uvms_ocp.scenario.scenario import pose_at
from uvms_ocp.tasks.attitude import HorizontalAttitude
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.pose import VehiclePose

THERE = Below(quantity="PC.position_error", limit=0.1)
UP = pose_at((1.0, 2.0, 3.0))


def phase(name: str, to: str, **activations: float) -> Phase:
    return Phase(
        name=name, activations=activations, transitions=(Transition(to=to, when=(THERE,)),)
    )


def mission(abort: Abort | None = None) -> Mission:
    return Mission(
        hierarchy=Hierarchy([HorizontalAttitude(), VehiclePose(goal=pin.SE3.Identity())]),
        phases=(phase("A", "B", PC=1.0), phase("B", DONE, PC=1.0, HA=1.0)),
        abort=abort,
    )


def climbing() -> Abort:
    return abort_phase("HA")


def test_the_abort_phase_has_a_goal_of_its_own_and_ends_for_the_reason_it_began_with() -> None:
    m = mission(climbing())
    began, event = m.abandon(m.start(), 5.0, "why", UP)
    assert (event.source, event.target, event.reason, event.conditions) == ("A", "climb", "why", ())
    np.testing.assert_array_equal(m.references(began, 6.0)[1][:3], UP.translation)
    np.testing.assert_array_equal(m.references(m.start(), 0.0)[1][:3], np.zeros(3))
    np.testing.assert_array_equal(m.activations(began, 5.0), m.activations(m.start(), 5.0))
    np.testing.assert_array_equal(m.activations(began, 6.0), [1, 1])
    assert (
        m.pending(began, {"PC.position_error": 2.0})
        == "giving up, why; PC.position_error = 2 not < 0.3"
    )
    state = began
    for t in (6.0, 8.1):
        state, event = m.step(state, t, {"PC.position_error": 0.2})
    assert event is not None
    assert (event.source, event.target, state.aborted, state.completed) == (
        "climb",
        ABORT,
        "why",
        False,
    )


@pytest.mark.parametrize("abort", [None, climbing()])
def test_a_mission_that_cannot_climb_ends_at_once(abort: Abort | None) -> None:
    m = mission(abort)
    state, event = m.abandon(m.start(), 5.0, "why", None if abort else UP)
    assert (state.aborted, event.target) == ("why", ABORT)


def test_an_abort_phase_that_is_given_up_keeps_the_first_reason() -> None:
    m = mission(climbing())
    state, event = m.abandon(m.abandon(m.start(), 5.0, "first", UP)[0], 9.0, "second", UP)
    assert (state.aborted, event.reason) == ("first", "second")


def test_tables_diagrams_and_preflight_know_the_abort_phase() -> None:
    m = mission(climbing())
    assert m.phase_names == ("A", "B", "climb")
    assert m.table()[0] == {"task": "HA", "type": "[R,I,S]", "A": 0.0, "B": 1.0, "climb": 1.0}
    assert "climb: abort" in str(m)
    lines = m.mermaid().splitlines()
    assert "    A --> climb : abort" in lines
    assert "    B --> climb : abort" in lines
    assert "    climb --> [*] : PC.position_error < 0.3 for 2 s" in lines
    assert m.unreachable_phases() == m.phases_without_exit() == ()
    assert not case1(plant="kinematic").check().warnings


def test_gates_for_every_phase_reach_the_abort_phase_and_leave_those_that_are_set() -> None:
    m = with_activations(mission(climbing()), {"HA": 0.5})
    assert [phase.activations["HA"] for phase in m.all_phases] == [0.5, 1.0, 1.0]


@pytest.mark.parametrize(
    ("abort", "message"),
    [
        (
            lambda: replace(climbing(), ascent_task="HA"),
            "climbs by HA, a HorizontalAttitude; give a task on a pose",
        ),
        (
            lambda: replace(climbing(), ascent_task="XX"),
            "abort: ascent_task = 'XX', off in phase 'climb'; name a task that is on",
        ),
        (
            lambda: Abort(phase=phase("climb", "A", PC=1.0)),
            r"leads to \['A'\]; lead to 'abort' alone",
        ),
        (lambda: Abort(phase=phase("A", ABORT, PC=1.0)), "phase 'A'; give each a name of its own"),
    ],
)
def test_impossible_aborts_are_refused(abort: object, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        mission(abort())  # type: ignore[operator]


def test_no_transition_leads_to_the_abort_phase() -> None:
    m = mission(climbing())
    with pytest.raises(NameNotFound, match="unknown phase 'climb'; known: A, B, done"):
        replace(m, phases=(phase("A", "climb", PC=1.0), m.phases[1]))
