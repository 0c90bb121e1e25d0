"""A search finds its way from far, and steps longer than a lag do not change what it finds."""

from __future__ import annotations

from dataclasses import replace

import linear_problem
import numpy as np
import pytest
from driven import drive, known, vehicle_of

from uvms_ocp.identification.estimates import FitStatus, Noise, SearchPoint
from uvms_ocp.identification.fit import Search, _drawn_minutes, resumed_search, search_fit
from uvms_ocp.identification.model import Vehicle, stage_of
from uvms_ocp.identification.normal_equations import NormalEquations
from uvms_ocp.identification.output_error import OutputErrorProblem
from uvms_ocp.identification.parameters import Free
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.segments import PreparedRecording

NOISE = Noise(velocity=0.005, rate=0.005, vertical=0.005, process=0.02, start=0.05)


def vehicle() -> Vehicle:
    return vehicle_of(
        known().with_status(
            added_mass=Free(), quadratic_drag=Free(only=("surge", "yaw")), lag=Free()
        )
    )


@pytest.mark.slow
def test_what_is_twice_as_large_is_found() -> None:
    auv = vehicle()
    rollout = Rollout(stage_of(auv))
    truth = auv.shared.start + np.where(
        [name.startswith("added_mass") for name in auv.shared.names], 0.35, 0.7
    )
    prepared = PreparedRecording.of(drive(rollout.stage, truth, seed=4, noise=0.005), auv)
    fitted = search_fit(auv, [prepared], NOISE, rollout, Search(step=0.025, segment_length=15.0))
    assert fitted.status is FitStatus.CONVERGED
    np.testing.assert_allclose(fitted.shared, truth, atol=0.08)


def test_a_lag_shorter_than_a_step_leaves_its_whole_impulse() -> None:
    auv = vehicle()
    stage = stage_of(auv)
    p = auv.shared.start.copy()
    p[auv.shared.names.index("lag")] = np.log(0.02)
    x = np.concatenate([[0, 0, 0, 0, 0, 0, 1.0], np.zeros(6), np.zeros(6)])
    u = np.array([10.0, 0, 0, 0, 0, 0])
    fine = x
    for _ in range(100):
        fine = np.asarray(stage.step(fine, u, np.zeros(0), p, 0.0005)).ravel()
    rough = np.asarray(stage.step(x, u, np.zeros(0), p, 0.05)).ravel()
    np.testing.assert_allclose(rough[7], fine[7], rtol=0.01)


@pytest.mark.slow
def test_a_search_goes_on_by_itself_where_its_iterations_are_too_few() -> None:
    auv = vehicle()
    rollout = Rollout(stage_of(auv))
    truth = auv.shared.start + 0.1
    error = OutputErrorProblem(
        auv,
        PreparedRecording.of(drive(rollout.stage, truth, seed=4), auv).segments(0.05, 15.0),
        NOISE,
        rollout,
    )
    short = error.solve(error.start(), iterations=1)
    fitted = resumed_search(error, short, 1)
    wanted = error.solve(error.start(), iterations=20)
    assert (short.status, wanted.status) == (FitStatus.ITERATION_LIMIT, FitStatus.CONVERGED)
    assert fitted.status is FitStatus.CONVERGED
    assert 1 < fitted.iterations < 10
    np.testing.assert_allclose(fitted.shared, wanted.shared, atol=1e-3)


@pytest.mark.sampled
@pytest.mark.parametrize("every", [2, 3, 5])
def test_motions_that_alternate_are_all_among_some_minutes(every: int) -> None:
    auv = vehicle()
    tow = PreparedRecording.of(
        drive(stage_of(auv), auv.shared.start, seed=1, t_end=5.0), auv
    ).segments(0.05, 10.0)[0]
    chosen = _drawn_minutes([replace(tow, recording=f"tow {k}") for k in range(30)], every)
    assert len(chosen) == -(-30 // every)
    kinds = [int(part.recording.split()[1]) % 2 for part in chosen]
    assert min(kinds.count(0), kinds.count(1)) >= len(chosen) // 4


@pytest.mark.slow
def test_long_recordings_are_searched_along_some_minutes_first_and_give_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    auv = vehicle()
    rollout = Rollout(stage_of(auv))
    truth = auv.shared.start + 0.1
    said = list[str]()
    drives = [drive(rollout.stage, truth, seed=seed, t_end=20.0, noise=0.005) for seed in range(3)]
    prepared = [PreparedRecording.of(each, auv) for each in drives]
    search = Search(step=0.05, segment_length=10.0, progress=said.append)
    wanted = search_fit(auv, prepared, NOISE, rollout, search)
    assert not any("of 4" in line for line in said)
    monkeypatch.setattr("uvms_ocp.identification.fit._ENOUGH", 20.0)
    fitted = search_fit(auv, prepared, NOISE, rollout, search)
    assert any("search 4 of 4" in line for line in said)
    errors = 1.0 / np.sqrt(np.diag(wanted.information))
    assert (np.abs(fitted.shared - wanted.shared) < 0.1 * errors).all()
    np.testing.assert_allclose(
        fitted.information,
        wanted.information,
        rtol=0.01,
        atol=0.01 * np.abs(wanted.information).max(),
    )
    assert fitted.per_recording.keys() == wanted.per_recording.keys()
    assert len(fitted.starts) == len(wanted.starts)


def test_equations_that_have_no_solution_end_as_a_status(monkeypatch: pytest.MonkeyPatch) -> None:
    found = linear_problem.problem()
    error = found.problem()
    blocks = OutputErrorProblem.blocks

    def indefinite(problem: OutputErrorProblem, point: SearchPoint) -> list[NormalEquations]:
        return [replace(one, H_starts=-one.H_starts) for one in blocks(problem, point)]

    monkeypatch.setattr(OutputErrorProblem, "blocks", indefinite)
    estimate = error.solve(error.start())
    assert estimate.status is FitStatus.STALLED
    assert np.isfinite(estimate.information).all()
