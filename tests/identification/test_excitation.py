"""Designed commands keep to thrust and pool, and tell more than what the search begins with."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from driven import known, vehicle_of
from typer.testing import CliRunner

from uvms_ocp.cli.commands import app
from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.identification.estimates import Noise
from uvms_ocp.identification.experiment_design import (
    DesignSettings,
    DesignStatus,
    Excitation,
    ExperimentTask,
    Objective,
    design_experiment,
    excitation_of,
    largest,
    target_deviations,
)
from uvms_ocp.identification.experiment_limits import ExperimentLimits
from uvms_ocp.identification.identified_numbers import DETERMINED_BELOW
from uvms_ocp.identification.knot_commands import (
    KnotCommands,
    edges_of,
    multisine,
)
from uvms_ocp.identification.model import stage_of
from uvms_ocp.identification.motions_by_hand import BY_HAND
from uvms_ocp.identification.output_error import OutputErrorProblem
from uvms_ocp.identification.parameters import Free, Prior
from uvms_ocp.identification.recording import Channel
from uvms_ocp.identification.resampling import ZeroOrderHold
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.segments import Segment
from uvms_ocp.identification.tables import stored_recording
from uvms_ocp.identification.trajectory_simulator import TrajectorySimulator

LIMITS = ExperimentLimits(
    thrust=np.outer([20.0, 20.0, 20.0, 2.0, 2.0, 2.0], [-1.0, 1.0]),
    pool=np.array([[-1.5, -1.0, -0.8], [1.5, 1.0, 0.8]]),
    slew=40.0,
    tilt=0.4,
)
NOISE = Noise(velocity=0.01, rate=0.01, vertical=0.005)
EFFORT = DesignSettings(step=0.1, knots=0.5, starts=1, iterations=12)


@cache
def rollout() -> Rollout:
    return Rollout(stage_of(assignment().vehicle))


def assignment(**other: object) -> ExperimentTask:
    learnt = {name: Free() for name in ("added_mass", "quadratic_drag", "lag", "delay")}
    auv = vehicle_of(known().with_status(**learnt, velocity_delay=Prior(sigma=0.3)))
    return replace(ExperimentTask(vehicle=auv, limits=LIMITS, duration=8.0, noise=NOISE), **other)


@cache
def found() -> Excitation:
    return design_experiment(assignment(), rollout(), EFFORT)


def objective(given: ExperimentTask) -> Objective:
    courses = TrajectorySimulator(rollout(), given.unknowns, 0.1, given.still)
    aim = given.aim()
    history = KnotCommands(4.0, 0.5, 0.1, courses.delay)
    return Objective(aim, given.limits, history, courses, target_deviations(given, rollout()))


@pytest.mark.slow
def test_the_slope_of_the_objective_is_that_of_its_value() -> None:
    rng = np.random.default_rng(1)
    narrow = replace(LIMITS, pool=LIMITS.pool / 50, tilt=0.02)
    narrow_objective = objective(assignment(limits=narrow))
    knots = LIMITS.thrust[:, 1] * multisine(rng, narrow_objective.history.n_knots, 6, 3.0)
    _, slope = narrow_objective.value(knots, 10.0)
    along = rng.normal(size=knots.shape)
    ahead, back = (narrow_objective.value(knots + e * along, 10.0)[0] for e in (1e-4, -1e-4))
    assert (slope * along).sum() == pytest.approx((ahead - back) / 2e-4, rel=1e-5)


@pytest.mark.parametrize(("waves", "fastest"), [(0.3, 1), (1.0, 1), (3.0, 3), (4.4, 4)])
def test_the_fastest_of_the_sines_turns_as_often_as_it_is_told(waves: float, fastest: int) -> None:
    sines = multisine(np.random.default_rng(0), 65, 6, waves)[
        :-1
    ]  # the last knot is the first one again
    heard = np.abs(np.fft.rfft(sines, axis=0)).max(axis=1) > 1e-9
    assert np.flatnonzero(heard).tolist() == list(range(1, fastest + 1))


@pytest.mark.slow
def test_the_information_is_what_output_error_finds_in_a_recording() -> None:
    task = assignment()
    commands = found().commands
    held = ZeroOrderHold(commands)
    t = 0.1 * np.arange(81)
    nothing = tuple(np.zeros((len(t), 3)) for _ in range(3))
    stretch = Segment(
        recording="a",
        edges=0.1 * np.arange(81),
        commands=held,
        joints=np.zeros((0, 80)),
        t=(t, t, t),
        measured=nothing,
        q=np.array([0.0, 0, 0, 0, 0, 0, 1]),
        v=np.zeros(6),
    )
    # Starts that are known, and losses without outliers, are what a design takes for granted.
    error = OutputErrorProblem(
        task.vehicle, [stretch], replace(NOISE, start=1e-9, outliers=1e12), rollout()
    )
    wanted = error.solve(error.start(), iterations=0).information - np.diag(
        1.0 / task.vehicle.shared.sigma**2
    )
    told = found().information
    late = task.vehicle.shared.names.index("velocity_delay")
    kept = np.delete(
        np.arange(len(told)), late
    )  # it interpolates between samples, which the design does not
    np.testing.assert_allclose(
        told[np.ix_(kept, kept)], wanted[np.ix_(kept, kept)], rtol=0.05, atol=0.02 * wanted.max()
    )


def test_commands_are_late_as_channels_are() -> None:
    history = KnotCommands(3.0, 0.2, 0.05, 0.13)
    t = 0.05 * np.arange(60)
    step = 0.05
    delay = 0.13
    knots = np.random.default_rng(0).normal(size=(history.n_knots, 2))
    held = ZeroOrderHold(Channel(t=t, values=history.sent @ knots))
    np.testing.assert_allclose(
        history.acting @ knots, held.mean(edges_of(60, step, delay)), atol=1e-12
    )
    np.testing.assert_allclose(
        history.late @ knots, -held.mean_slope(edges_of(60, step, delay)), atol=1e-10
    )
    np.testing.assert_allclose(history.nearest(history.sent @ knots), knots, atol=1e-12)


def by_hand(given: ExperimentTask) -> np.ndarray:
    made = [largest(given, rollout(), name).numbers for name in BY_HAND]
    return np.array([[number.sigma for number in numbers] for numbers in made]).min(axis=0)


@pytest.mark.slow
def test_of_what_is_not_believed_half_the_standard_error_by_hand_is_wanted() -> None:
    task = assignment()
    free = [k for k, each in enumerate(found().numbers) if each.quantity == "added_mass"]
    told = by_hand(task)[free]
    size = np.array([found().numbers[k].size for k in free])
    np.testing.assert_allclose(
        target_deviations(task, rollout())[free],
        np.minimum(told / 2, DETERMINED_BELOW * size),
        rtol=1e-6,
    )


def test_what_signals_by_hand_tell_less_of_than_is_believed_is_left_to_belief() -> None:
    learnt = {"added_mass": Prior(sigma=1e-5)}
    auv = vehicle_of(known().with_status(**learnt))
    task = ExperimentTask(vehicle=auv, limits=LIMITS, duration=8.0, noise=NOISE)
    aim = task.aim()
    np.testing.assert_allclose(
        target_deviations(task, Rollout(stage_of(auv))),
        aim.deviations(np.zeros_like(aim.prior_information)),
        rtol=1e-6,
    )


@pytest.mark.slow
def test_commands_keep_to_thrust_and_slew_from_rest() -> None:
    told = found().commands.values
    assert not told[0].any()
    assert (told >= LIMITS.thrust[:, 0]).all()
    assert (told <= LIMITS.thrust[:, 1]).all()
    assert np.abs(np.diff(told, axis=0)).max() <= LIMITS.slew * EFFORT.step * (1 + 1e-12)


@pytest.mark.slow
def test_the_vehicle_stays_in_the_pool_and_upright() -> None:
    excitation = found()
    assert excitation.status is DesignStatus.INSIDE
    assert (excitation.states[:, :3] >= LIMITS.pool[0]).all()
    assert (excitation.states[:, :3] <= LIMITS.pool[1]).all()
    qx, qy = excitation.states[:, 3:5].T
    assert np.arccos(1.0 - 2.0 * (qx**2 + qy**2)).max() <= LIMITS.tilt


def test_a_push_in_one_direction_leaves_the_pool_and_is_told_so() -> None:
    pushing = np.tile([20.0, 0, 0, 0, 0, 0], (80, 1))
    excitation = excitation_of(
        assignment(), rollout(), Channel(t=0.1 * np.arange(80), values=pushing)
    )
    assert excitation.states[:, 0].max() > LIMITS.pool[1, 0]
    assert excitation.status is DesignStatus.OUTSIDE


def test_a_design_tells_every_number_better_than_any_signal_by_hand() -> None:
    ratios = np.array([number.sigma for number in found().numbers]) / by_hand(assignment())
    assert ratios.max() < 0.7


@pytest.mark.slow
def test_what_matters_is_known_better_where_nothing_else_does() -> None:
    task = assignment(matter=("quadratic_drag surge",))
    name = [each.name for each in found().numbers].index("quadratic_drag surge")
    excitation = design_experiment(task, rollout(), EFFORT)
    assert excitation.numbers[name].sigma < found().numbers[name].sigma


def test_what_earlier_recordings_tell_counts() -> None:
    task = assignment(prior_information=found().information)
    twice = excitation_of(task, rollout(), found().commands)
    free = [k for k, each in enumerate(twice.numbers) if each.quantity == "added_mass"]
    for k in free:
        assert twice.numbers[k].sigma == pytest.approx(
            found().numbers[k].sigma / np.sqrt(2.0), rel=0.05
        )


def test_a_number_that_there_is_not_is_named() -> None:
    with pytest.raises(NameNotFound, match="quadratic_drag surge"):
        assignment(matter=("wings",)).aim()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"thrust": np.ones((6, 2))}, "without 0 inside"),
        ({"pool": np.zeros((2, 3))}, "without 0 inside"),
        ({"pool": np.outer([-np.inf, np.inf], np.ones(3))}, "finite"),
        ({"thrust": np.ones(6)}, r"\(n_u, 2\)"),
        ({"tilt": 2.0}, "tilt from 0"),
        ({"margin": 1.0}, "margin from 0"),
    ],
)
def test_limits_that_do_not_hold_a_vehicle_at_rest_are_refused(
    wrong: dict[str, object], said: str
) -> None:
    with pytest.raises(InvalidInput, match=said):
        replace(LIMITS, **wrong)


def test_limits_of_other_actuators_are_refused() -> None:
    with pytest.raises(InvalidInput, match="allowed: 6"):
        assignment(limits=replace(LIMITS, thrust=LIMITS.thrust[:4]))


@pytest.mark.parametrize("duration", [0.0, 0.1, 1e9, np.inf, np.nan])
def test_no_time_and_endless_time_are_refused(duration: float) -> None:
    with pytest.raises(InvalidInput, match="give a number from 1 to 1800"):
        assignment(duration=duration)


SETTINGS = """
robot: bluerov2_alpha5
arm: taken off
hull: [[-0.25, -0.2, -0.15], [0.25, 0.2, 0.15]]
learn: {added_mass: {}}
"""


@pytest.mark.slow
def test_a_command_writes_what_thrusters_are_told_and_what_it_will_tell(tmp_path: Path) -> None:
    (tmp_path / "my.yaml").write_text(SETTINGS)
    words = [
        "excite",
        str(tmp_path / "my.yaml"),
        "--duration",
        "3",
        "--share",
        "0.25",
        "--out",
        str(tmp_path / "out"),
    ]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    thrust = stored_recording(tmp_path / "out/excitation.csv").channel("thrust").values
    assert thrust.shape == (60, 8)
    assert 0.0 < np.abs(thrust).max() <= 10.0
    assert "| added_mass yaw | 0.222 |" in (tmp_path / "out/report.md").read_text()


def test_a_design_for_wrenches_asks_for_thrusters(tmp_path: Path) -> None:
    (tmp_path / "my.yaml").write_text(SETTINGS + "commands: wrench\n")
    result = CliRunner().invoke(
        app, ["excite", str(tmp_path / "my.yaml"), "--out", str(tmp_path / "out")]
    )
    assert isinstance(result.exception, InvalidInput)
    assert "commands: thrust" in str(result.exception)
