"""What is costly of a program by stages is the robot's: other terms leave its code as it is, which
is compiled once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from compiler import needs_compiler

from uvms_ocp.codegen import (
    bound_calls,
    c_compiler,
    cache_entries,
    casadi_code,
    compile as building,
)
from uvms_ocp.codegen.compile import _compilation
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import HessianKind, Integrator, OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.stagewise import functions
from uvms_ocp.ocp.stagewise.program import StagewiseProgram
from uvms_ocp.ocp.terms import AtRest, Effort, Smoothness, TaskTerm, Term
from uvms_ocp.ocp.transcription import stage
from uvms_ocp.ocp.transcription.term_rows import term_blocks
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import State
from uvms_ocp.scenario import pose_at
from uvms_ocp.solvers.nlp.options import NlpOptions
from uvms_ocp.solvers.stage_qp.compiled import qp_library
from uvms_ocp.tasks.pose import ToolPosition

ROBOT = {
    "forces",
    "forces_linear",
    "force_curvature",
    "step_curvature",
    "motion",
    "motion_linear",
    "moved",
}


def _problem(*terms: Term) -> OcpProblem:
    robot = load_robot("planar5")
    start = State(q=robot.configuration(), v=np.zeros(robot.n_v))
    levels = [OcpLevel(name="effort", terms=terms)]
    return single_phase(
        robot=robot,
        start=start,
        duration=2.0,
        n_steps=4,
        levels=levels,
        constraints=(AtRest(),),
        water=False,
    )


def _compiled(
    problem: OcpProblem, monkeypatch: pytest.MonkeyPatch, *, sparse: bool = False
) -> dict[str, tuple[str, str, np.ndarray]]:
    """Content, source and numbers of all functions that are compiled for a problem, by their
    names.
    """
    found: dict[str, tuple[str, str, np.ndarray]] = {}

    def take(
        name: str, content: str, make: Callable[[], ca.Function], *modules: str
    ) -> ca.Function:
        assert name not in found, "compiled twice"
        function = make()
        assert function.name() == name
        work, numbers = _compilation(function)
        found[name] = content, work.args[0], numbers
        return function

    monkeypatch.setattr("uvms_ocp.ocp.stagewise.functions.compiled_from", take)
    for module in ("stage", "derivatives"):
        monkeypatch.setattr(f"uvms_ocp.ocp.transcription.{module}.compiled_from", take)
        monkeypatch.setattr(
            f"uvms_ocp.ocp.transcription.{module}.available_function", lambda function: function
        )
    whole = Transcription(problem, plugin="ipopt" if sparse else "stagewise")
    _ = whole.program if sparse else StagewiseProgram(whole)
    return found


def _sources(problem: OcpProblem, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    return {name: source for name, (_, source, _) in _compiled(problem, monkeypatch).items()}


@pytest.mark.slow
@pytest.mark.parametrize("sparse", [False, True])
def test_the_same_content_makes_the_same_function(
    sparse: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = _problem(Effort())
    free = replace(plain, phases=(replace(plain.phases[0], duration=(1.0, 3.0)),))
    changed = [
        plain,
        replace(plain, integrator=Integrator.EULER),
        free,
        _problem(Smoothness()),
        _problem(Effort(), Smoothness()),
    ]
    two_levels = replace(
        plain, levels=(*plain.levels, OcpLevel(name="smooth", terms=(Smoothness(),)))
    )
    changed += [
        replace(plain, hessian=HessianKind.GAUSS_NEWTON),
        replace(plain, limited=False),
        replace(plain, water=True),
    ]
    runs = [
        _compiled(problem, monkeypatch, sparse=sparse)
        for problem in (*changed, two_levels, _problem(Effort()))
    ]
    for one, other in pairwise(
        sorted(
            (item for run in runs for item in run.items()), key=lambda item: (item[0], item[1][0])
        )
    ):
        if (one[0], one[1][0]) == (other[0], other[1][0]):
            assert one[1][1] == other[1][1]
            np.testing.assert_array_equal(one[1][2], other[1][2])
    assert [entry[0] for entry in runs[0].values()] == [entry[0] for entry in runs[-1].values()]


def test_a_solver_that_goes_from_step_to_step_shares_what_is_longest_with_a_sparse_program_and_compiles_nothing_else_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one, other = (
        _compiled(_problem(Effort()), monkeypatch, sparse=sparse) for sparse in (False, True)
    )
    assert one.keys() & other.keys() == {"force_curvature"}
    assert one["force_curvature"][:2] == other["force_curvature"][:2]
    np.testing.assert_array_equal(one["force_curvature"][2], other["force_curvature"][2])


def test_other_terms_and_other_lengths_compile_nothing_of_the_robot(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one = _sources(_problem(Effort()), monkeypatch)
    other = _sources(_problem(Effort(weight=2.0), Smoothness()), monkeypatch)
    assert set(one) >= ROBOT
    assert {name for name in one if one[name] != other[name]} <= {
        name for name in one if name.startswith(("path_", "end_"))
    }


@pytest.mark.slow
@needs_compiler
def test_the_first_plan_compiles_nothing_within_its_time(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("UVMS_OCP_CACHE", str(tmp_path))
    for kept in (bound_calls.calls_library, qp_library):
        kept.cache_clear()
    planner = Planner(_problem(Smoothness()), NlpOptions(plugin="stagewise", time_limit=60.0))
    built = sorted(path.name for path in tmp_path.glob("*.so"))
    assert planner.plan(diagnose=False).status is OcpStatus.SOLVED
    assert sorted(path.name for path in tmp_path.glob("*.so")) == built


def test_other_numbers_compile_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = (_sources(_problem(Effort(weight=weight)), monkeypatch) for weight in (2.5, 0.7))
    assert one == other


def test_functions_of_terms_have_no_dynamics_in_them(monkeypatch: pytest.MonkeyPatch) -> None:
    found = _sources(_problem(Effort()), monkeypatch)
    of_terms = sum(
        len(source) for name, source in found.items() if name.startswith(("path_", "end_"))
    )
    assert of_terms < sum(len(found[name]) for name in ROBOT)


@pytest.mark.sampled
@pytest.mark.parametrize(
    "limited", [True, False], ids=["forces are variables", "forces are expressions"]
)
def test_a_diagnosis_of_a_plan_by_stages_waits_for_no_compiler(
    limited: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    tasks = (
        ToolPosition(goal=pose_at((x, 0.0, 0.0)), name=name)
        for x, name in ((1.0, "near"), (3.0, "far"))
    )
    problem = _problem(Effort())
    problem = replace(
        problem,
        constraints=(*problem.constraints, *(TaskTerm(task=task) for task in tasks)),
        limited=limited,
    )
    planner = Planner(problem, NlpOptions(plugin="stagewise", time_limit=60.0))
    begun: list[str] = []

    def make(
        name: str, content: str, make: Callable[[], ca.Function], *modules: str
    ) -> ca.Function:
        begun.append(name)
        return make()

    monkeypatch.setattr(stage, "compiled_from", make)
    plan = planner.plan()
    assert begun == []
    assert plan.status is OcpStatus.INFEASIBLE
    assert "for any motion near to keep them all" in plan.reason


MAKERS = (
    building.__file__,
    casadi_code.__file__,
    str(Path(building.__file__).with_name("parts.c")),
    stage.__file__,
)
"""Files that decide what machine code a function becomes."""


@pytest.mark.sampled
@pytest.mark.parametrize("module", MAKERS, ids=lambda file: Path(file).stem)
def test_another_text_of_the_code_that_makes_functions_makes_them_anew(
    module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code_of = cache_entries.code_of
    entries = dict[str, set[Path]]()

    def begin(function: ca.Function, entry: Path) -> ca.Function:
        entries.setdefault(function.name(), set()).add(entry)
        return function

    monkeypatch.setenv("UVMS_OCP_CACHE", str(tmp_path))
    monkeypatch.setattr(c_compiler, "find_compiler", lambda: "cc")
    monkeypatch.setattr(c_compiler, "_version", lambda compiler: "1")
    monkeypatch.setattr(building, "start_compiling", begin)
    for text in (code_of(module), "another text"):
        monkeypatch.setattr(
            cache_entries,
            "code_of",
            lambda path, text=text: text if path == module else code_of(path),
        )
        model = stage.StageModel(_problem(Effort()), eliminated=True)
        tangent = functions.Tangent(model=model)
        blocks = [
            functions.BlockFunctions(block=block, tangent=tangent, forces=None)
            for block in term_blocks(model)
        ]
        _ = (
            model.force_curvature,
            tangent.step_curvature,
            functions.motion_functions(tangent),
            [block.curvature for block in blocks],
        )
    assert entries.keys() >= ROBOT | {"path_0_curvature"}
    assert {name for name, found in entries.items() if len(found) != 2} == set()
