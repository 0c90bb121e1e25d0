"""Output error finds what made a recording, by slopes that are differences."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from driven import drive, known, turned, vehicle_of

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification import rollout as rollouts
from uvms_ocp.identification.estimates import Estimate, FitStatus, Noise, SearchPoint
from uvms_ocp.identification.model import Vehicle, stage_of
from uvms_ocp.identification.normal_equations import NormalEquations
from uvms_ocp.identification.output_error import OutputErrorProblem
from uvms_ocp.identification.parameters import Free, Prior
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.rollout import (
    N_START,
    Rollout,
    SegmentStart,
)
from uvms_ocp.identification.segments import PreparedRecording, Segment

LEARNT = {
    "added_mass": Free(only=("surge", "sway", "heave", "yaw")),
    "linear_drag": Free(only=("surge", "yaw")),
    "quadratic_drag": Free(only=("surge", "heave")),
    "centre_of_buoyancy": Free(only=("x", "z")),
    "lag": Prior(sigma=1.0),
    "delay": Free(),
    "velocity_delay": Free(),
    "velocity_point": Free(only=("x",)),
    "wrench_offset": Prior(sigma=5.0, only=("heave",)),
}
EXACT = Noise(outliers=100.0)


@cache
def problem() -> tuple[Vehicle, Rollout]:
    auv = vehicle_of(known().with_status(**LEARNT))
    return auv, Rollout(stage_of(auv))


@cache
def truth() -> np.ndarray:
    auv, _ = problem()
    rng = np.random.default_rng(11)
    shared = auv.shared.start + 0.3 * rng.normal(size=len(auv.shared.start))
    shared[auv.shared.names.index("delay")] = np.arctanh(
        2 * 0.25 - 1
    )  # of 1 s; whole steps of the simulation
    return np.concatenate([shared, [1.5]])


@cache
def recording(seed: int = 0, noise: float = 0.0) -> Recording:
    return drive(problem()[1].stage, truth(), seed=seed, noise=noise)


def stretches(
    given: Recording, duration: float | None = 10.0, step: float = 0.05
) -> tuple[Segment, ...]:
    return PreparedRecording.of(given, problem()[0]).segments(step, duration)


def fit(*given: Recording, noise: Noise = EXACT, **options: float) -> Estimate:
    auv, rollout = problem()
    parts = [stretch for each in given for stretch in stretches(each)]
    error = OutputErrorProblem(auv, parts, noise, rollout)
    return error.solve(error.start(), **options)


@pytest.mark.slow
def test_slopes_of_what_is_seen_are_differences() -> None:
    _, rollout = problem()
    part = stretches(recording(), 3.0)[1]
    step = 1e-6
    rng = np.random.default_rng(0)
    n_p = rollout.stage.n_p
    # so that no command and no sample is at an edge of a step
    begin = SegmentStart(q=part.q, v=part.v)
    p = truth() + 0.003
    drawn = [rng.uniform(0.5, 2.0, size=values.shape) for values in part.measured]
    pulls = [rng.normal(size=values.shape) for values in part.measured]
    (seen,) = rollout.predict(
        [part], [begin], p[None], lambda k, rows: list(zip(drawn, pulls, strict=True))
    )
    slopes = np.zeros((sum(values.size for values in part.measured), n_p + N_START))
    for k in range(n_p + N_START):
        ends = []
        for sign in (1, -1):
            change = sign * step * np.eye(n_p + N_START)[k]
            moved = begin.moved(change[n_p:])
            at = p + change[:n_p]
            ends.append(
                np.concatenate(
                    [rows.ravel() for rows in rollout.predict([part], [moved], at[None])[0].rows]
                )
            )
        slopes[:, k] = (ends[0] - ends[1]) / (2 * step)
    w, wr = (np.concatenate([values.ravel() for values in each]) for each in (drawn, pulls))
    size = np.linalg.norm(slopes, axis=0) + 1.0
    np.testing.assert_allclose(seen.g / size, slopes.T @ wr / size, atol=1e-5)
    np.testing.assert_allclose(
        seen.H / np.outer(size, size), (slopes.T * w) @ slopes / np.outer(size, size), atol=1e-5
    )


@pytest.mark.sampled
@pytest.mark.parametrize("processors", [1, 2, 3])
def test_stretches_are_simulated_beside_each_other_as_alone(
    processors: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rollouts, "n_processors", lambda: processors)
    parts = stretches(recording(), 1.0)[:5]
    rollout = Rollout(problem()[1].stage)
    begins = [SegmentStart(q=one.q, v=one.v) for one in parts]
    p = np.tile(truth(), (len(parts), 1))
    weigh = lambda _, rows: [(np.ones_like(values), values) for values in rows]  # noqa: E731
    together = rollout.predict(parts, begins, p, weigh)
    for one, begin, seen in zip(parts, begins, together, strict=True):
        (alone,) = rollout.predict([one], [begin], p[:1], weigh)
        np.testing.assert_array_equal(seen.end, alone.end)
        np.testing.assert_array_equal(seen.end_slope, alone.end_slope)
        np.testing.assert_array_equal(seen.H, alone.H)


def test_starts_are_eliminated_as_from_a_dense_matrix() -> None:
    rng = np.random.default_rng(3)
    n = 4
    m = 2
    count = 5
    damping = 0.1
    J = rng.normal(size=(200, n + m + N_START * count))
    for i in range(count):  # a row is of one start and the next
        others = np.ones(N_START * count, dtype=bool)
        others[N_START * i : N_START * (i + 2)] = False
        J[i::count, n + m :][:, others] = 0.0
    H = J.T @ J + np.eye(J.shape[1])
    g = J.T @ rng.normal(size=200)
    local = H[n + m :, n + m :]
    band = np.array([np.pad(np.diagonal(local, -d), (0, d)) for d in range(2 * N_START)])
    block = NormalEquations(
        0.0, H[: n + m, : n + m], g[: n + m], band, g[n + m :], H[n + m :, : n + m]
    )
    inverse = np.linalg.inv(H[n:, n:] + damping * np.diag(np.diag(H)[n:]))
    found_H, found_g, others_of = block.without_starts(damping, n)
    np.testing.assert_allclose(
        found_H, H[:n, :n] - H[:n, n:] @ inverse @ H[n:, :n], rtol=1e-9, atol=1e-9
    )
    np.testing.assert_allclose(found_g, g[:n] - H[:n, n:] @ inverse @ g[n:], rtol=1e-9, atol=1e-9)
    change = rng.normal(size=n)
    np.testing.assert_allclose(
        others_of(change), -inverse @ (g[n:] + H[n:, :n] @ change), rtol=1e-9, atol=1e-9
    )


def test_what_made_a_recording_is_found_again() -> None:
    fitted = fit(recording(0), recording(1))
    assert fitted.status is FitStatus.CONVERGED
    # 0.04 of the coordinate of a delay of 10 ms is 0.7 ms.
    np.testing.assert_allclose(fitted.shared, truth()[:-1], atol=0.04)
    np.testing.assert_allclose(
        [float(x[0]) for x in fitted.per_recording.values()], truth()[-1], atol=0.2
    )


def test_a_step_that_damping_holds_back_is_not_called_converged() -> None:
    auv, rollout = problem()
    error = OutputErrorProblem(auv, stretches(recording(noise=0.02)), Noise(), rollout)
    held_back = error.solve(error.start(), iterations=1, damping=1e9)
    assert held_back.status is FitStatus.ITERATION_LIMIT
    np.testing.assert_allclose(held_back.shared, auv.shared.start, atol=1e-3)


@pytest.mark.slow
def test_noise_moves_the_unknowns_by_about_their_standard_errors() -> None:
    noise = Noise(velocity=0.02, rate=0.02, vertical=0.02, outliers=100.0)
    fitted = fit(recording(2, 0.02), recording(3, 0.02), noise=noise)
    sigma = np.sqrt(np.diag(np.linalg.inv(fitted.information)))
    z = (fitted.shared - truth()[:-1]) / sigma
    assert np.abs(z).max() < 5.0
    assert np.sqrt((z**2).mean()) < 2.0


def test_the_fit_does_not_depend_on_the_world_frame() -> None:
    fitted = fit(recording(0), iterations=6)
    fitted_turned = fit(turned(recording(0), 2.0), iterations=6)
    np.testing.assert_allclose(fitted_turned.shared, fitted.shared, atol=1e-6)


def test_outliers_move_a_robust_fit_less() -> None:
    good = recording(0)
    velocity = good.channels["linear_velocity"]
    values = velocity.values.copy()
    values[::9] += [0.5, 0.0, 0.0]
    bad = replace(
        good, channels={**good.channels, "linear_velocity": Channel(t=velocity.t, values=values)}
    )
    wrong = {
        name: np.abs(fit(bad, noise=noise).shared - truth()[:-1]).max()
        for name, noise in {"robust": Noise(outliers=1.0), "squares": EXACT}.items()
    }
    assert wrong["robust"] < 0.5 * wrong["squares"]


def test_a_frozen_vehicle_keeps_its_unknowns_and_finds_the_start() -> None:
    auv, rollout = problem()
    part = stretches(recording(1), None)[0].first(2.0)
    error = OutputErrorProblem(auv, [part], EXACT, rollout)
    begin = error.start(truth()[:-1])
    fitted = error.solve(begin, frozen=20)
    np.testing.assert_array_equal(fitted.shared, truth()[:-1])
    assert fitted.cost < 0.05 * error.solve(begin, iterations=0).cost + 1e-3


def test_stretches_cover_a_recording_without_overlap() -> None:
    parts = stretches(recording(), 7.0)
    for one, after in pairwise(parts):
        assert one.edges[-1] == pytest.approx(after.edges[0])
        assert len(one.edges) == len(after.edges)
    assert parts[0].edges[0] == PreparedRecording.of(recording(), problem()[0]).span[0]
    assert parts[-1].edges[-1] > recording().span[1] - 1.0


def test_what_is_missing_is_told() -> None:
    channels = dict(recording().channels)
    del channels["wrench"]
    with pytest.raises(
        InvalidInput, match=r"commands \[\] recorded; allowed: one of thrust, wrench"
    ):
        PreparedRecording.of(Recording(name="r", channels=channels), problem()[0])
    with pytest.raises(InvalidInput, match="no attitude is recorded"):
        PreparedRecording.of(
            Recording(name="r", channels={"wrench": recording().channels["wrench"]}), problem()[0]
        )
    thrust = Channel(t=np.array([0.0, 1.0]), values=np.zeros((2, 8)))
    with pytest.raises(
        InvalidInput, match="thrust has 8 columns; the actuators' allocation takes 6"
    ):
        PreparedRecording.of(
            Recording(name="r", channels={**channels, "thrust": thrust}), problem()[0]
        )


def test_of_several_commands_those_are_taken_that_the_actuators_name() -> None:
    channels = recording().channels
    auv = problem()[0]
    both = {
        **channels,
        "thrust": replace(channels["wrench"], values=2.0 * channels["wrench"].values),
    }
    for name in ("thrust", "wrench"):
        named = replace(auv, actuators=replace(auv.actuators, commands=name))
        prepared = PreparedRecording.of(Recording(name="r", channels=both), named).commands.channel
        np.testing.assert_array_equal(prepared.values, both[name].values)
    named = replace(auv, actuators=replace(auv.actuators, commands="thrust"))
    with pytest.raises(InvalidInput, match="no thrust is recorded"):
        PreparedRecording.of(recording(), named)


def test_a_search_that_begins_where_the_simulation_runs_away_ends_with_a_status() -> None:
    auv, rollout = problem()
    error = OutputErrorProblem(auv, stretches(recording()), EXACT, rollout)
    stiff = np.where(
        [name.startswith("linear_drag") for name in auv.shared.names], 40.0, auv.shared.start
    )
    fitted = error.solve(error.start(stiff))
    assert fitted.status is FitStatus.RUNS_AWAY
    np.testing.assert_array_equal(fitted.information, np.diag(1.0 / auv.shared.sigma**2))


def test_a_step_to_where_slopes_are_not_finite_is_shortened(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    auv, rollout = problem()
    error = OutputErrorProblem(auv, stretches(recording()), EXACT, rollout)
    seen = OutputErrorProblem.blocks
    calls = []

    def steep(self: OutputErrorProblem, point: SearchPoint) -> list[NormalEquations]:
        calls.append(point)
        found = seen(self, point)
        return [replace(block, H=np.inf * block.H) for block in found] if len(calls) == 2 else found

    monkeypatch.setattr(OutputErrorProblem, "blocks", steep)
    assert error.solve(error.start(), damping=1e-6).status is FitStatus.CONVERGED
    first, second = (np.abs(each.shared - auv.shared.start).max() for each in calls[1:3])
    assert second <= first


def test_normal_equations_have_the_gradient_of_the_cost() -> None:
    auv, rollout = problem()
    error = OutputErrorProblem(auv, stretches(recording(4), 7.0), Noise(outliers=2.0), rollout)
    step = 1e-6
    point = error.start(truth()[:-1] + 0.003)  # no command and no sample at an edge of a step
    (block,) = error.blocks(point)
    n = len(point.shared)
    m = len(point.per_recording[0])
    size = N_START * len(point.starts[0])
    rng = np.random.default_rng(5)
    collected = []
    wanted = []
    for _ in range(4):
        way = rng.normal(size=n + m + size)
        ends = []
        for k in (step, -step):
            turns = (k * way[n + m :]).reshape(-1, N_START)
            starts = tuple(
                each.moved(turn) for each, turn in zip(point.starts[0], turns, strict=True)
            )
            moved = SearchPoint(
                shared=point.shared + k * way[:n],
                per_recording=(point.per_recording[0] + k * way[n : n + m],),
                starts=(starts,),
            )
            ends.append(error.blocks(moved)[0].cost)
        wanted.append((ends[0] - ends[1]) / (2 * step))
        collected.append(np.r_[block.g, block.g_starts] @ way)
    np.testing.assert_allclose(collected, wanted, rtol=1e-3, atol=1e-3 * np.abs(wanted).max())


def test_what_is_kept_of_a_recording_grows_with_its_length() -> None:
    auv, rollout = problem()
    parts = stretches(recording(), 2.0)
    errors = [OutputErrorProblem(auv, parts[:n], EXACT, rollout) for n in (3, 6, 12)]
    blocks = [error.blocks(error.start())[0] for error in errors]
    short, middle, long = (
        sum(getattr(block, name).size for name in ("H", "H_starts", "g_starts", "cross"))
        for block in blocks
    )
    assert long - middle == 2 * (middle - short)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_a_pose_alone_shows_what_velocities_show(noise: float) -> None:
    names = problem()[0].shared.names
    still = np.array([name == "velocity_point x" or "velocity_delay" in name for name in names])
    p = truth().copy()
    p[:-1][still] = problem()[0].shared.start[still]  # what a velocity alone has
    seen = [
        drive(problem()[1].stage, p, seed=seed, noise=noise, t_end=40.0, pose_alone=True)
        for seed in (0, 1)
    ]
    fitted = fit(*seen, noise=Noise(velocity=0.02, rate=0.05, vertical=0.02))
    assert fitted.status is FitStatus.CONVERGED
    off = {name: fitted.shared[k] - p[k] for k, name in enumerate(names) if not still[k]}
    assert (
        max(
            abs(off.pop(name))
            for name in [name for name in off if name.strip() in ("lag", "delay")]
        )
        < 0.4
    )  # one for the other
    assert max(map(abs, off.values())) < 0.08, off


def test_numbers_that_are_near_end_the_same_if_starts_come_near_before_they_move() -> None:
    vehicle, rollout = problem()
    error = OutputErrorProblem(vehicle, stretches(recording(noise=0.02)), EXACT, rollout)
    begin = error.start(
        truth()[:-1] + 0.05 * np.random.default_rng(1).normal(size=len(truth()) - 1)
    )
    at_once, later = (
        error.solve(begin, tolerance=1e-9),
        error.solve(begin, tolerance=1e-9, frozen=2),
    )
    assert later.status is FitStatus.CONVERGED
    assert later.iterations > 2
    sigma = np.sqrt(np.diag(np.linalg.inv(at_once.information)))
    assert (np.abs(later.shared - at_once.shared) < 1e-3 * sigma).all()
    stay = error.solve(begin, iterations=2, frozen=2)
    np.testing.assert_array_equal(stay.shared, begin.shared)
