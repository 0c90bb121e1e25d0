"""Missions: activations are smooth, transitions fire for measured reasons, mistakes are named."""

from __future__ import annotations

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Above, Below, Event, MissionState, Phase, Transition
from uvms_ocp.record.meta_values import ABORT, DONE
from uvms_ocp.tasks.altitude import MinimumAltitude
from uvms_ocp.tasks.attitude import Alignment, HorizontalAttitude
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.joints import JointLimits
from uvms_ocp.tasks.task import TaskClass
from uvms_ocp.tasks.vehicle_velocity import NullVelocity

NEAR = Below(quantity="HA.tilt", limit=0.1)


def phase(name: str, to: str, activations: dict[str, float], hold: float = 0.0) -> Phase:
    return Phase(
        name=name,
        activations=activations,
        transitions=(Transition(to=to, when=(NEAR,), hold=hold),),
    )


def mission(hold: float = 0.0, ramp: float = 0.2) -> Mission:
    return Mission(
        hierarchy=Hierarchy([HorizontalAttitude(), NullVelocity()]),
        phases=(phase("A", "B", {"HA": 1.0}, hold), phase("B", DONE, {"NR": 1.0})),
        ramp=ramp,
    )


def test_classes_sort_the_hierarchy_and_ties_keep_their_order() -> None:
    tasks = [HorizontalAttitude(), MinimumAltitude(), NullVelocity(), JointLimits()]
    assert Hierarchy(tasks).names == ("NR", "HA", "MAC", "JL")
    assert [task.task_class for task in Hierarchy(tasks).tasks] == [TaskClass.CONSTRAINT] + 3 * [
        TaskClass.SAFETY
    ]


def test_an_explicit_order_overrides_the_classes() -> None:
    tasks = [HorizontalAttitude(), NullVelocity()]
    assert Hierarchy(tasks, order=("HA", "NR")).names == ("HA", "NR")


