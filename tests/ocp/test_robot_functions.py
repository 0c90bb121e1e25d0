"""What is costly of a program by stages is the robot's: other terms leave its code as it is, which is compiled once."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from uvms_ocp.codegen.compile import _compilation
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
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


def _sources(problem: OcpProblem, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Of all functions that are compiled for a problem, by their names."""
    found: dict[str, str] = {}

    def take(function: ca.Function) -> ca.Function:
        assert function.name() not in found, "compiled twice"
        found[function.name()] = _compilation(function)[0].args[0]
        return function

    monkeypatch.setattr("uvms_ocp.ocp.stagewise.functions.start_compiling", take)
    StagewiseProgram(Transcription(problem, plugin="stagewise"))
    return found


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
