"""A fit has converged where no step is left to gain, and a number is determined where the data tell
it: judged by least squares and null spaces of a linear problem.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from linear_problem import NOISE, LinearRollout, _stretch, problem, vehicle

from uvms_ocp.identification.estimates import FitStatus
from uvms_ocp.identification.identified_numbers import numbers
from uvms_ocp.identification.output_error import OutputErrorProblem

AXES = ("surge", "sway", "heave")
BLIND = {
    "all seen": np.zeros((3, 0)),
    "heave unseen": np.array([[0.0], [0.0], [1.0]]),
    "surge and sway alike": np.array([[1.0], [-1.0], [0.0]]) / np.sqrt(2.0),
    "a sum alone": np.array([[1.0, 0.0], [-1.0, 1.0], [0.0, -1.0]]),
}
"""Directions of the unknowns that the data do not tell, by name."""


@pytest.mark.parametrize("damping", [1e-3, 1e3, 1e6, 1e7])
@pytest.mark.parametrize("bend", [0.0, 10.0])
def test_a_step_that_damping_holds_back_proves_no_convergence(damping: float, bend: float) -> None:
    error = problem(bend=bend).problem()
    best = error.solve(error.start(), tolerance=1e-12, iterations=100)
    fitted = error.solve(error.start(), damping=damping, iterations=100)
    # A step may be lost in rounding at the optimum itself, where the search has stalled.
    assert fitted.status in (FitStatus.CONVERGED, FitStatus.STALLED)
    assert fitted.cost < 1.005 * best.cost


def test_a_search_without_iterations_left_has_not_converged() -> None:
    error = problem(bend=10.0).problem()
    fitted = error.solve(error.start(), damping=1e6, iterations=2)
    assert fitted.status is FitStatus.ITERATION_LIMIT
    assert not any(number.determined for number in numbers(vehicle(), fitted))


def test_a_search_whose_steps_are_wrong_does_not_converge(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps of next to nothing, as a broken solver of normal equations would give them."""
    moved = OutputErrorProblem._moved

    def timid(
        error: OutputErrorProblem, point: object, blocks: object, damping: float, frozen: bool
    ) -> object:
        return moved(error, point, blocks, 1e7, frozen)  # type: ignore[arg-type]

    error = problem().problem()
    monkeypatch.setattr(OutputErrorProblem, "_moved", timid)
    assert error.solve(error.start()).status is not FitStatus.CONVERGED


@pytest.mark.parametrize("blind", BLIND)
@pytest.mark.parametrize("seed", range(3))
def test_what_the_data_cannot_tell_is_not_determined(blind: str, seed: int) -> None:
    unseen = BLIND[blind]
    rng = np.random.default_rng(seed)
    basis = np.linalg.qr(unseen)[0] if unseen.shape[1] else unseen
    projector = np.eye(3) - basis @ basis.T
    G = tuple(rng.normal(size=(60, 3, 3)) @ projector for _ in range(3))
    truth = np.array([0.3, 0.2, 0.4])
    seen = tuple(g @ truth + 0.1 * rng.normal(size=(60, 3)) for g in G)
    rollout = LinearRollout(G)
    error = OutputErrorProblem(vehicle(), [_stretch(seen)], NOISE, rollout)
    estimate = error.solve(error.start())
    assert estimate.status is FitStatus.CONVERGED
    by_entry = {
        number.entry: number for number in numbers(vehicle(), estimate) if number.quantity == "bias"
    }
    is_told = {axis: not basis[k].any() for k, axis in enumerate(AXES)}
    assert {axis: by_entry[axis].determined for axis in AXES} == is_told
    for one in by_entry.values():
        assert not replace(one, settled=False).determined
        assert not replace(one, explained=False).determined