@pytest.mark.parametrize(
    ("order", "error", "message"),
    [
        (("HA",), InvalidInput, "must name each of .* once"),
        (("HA", "HA", "NR"), InvalidInput, "must name each"),
        (("HA", "XX"), NameNotFound, "unknown task 'XX'; known: HA, NR"),
    ],
)
def test_a_wrong_order_is_refused(
    order: tuple[str, ...], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        Hierarchy([HorizontalAttitude(), NullVelocity()], order=order)


def test_two_tasks_of_one_name_are_refused() -> None:
    with pytest.raises(InvalidInput, match="share the name HA"):
        Hierarchy([HorizontalAttitude(), HorizontalAttitude()])


def test_gates_rise_from_zero_at_the_start_and_cross_over_at_a_transition() -> None:
    m = mission()
    state = m.start()
    np.testing.assert_array_equal(m.activations(state, 0.0), [0, 0])
    np.testing.assert_allclose(m.activations(state, 0.1), [0, 0.5])
    np.testing.assert_array_equal(m.activations(state, 0.2), [0, 1])
    state, event = m.step(state, 3.0, {"HA.tilt": 0.05})
    assert event is not None
    np.testing.assert_array_equal(m.activations(state, 3.0), [0, 1])
    np.testing.assert_allclose(m.activations(state, 3.1), [0.5, 0.5])
    np.testing.assert_array_equal(m.activations(state, 3.2), [1, 0])


def test_gates_never_jump_even_when_a_phase_ends_during_its_ramp() -> None:
    m = mission()
    dt = 1e-3
    state = m.start()
    history = []
    for k in range(600):
        history.append(m.activations(state, k * dt))
        state, _ = m.step(state, k * dt, {"HA.tilt": 0.05 if k == 100 else 1.0})
    assert np.abs(np.diff(history, axis=0)).max() <= 1.01 * np.pi / 2 / m.ramp * dt


def test_a_transition_waits_for_its_hold_without_a_gap() -> None:
    m = mission(hold=0.2)
    state = m.start()
    for t, tilt in ((0.0, 0.05), (0.1, 0.05), (0.15, 0.2), (0.2, 0.05), (0.39, 0.05)):
        state, event = m.step(state, t, {"HA.tilt": tilt})
        assert event is None
    state, event = m.step(state, 0.4, {"HA.tilt": 0.05})
    assert event is not None
    assert event.reason == "HA.tilt = 0.05 < 0.1 for 0.2 s"
    assert m.phase_names[state.phase] == "B"


def test_a_mission_that_waits_says_for_what() -> None:
    m = mission()
    assert m.pending(m.start(), {"HA.tilt": 0.3}) == "HA.tilt = 0.3 not < 0.1"


def test_a_complete_mission_stays_complete() -> None:
    m = mission()
    state = m.start()
    for t in (0.0, 1.0, 2.0):
        state, _ = m.step(state, t, {"HA.tilt": 0.0})
    assert state.completed


def test_the_table_lists_tasks_by_phases() -> None:
    assert mission().table() == [
        {"task": "NR", "type": "[NR,E,C]", "A": 0.0, "B": 1.0},
        {"task": "HA", "type": "[R,I,S]", "A": 1.0, "B": 0.0},
    ]


def test_a_phase_goal_replaces_the_goal_of_its_task() -> None:
    m = Mission(
        hierarchy=Hierarchy([Alignment(goal=np.zeros(3)), HorizontalAttitude()]),
        phases=(
            phase("A", "B", {"AT": 1.0}),
            Phase(
                name="B",
                activations={},
                goals={"AT": np.ones(3)},
                transitions=(Transition(to=DONE, when=(NEAR,)),),
            ),
        ),
    )
    state = m.start()
    np.testing.assert_array_equal(np.concatenate(m.references(state, 0.0)), np.zeros(6))
    state, _ = m.step(state, 1.0, {"HA.tilt": 0.0})
    np.testing.assert_array_equal(np.concatenate(m.references(state, 1.0)), [1, 1, 1, 0, 0, 0])


def test_a_task_is_idle_once_it_is_off_for_good_in_its_phase() -> None:
    m = mission()
    state = m.start()
    np.testing.assert_array_equal(m.idle(state, m.activations(state, 0.0)), [True, False])
    state, _ = m.step(state, 3.0, {"HA.tilt": 0.05})
    np.testing.assert_array_equal(m.idle(state, m.activations(state, 3.1)), [False, False])
    np.testing.assert_array_equal(m.idle(state, m.activations(state, 3.3)), [False, True])


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: mission(ramp=-1.0), "ramp = -1.0"),
        (lambda: Below(quantity="x", limit=-0.1), "threshold of x = -0.1"),
        (lambda: Transition(to="B", when=()), "has no conditions"),
        (lambda: phase("A", "B", {"HA": 1.5}), "activations {'HA': 1.5}"),
        (lambda: mission(hold=float("nan")), "^Transition to '[A-Z]': hold = nan"),
        (lambda: phase("A", "B", {"HA": "on"}), "^Phase 'A': activations"),
    ],
)
def test_impossible_numbers_are_refused(build: object, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        build()  # type: ignore[operator]


@pytest.mark.parametrize(
    ("phases", "message"),
    [
        ((phase("A", "Z", {"HA": 1.0}),), "unknown phase 'Z'; known: A, done"),
        ((phase("A", DONE, {"PC": 1.0}),), "unknown task 'PC'; known: NR, HA"),
    ],
)
def test_unknown_names_in_a_mission_are_refused(phases: tuple[Phase, ...], message: str) -> None:
    with pytest.raises(NameNotFound, match=message):
        Mission(hierarchy=Hierarchy([HorizontalAttitude(), NullVelocity()]), phases=phases)


@pytest.mark.parametrize("name", ["A", DONE, ABORT])
def test_phases_of_one_name_or_called_like_an_end_are_refused(name: str) -> None:
    """Records tell phases by their names."""
    with pytest.raises(
        InvalidInput,
        match=f"phase '{name}'; give each a name of its own, and not 'done' or 'abort'",
    ):
        Mission(
            hierarchy=Hierarchy([HorizontalAttitude()]),
            phases=(phase("A", DONE, {"HA": 1.0}), phase(name, DONE, {"HA": 1.0})),
        )


def adrift(
    limit: float = 0.5, release: float | None = None, hold: float = 0.0, retries: int | None = None
) -> Mission:
    """Phase B leads back to A where the tilt exceeds `limit`."""
    back = Transition(
        to="A",
        when=(Above(quantity="HA.tilt", limit=limit, release=release),),
        hold=hold,
        retries=retries,
    )
    end = Transition(to=DONE, when=(Below(quantity="HA.tilt", limit=0.01),))
    return Mission(
        hierarchy=Hierarchy([HorizontalAttitude(), NullVelocity()]),
        phases=(
            phase("A", "B", {"HA": 1.0}),
            Phase(name="B", activations={"NR": 1.0}, transitions=(end, back)),
        ),
    )


def follow(m: Mission, tilts: list[float], dt: float = 0.1) -> tuple[MissionState, list[Event]]:
    state = m.start()
    events = []
    for k, tilt in enumerate(tilts):
        state, event = m.step(state, k * dt, {"HA.tilt": tilt})
        events += [event] if event else []
    return state, events


def test_a_back_step_returns_to_an_earlier_phase_and_the_mission_can_still_end() -> None:
    state, events = follow(adrift(), [0.05, 0.6, 0.05, 0.005])
    assert [(event.source, event.target) for event in events] == [
        ("A", "B"),
        ("B", "A"),
        ("A", "B"),
        ("B", DONE),
    ]
    assert events[1].reason == "HA.tilt = 0.6 > 0.5"
    assert [(c.quantity, c.sign, c.limit, value) for c, value in events[1].conditions] == [
        ("HA.tilt", ">", 0.5, 0.6)
    ]
    assert state.completed


def test_a_back_step_waits_for_its_dwell_time() -> None:
    assert len(follow(adrift(hold=0.3), [0.05, 0.6, 0.6, 0.3, 0.6, 0.6, 0.6])[1]) == 1
    assert len(follow(adrift(hold=0.3), [0.05, 0.6, 0.6, 0.6, 0.6])[1]) == 2


def test_hysteresis_keeps_a_condition_true_until_its_release() -> None:
    assert len(follow(adrift(hold=0.3), [0.05, 0.6, 0.45, 0.45, 0.45])[1]) == 1
    assert len(follow(adrift(hold=0.3, release=0.4), [0.05, 0.6, 0.45, 0.45, 0.45])[1]) == 2
    assert len(follow(adrift(hold=0.3, release=0.4), [0.05, 0.45, 0.45, 0.45, 0.45])[1]) == 1


def test_back_steps_beyond_the_retries_give_the_mission_up_with_a_reason() -> None:
    m = adrift(retries=2)
    state, events = follow(m, [0.05, 0.6] * 4)
    assert [event.target for event in events] == ["B", "A", "B", "A", "B", ABORT]
    assert state.over
    assert not state.completed
    assert state.aborted == "2 retries are used up: HA.tilt = 0.6 > 0.5"
    assert m.pending(state, {"HA.tilt": 0.6}).startswith("given up, 2 retries")
    assert m.step(state, 9.0, {"HA.tilt": 0.0}) == (state, None)


def test_phases_that_cannot_be_reached_or_left_are_found() -> None:
    m = Mission(
        hierarchy=Hierarchy([HorizontalAttitude()]),
        phases=(phase("A", DONE, {}), phase("X", "Y", {}), phase("Y", "X", {})),
    )
    assert m.unreachable_phases() == ("X", "Y")
    assert m.phases_without_exit() == ("X", "Y")
    assert adrift().unreachable_phases() == adrift().phases_without_exit() == ()


def test_a_mission_prints_as_a_table_and_as_a_diagram() -> None:
    assert str(mission()).splitlines() == [
        "task  type         A    B",
        "NR    [NR,E,C]     .    1",
        "HA    [R,I,S]      1    .",
    ]
    diagram = adrift(hold=0.3, retries=2).mermaid()
    assert diagram.startswith("stateDiagram-v2\n    [*] --> A\n")
    assert "    B --> A : HA.tilt > 0.5 for 0.3 s (at most 2 times)\n" in diagram
    assert "    B --> [*] : HA.tilt < 0.01\n" in diagram


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (
            lambda: Above(quantity="x", limit=0.5, release=0.6),
            "release of x = 0.6; give at most the limit 0.5",
        ),
        (
            lambda: Below(quantity="x", limit=0.5, release=0.4),
            "release of x = 0.4; give at least the limit 0.5",
        ),
        (lambda: Above(quantity="x", limit=float("nan")), "threshold of x = nan"),
        (lambda: adrift(retries=-1), "retries = -1; give a whole number >= 0"),
    ],
)
def test_impossible_back_steps_are_refused(build: object, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        build()  # type: ignore[operator]
