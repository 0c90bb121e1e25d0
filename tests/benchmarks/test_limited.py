"""A plan whose last steps are worth nothing is left within its limits."""

from __future__ import annotations

import pytest
from horizon.peer_problems import limited_problem

from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.trajectory import hold_guess
from uvms_ocp.solvers.nlp.options import NlpOptions


@pytest.mark.slow
@pytest.mark.parametrize("convergence", [1e-6, 1e-8])
def test_a_last_step_that_breaks_limits_is_not_taken(convergence: float) -> None:
    planner = Planner(
        limited_problem(40),
        NlpOptions(plugin="stagewise", convergence=convergence),
        wait_for_compiler=True,
    )
    plan = planner.plan(guess=hold_guess(planner.problem), diagnose=False)
    assert plan.levels[0].status in ("solved", "inexact")
    assert plan.result.violation <= planner.options.feasibility
