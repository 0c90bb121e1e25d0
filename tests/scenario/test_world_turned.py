"""Where the origin of the world lies, and where north is, changes no mission: laws over
scenarios.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pinocchio as pin
import pytest

import uvms_ocp as uo
from uvms_ocp.scenario import pose_at

MOVED = pin.SE3(np.eye(3), np.array([800.0, -600.0, 0.0]))
"""X_NW of a new world N."""


def turned(angle: float) -> pin.SE3:
    return pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, angle), np.array([-600.0, 800.0, 0.0]))


# A way is eased along the axes of the world (`common_share`), so that a turn moves it by
# millimetres.
WORLDS: dict[
    str, tuple[pin.SE3, float, float]
] = {  # with how far [m, rad] the way may be another, on the way and at its end
    "moved by 1 km": (MOVED, 1e-8, 1e-8),
    "half turned": (turned(np.pi), 1e-8, 1e-8),
    "turned once around": (turned(2 * np.pi), 1e-8, 1e-8),
    "turned": (turned(2.5), 0.1, 0.02),
    "turned back": (turned(-1.9), 0.1, 0.02),
}
CURRENT = np.array([0.1, -0.06, 0.0])


def moved(X_NW: pin.SE3, q: np.ndarray) -> np.ndarray:
    """The configuration (n, n_q) of a vehicle with its world."""
    result = np.array(q)
    for row in np.atleast_2d(result):
        row[:7] = pin.SE3ToXYZQUAT(X_NW * pin.XYZQUATToSE3(row[:7]))
    return result


def reach(X_NW: pin.SE3) -> uo.Scenario:
    target = np.array([1.5, -1.2, -6.0])
    start = pose_at((0.0, 0.0, -5.0), (0.0, 0.0, 0.7))
    return uo.scenario.reach(
        start=X_NW * start,
        target=X_NW.act(target),
        current=X_NW.rotation @ CURRENT,
        duration=25.0,
        dt=0.01,
    )


def case1(X_NW: pin.SE3) -> uo.Scenario:
    start = pose_at((8.5, 38.5, -36.0), (0.0, -0.06, 0.5))
    way_point = pose_at((10.8, 37.45, -38.0), (0.0, -0.06, 0.5))
    target = np.array([12.2025, 37.3748, -39.886])
    return uo.scenario.case1(
        start=X_NW * start,
        way_point=X_NW * way_point,
        target=X_NW.act(target),
        tool_goal=X_NW * pose_at(tuple(target), (np.pi, 0.0, 0.0)),
        current=X_NW.rotation @ CURRENT,
        plant="kinematic",
        dt=0.01,
    )


SCENARIOS: Sequence[Callable[[pin.SE3], uo.Scenario]] = (reach, case1)


@pytest.mark.sampled
@pytest.mark.parametrize("made", SCENARIOS)
def test_pre_flight_finds_the_same_in_any_world(made: Callable[[pin.SE3], uo.Scenario]) -> None:
    expected_findings, *turned_findings = (
        [(finding.check, finding.phase, finding.text) for finding in made(X_NW).check().findings]
        for X_NW in _worlds()
    )
    assert expected_findings
    assert all(findings == expected_findings for findings in turned_findings)


def _worlds() -> list[pin.SE3]:
    return [pin.SE3.Identity(), *(X_NW for X_NW, _, _ in WORLDS.values())]


@pytest.mark.slow
@pytest.mark.parametrize("made", SCENARIOS)
def test_a_mission_is_flown_the_same_in_any_world(made: Callable[[pin.SE3], uo.Scenario]) -> None:
    run = made(pin.SE3.Identity()).run()
    assert run.run_meta.completed
    for world, (X_NW, on_the_way, at_the_end) in WORLDS.items():
        turned_run = made(X_NW).run()
        assert [event.target for event in turned_run.run_meta.events] == [
            event.target for event in run.run_meta.events
        ], world
        n = min(len(run), len(turned_run))
        assert max(len(run), len(turned_run)) < 1.01 * n, world
        error = np.abs(
            np.delete(turned_run["q"][:n] - moved(X_NW, run["q"][:n]), np.s_[3:7], axis=1)
        ).max(axis=1)
        assert error.max() < on_the_way, world
        assert error[-1] < at_the_end, world
