"""What is costly of a program by stages is the robot's: other terms leave its code as it is, which is compiled once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest

from uvms_ocp.codegen.compile import _compilation
from uvms_ocp.ocp.problem import HessianKind, Integrator, OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.stagewise.program import StagewiseProgram
from uvms_ocp.ocp.terms import AtRest, Effort, Smoothness, Term
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import State

ROBOT = {"forces", "forces_linear", "force_curvature", "step_curvature", "motion", "motion_linear", "moved"}


def _problem(*terms: Term) -> OcpProblem:
    robot = load_robot("planar5")
    start = State(q=robot.configuration(), v=np.zeros(robot.n_v))
    levels = [OcpLevel(name="effort", terms=terms)]
    return single_phase(robot=robot, start=start, duration=2.0, n_steps=4, levels=levels, constraints=(AtRest(),), water=False)


def _compiled(
    problem: OcpProblem, monkeypatch: pytest.MonkeyPatch, *, sparse: bool = False
) -> dict[str, tuple[str, str, np.ndarray]]:
    """Content, source and numbers of all functions that are compiled for a problem, by their names."""
    found: dict[str, tuple[str, str, np.ndarray]] = {}

    def take(name: str, content: str, make: Callable[[], ca.Function], module: str) -> ca.Function:
        assert name not in found, "compiled twice"
        function = make()
        assert function.name() == name
        work, numbers = _compilation(function)
        found[name] = content, work.args[0], numbers
        return function

    monkeypatch.setattr("uvms_ocp.ocp.stagewise.functions.compiled_from", take)
    monkeypatch.setattr("uvms_ocp.ocp.transcription.stage.compiled_from", take)
    monkeypatch.setattr("uvms_ocp.ocp.transcription.stage.compile_function", lambda function: function)
    whole = Transcription(problem, plugin="ipopt" if sparse else "stagewise")
    _ = whole.program if sparse else StagewiseProgram(whole)
    return found


def _sources(problem: OcpProblem, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    return {name: source for name, (_, source, _) in _compiled(problem, monkeypatch).items()}


@pytest.mark.parametrize("sparse", [False, True])
def test_the_same_content_makes_the_same_function(sparse: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = _problem(Effort())
    free = replace(plain, phases=(replace(plain.phases[0], duration=(1.0, 3.0)),))
    changed = [plain, replace(plain, integrator=Integrator.EULER), free, _problem(Smoothness()), _problem(Effort(), Smoothness())]
    two_levels = replace(plain, levels=(*plain.levels, OcpLevel(name="smooth", terms=(Smoothness(),))))
    changed += [replace(plain, hessian=HessianKind.GAUSS_NEWTON), replace(plain, limited=False), replace(plain, water=True)]
    runs = [_compiled(problem, monkeypatch, sparse=sparse) for problem in (*changed, two_levels, _problem(Effort()))]
    for one, other in pairwise(sorted((item for run in runs for item in run.items()), key=lambda item: (item[0], item[1][0]))):
        if (one[0], one[1][0]) == (other[0], other[1][0]):
            assert one[1][1] == other[1][1]
            np.testing.assert_array_equal(one[1][2], other[1][2])
    assert [entry[0] for entry in runs[0].values()] == [entry[0] for entry in runs[-1].values()]


def test_a_solver_that_goes_from_step_to_step_shares_what_is_longest_with_a_sparse_program_and_compiles_nothing_else_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one, other = (_compiled(_problem(Effort()), monkeypatch, sparse=sparse) for sparse in (False, True))
    assert one.keys() & other.keys() == {"force_curvature"}
    assert one["force_curvature"][:2] == other["force_curvature"][:2]
    np.testing.assert_array_equal(one["force_curvature"][2], other["force_curvature"][2])


def test_other_terms_and_other_lengths_compile_nothing_of_the_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    one = _sources(_problem(Effort()), monkeypatch)
    other = _sources(_problem(Effort(weight=2.0), Smoothness()), monkeypatch)
    assert set(one) >= ROBOT
    assert {name for name in one if one[name] != other[name]} <= {name for name in one if name.startswith(("path_", "end_"))}


def test_other_numbers_compile_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = (_sources(_problem(Effort(weight=weight)), monkeypatch) for weight in (2.5, 0.7))
    assert one == other


def test_functions_of_terms_have_no_dynamics_in_them(monkeypatch: pytest.MonkeyPatch) -> None:
    found = _sources(_problem(Effort()), monkeypatch)
    of_terms = sum(len(source) for name, source in found.items() if name.startswith(("path_", "end_")))
    assert of_terms < sum(len(found[name]) for name in ROBOT)
