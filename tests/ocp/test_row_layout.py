"""Laws of the rows of a horizon: every one has one place, one name and one level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.planner import Planner, plan
from uvms_ocp.ocp.problem import OcpLevel, OcpPhase, OcpProblem
from uvms_ocp.ocp.terms import At, AtRest, Duration, Effort, Posture
from uvms_ocp.ocp.trajectory import hold_guess
from uvms_ocp.ocp.transcription.horizon import horizon
from uvms_ocp.ocp.transcription.layout import RowLayout, boundary, row_layout
from uvms_ocp.ocp.transcription.parameters import parameter_layout
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.ocp.transcription.term_rows import term_blocks
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.ocp.transcription.variables import VariableLayout
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers.nlp.options import NlpOptions


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("planar5")


@pytest.fixture(scope="module")
def problem(robot: Robot) -> OcpProblem:
    q = robot.configuration()
    return OcpProblem(
        robot=robot,
        start=State(q=q, v=np.zeros(robot.n_v)),
        phases=(
            OcpPhase(name="go", n_steps=3, duration=(1.0, 4.0)),
            OcpPhase(name="stay", n_steps=2, duration=1.0),
        ),
        levels=(
            OcpLevel(name="posture", terms=(Posture(q=q),)),
            OcpLevel(name="cheap", terms=(Effort(), Duration()), relax=0.1),
        ),
        constraints=(AtRest(), AtRest(at=At.PATH, phase="stay")),
        water=False,
    )


@pytest.fixture(scope="module")
def layout(problem: OcpProblem) -> RowLayout:
    model = StageModel(problem)
    return row_layout(problem, term_blocks(model), boundary(model), n_forces=model.n_forces)


def test_every_row_is_in_one_group_and_the_groups_follow_each_other(layout: RowLayout) -> None:
    groups = (
        layout.dynamics,
        layout.start,
        layout.equal_steps,
        layout.total,
        *layout.terms,
        layout.costs,
    )
    numbers = np.concatenate([group.ravel() for group in groups])
    np.testing.assert_array_equal(numbers, np.arange(layout.n_rows))


def test_the_horizon_has_a_value_for_every_row(problem: OcpProblem) -> None:
    model = StageModel(problem)
    blocks = term_blocks(model)
    rows = row_layout(problem, blocks, boundary(model), n_forces=model.n_forces)
    whole = horizon(
        VariableLayout(model=model), parameter_layout(problem, blocks), rows, boundary(model)
    )
    assert whole.rows.shape == (rows.n_rows, 1)


def test_a_level_that_may_be_relaxed_is_held_by_its_cost_and_another_by_its_rows(
    layout: RowLayout,
) -> None:
    np.testing.assert_array_equal(layout.held[0], layout.levels[0])
    np.testing.assert_array_equal(layout.held[1], layout.costs[1:])
    assert [layout.names[row] for row in layout.costs] == ["cost of posture", "cost of cheap"]
    assert {layout.names[row] for row in layout.levels[1]} == {"effort", "duration"}


def test_rows_of_the_given_state_are_neither_goals_nor_constraints(
    layout: RowLayout, robot: Robot
) -> None:
    """Nothing that is planned can change them."""
    used = np.concatenate([layout.constraints, *layout.levels])
    first_node = layout.terms[0][0]
    assert {layout.names[row] for row in np.intersect1d(used, first_node)} == {"effort", "duration"}


@pytest.mark.parametrize("free", [True, False])
def test_only_free_durations_have_rows_of_equal_steps(problem: OcpProblem, free: bool) -> None:
    phases = (
        problem.phases if free else tuple(replace(phase, duration=2.0) for phase in problem.phases)
    )
    given = replace(problem, phases=phases)
    model = StageModel(given)
    rows = row_layout(given, term_blocks(model), boundary(model), n_forces=model.n_forces)
    assert len(rows.equal_steps) == (4 if free else 0)


def test_a_time_of_all_phases_is_a_row_that_a_longer_motion_breaks(problem: OcpProblem) -> None:
    limited = Transcription(replace(problem, longest=3.5))
    still = hold_guess(problem)
    assert len(limited.row_layout.total) == 1
    assert len(Transcription(problem).row_layout.total) == 0
    broken = limited.violations(limited.pack(still), limited.parameters())
    assert broken["total duration"] == pytest.approx(still.t[-1] - 3.5)
    more = limited.violations(
        limited.pack(still), limited.parameters(), replace(problem, longest=still.t[-1])
    )
    assert more["total duration"] <= 1e-12


def test_a_plan_whose_time_is_limited_takes_that_time_where_it_would_take_more(
    problem: OcpProblem,
) -> None:
    level = OcpLevel(name="cheap", terms=(Effort(),))
    goal = OcpLevel(name="posture", terms=(Posture(q=problem.start.q + 0.3),))
    cheap = replace(problem, levels=(goal, level), constraints=(AtRest(),))
    free = plan(cheap)
    limited = plan(replace(cheap, longest=3.0))
    assert free.duration > 4.5
    assert limited.status is OcpStatus.SOLVED
    assert limited.duration == pytest.approx(3.0, abs=1e-3)


def test_a_solver_that_goes_from_step_to_step_refuses_a_limited_total(problem: OcpProblem) -> None:
    with pytest.raises(InvalidInput, match="`longest` ties all steps: use plugin='ipopt'"):
        Planner(replace(problem, longest=3.5), NlpOptions(plugin="stagewise"))


def test_a_violation_is_told_by_the_name_of_its_row(problem: OcpProblem, robot: Robot) -> None:
    transcription = Transcription(problem)
    still = hold_guess(problem)
    times = {"equal": [0, 1, 2, 3, 3.5, 4], "within a phase": [0, 1, 2.25, 3.25, 3.75, 4.25]}
    x = {
        name: transcription.pack(replace(still, t=np.array(t, dtype=float)))
        for name, t in times.items()
    }
    p = transcription.parameters()
    assert max(transcription.violations(x["equal"], p).values()) < 1e-12
    uneven = transcription.violations(x["within a phase"], p)
    assert {name for name, value in uneven.items() if value > 1e-12} == {"equal steps"}
    assert uneven["equal steps"] == pytest.approx(0.25)
    shifted = transcription.parameters(start=State(q=still.q[0] + 0.1, v=still.v[0]))
    away = transcription.violations(x["equal"], shifted)
    assert {name for name, value in away.items() if value > 1e-12} == {"start"}
    assert away["start"] == pytest.approx(0.1)
    v = still.v.copy()
    v[0] = 0.1
    v[4] = 0.2
    restless = transcription.violations(transcription.pack(replace(still, v=v)), p)
    assert restless["at rest"] == pytest.approx(0.2 / robot.limits.velocity.min())
    assert restless["motion"] >= 0.1
