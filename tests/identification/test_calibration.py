"""A robot is calibrated from recordings: its file gets what was learnt, and says from where."""

from __future__ import annotations

import html
import json
import random
import signal
import sys
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest
import yaml
from driven import drive
from pressed import PYTHON_MAY_LOSE_IT, pressed_after
from typer.testing import CliRunner

from uvms_ocp import load_robot, without_arm
from uvms_ocp.cli.commands import app
from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.calibration import Calibration, calibrate
from uvms_ocp.identification.calibration_robot import calibrated_robot, with_delays
from uvms_ocp.identification.estimates import Noise
from uvms_ocp.identification.fit import FitContext, Search
from uvms_ocp.identification.held_constants import constant_slopes, held_constants
from uvms_ocp.identification.identified_numbers import MISSES, numbers
from uvms_ocp.identification.model import stage_of
from uvms_ocp.identification.parameters import DELAYS, Unknowns
from uvms_ocp.identification.prediction_errors import errors
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.resampling import rotations
from uvms_ocp.identification.results import report_data, report_text
from uvms_ocp.identification.robot_variant import variant_text, whole_text
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.segments import PreparedRecording
from uvms_ocp.identification.settings import CalibrationSettings, NoiseSettings, read_settings
from uvms_ocp.identification.tables import write_recording
from uvms_ocp.identification.vehicle_declaration import NominalParameters
from uvms_ocp.interrupts import Stopped
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.loading import robot_folder

SETTINGS = """
robot: bluerov2_alpha5
arm: taken off
hull: [[-0.25, -0.2, -0.15], [0.25, 0.2, 0.15]]
commands: wrench
lag: 0.15
delay: 0.2
velocity_delay: 0
dead_zone: 0.3
learn:
  added_mass: {free: [surge, sway]}
  quadratic_drag: {free: [surge]}
  volume: {prior: 0.02}
noise: {velocity: 0.02, rate: 0.02, vertical: 0.01}
step: 0.05
"""
HEAVIER = 0.1
ROUGHER = 0.25
NOISE = 0.01
"""logarithms of the root of added mass and of drag in surge; [m/s, rad/s] of sensors."""


@cache
def case() -> tuple[CalibrationSettings, Recording, Calibration]:
    settings = CalibrationSettings.model_validate(_yaml())
    subject = calibrated_robot(settings, Path())
    auv = subject.vehicle
    truth = auv.shared.start.copy()
    truth[auv.shared.names.index("added_mass surge")] += HEAVIER
    truth[auv.shared.names.index("quadratic_drag surge")] += ROUGHER
    recording = drive(stage_of(auv), truth, seed=2, noise=NOISE)
    return settings, recording, calibrate(subject, settings, [recording])


def _yaml() -> object:
    return yaml.safe_load(SETTINGS)


def test_numbers_of_the_robot_are_found() -> None:
    start = case()[2].subject.start
    told = {number.name: number for number in case()[2].numbers}
    wanted = (
        start.added_mass[0, 0] * np.exp(2 * HEAVIER),
        start.quadratic_drag[0, 0] * np.exp(ROUGHER),
    )
    for name, value in zip(("added_mass surge", "quadratic_drag surge"), wanted, strict=True):
        assert told[name].determined
        assert abs(told[name].value - value) < 3.0 * told[name].sigma


def test_the_file_makes_the_robot_that_was_found(tmp_path: Path) -> None:
    file = tmp_path / "calibrated.yaml"
    file.write_text(variant_text(case()[2], ["drive2"]))
    whole = tmp_path / "hydrodynamics.yaml"
    whole.write_text(whole_text(case()[2], file))
    robot = load_robot(urdf=robot_folder("bluerov2_alpha5") / "robot.urdf", hydrodynamics=whole)
    assert robot.n_joints
    robot = without_arm(robot)
    made = NominalParameters.of(robot_dynamics(robot).symbolic)
    told = {number.name: number.value for number in case()[2].numbers}
    assert made.added_mass[0, 0] == pytest.approx(told["added_mass surge"], rel=1e-5)
    assert made.added_mass[1, 1] == pytest.approx(told["added_mass sway"], rel=1e-5)
    assert made.quadratic_drag[0, 0] == pytest.approx(told["quadratic_drag surge"], rel=1e-5)
    assert made.volume == pytest.approx(told["volume"], rel=1e-5)
    np.testing.assert_allclose(
        made.centre_of_buoyancy, case()[2].subject.start.centre_of_buoyancy, atol=1e-6
    )


def test_every_number_of_the_file_has_its_source() -> None:
    lines = variant_text(case()[2], ["drive2"]).splitlines()
    assert "drive2" in lines[0]
    for number, line in enumerate(lines):
        if line.startswith("      ") and not line.strip().startswith("#"):
            assert lines[number - 1].strip().startswith("# ")


def test_the_report_has_every_number_and_every_recording() -> None:
    text = report_text(case()[2])
    assert all(f"| {number.name} |" in text for number in case()[2].numbers)
    assert "| drive2 |" in text


def test_a_calibration_shows_its_numbers_with_intervals_and_units() -> None:
    lines = repr(case()[2]).splitlines()
    assert len(lines) == 2 + len(case()[2].numbers)
    assert all(
        number.name in line for number, line in zip(case()[2].numbers, lines[2:], strict=True)
    )
    assert "<table>" in case()[2]._repr_html_()


def test_a_calibrated_robot_misses_by_the_noise_alone_and_more_before() -> None:
    (one,) = case()[2].comparisons
    errors = [
        np.linalg.norm((each.rows[0] - each.measured[0])[:, 0])
        for each in (one.calibrated, one.before)
    ]
    floor = NOISE * np.sqrt(len(one.before.t[0]))
    assert errors[0] < 1.1 * floor < 0.8 * errors[1]


@PYTHON_MAY_LOSE_IT
@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="timers by signals")
def test_whenever_it_is_pressed_a_calibration_stops_in_one_line() -> None:
    settings, recording, done = case()
    begin = perf_counter()
    calibrate(done.subject, settings, [recording])
    lasts = perf_counter() - begin
    draw = random.Random(44)
    collected: list[list[str]] = []
    for _ in range(20):
        with pressed_after(draw.uniform(0.01, 0.8 * lasts)) as pressed:
            try:
                calibrate(done.subject, settings, [recording])
                signal.setitimer(signal.ITIMER_REAL, 0.0)
                assert not pressed
            except Stopped as stop:
                collected.append(stop._render_traceback_())
    assert all(len(lines) == 1 for lines in collected)
    assert len(collected) > 5


@pytest.mark.slow
def test_the_command_writes_all_of_it(tmp_path: Path) -> None:
    settings = tmp_path / "my.yaml"
    recording = tmp_path / "drive.csv"
    settings.write_text(SETTINGS)
    write_recording(case()[1], recording)
    result = CliRunner().invoke(
        app, ["identify", str(settings), str(recording), "--out", str(tmp_path / "out")]
    )
    assert result.exit_code == 0, result.output
    assert (tmp_path / "out/calibrated.yaml").read_text() == variant_text(case()[2], ["drive"])
    for name in (
        "hydrodynamics.yaml",
        "report.md",
        "figures/intervals.png",
        "figures/predicted_0.png",
        "figures/residuals_0.png",
    ):
        assert (tmp_path / "out" / name).stat().st_size > 0


@pytest.mark.slow
def test_of_a_vehicle_at_rest_there_is_no_answer_and_no_file(tmp_path: Path) -> None:
    settings = tmp_path / "my.yaml"
    settings.write_text(SETTINGS)
    recording = case()[1]
    channels = {}
    for name, channel in recording.channels.items():
        values = np.tile(channel.values[0], (len(channel.t), 1))
        if name != "attitude":
            values = 1e-3 * np.random.default_rng(0).normal(size=values.shape)
        channels[name] = replace(channel, values=values)
    write_recording(replace(recording, channels=channels), tmp_path / "rest.csv")
    result = CliRunner().invoke(
        app,
        ["identify", str(settings), str(tmp_path / "rest.csv"), "--out", str(tmp_path / "out")],
    )
    assert result.exit_code == 3, result.output
    assert "no answer; 0 of " in result.output
    assert not list((tmp_path / "out").glob("*.yaml"))
    assert json.loads((tmp_path / "out/report.json").read_text())["status"] == "no answer"


def test_what_stays_open_is_told_as_it_was_before() -> None:
    found = replace(case()[2], exported=replace(case()[2].exported, kept=("added_mass sway",)))
    assert "sway not determined, as before" in variant_text(found, ["drive2"])
    row = next(
        line for line in report_text(found).splitlines() if line.startswith("| added_mass sway |")
    )
    assert row.endswith("| as before |")


@pytest.mark.slow
@pytest.mark.parametrize(
    "delay", [0.05, *(pytest.param(delay, marks=pytest.mark.slow) for delay in (0.02, 0.1))]
)
def test_a_fit_with_a_wrong_delay_says_what_it_does_not_explain_and_claims_no_wrong_number(
    delay: float,
) -> None:
    """It converged, with small standard errors, at numbers that were wrong, one of them called
    determined.
    """
    settings, recording, right = case()
    wrong = settings.model_copy(update={"delay": delay})
    calibration = calibrate(calibrated_robot(wrong, Path()), wrong, [recording])
    assert calibration.estimate.status is right.estimate.status
    missed = [each.channel for each in calibration.whiteness if each.unexplained]
    assert "surge" in missed
    assert f"does not explain {', '.join(missed)}**" in report_text(calibration)
    assert "does not explain" not in report_text(right)
    assert calibration.inflation > 4.0 * right.inflation
    sharp = wrong.model_copy(
        update={"noise": NoiseSettings(velocity=0.002, rate=0.002, vertical=0.001)}
    )
    missed_by_far = calibrate(calibrated_robot(sharp, Path()), sharp, [recording])
    assert max(each.size for each in missed_by_far.whiteness) > MISSES
    assert not any(number.determined for number in missed_by_far.numbers)
    truth = {number.name: number.value for number in right.numbers}
    assert sum(number.determined for number in right.numbers) > 4
    for number in calibration.numbers:
        assert (
            not number.determined or number.interval[0] <= truth[number.name] <= number.interval[1]
        )


def test_constants_are_given_of_the_file_or_assumed_and_what_is_assumed_widens_intervals() -> None:
    found = case()[2]
    known = {constant.quantity: constant.known for constant in found.constants}
    assumed = (
        "gain",
        "reverse",
        "velocity_point",
        "attitude_turn",
        "attitude_offset",
        "rate_bias",
        "velocity scale",
        "noise process",
    )
    seen = ("bias", "wrench_offset", "current")
    given = ("lag", "delay", "velocity_delay", "noise velocity", "noise rate", "noise vertical")
    filed = dict.fromkeys(("mass", "centre_of_mass", "second_moment"), "robot's file")
    assert known == {
        **dict.fromkeys((*assumed, *seen), "assumed"),
        **dict.fromkeys(given, "given"),
        **filed,
        "rate scale": "shown",  # by the attitude, where no position shows that of the velocity
    }
    change = {constant.quantity: constant.change for constant in found.constants}
    assert change["wrench_offset"] == change["bias"] > 1.0
    alone = numbers(found.subject.vehicle, replace(found.estimate, assumed=0.0), found.inflation)
    assert all(
        number.sigma > before.sigma for number, before in zip(found.numbers, alone, strict=True)
    )
    report = report_text(found)
    assert "| gain | 1 | - | assumed | 0.03 | " in report
    assert "| noise velocity | 0.02 | m/s | given | 1 | " in report
    assert "| hull | -0.25 to 0.25 | m | given | - | " in report
    assert "| wrench_offset | 0 | N, N m | assumed | 0.003 | " in report
    assert "| noise process | 0.05 | m/s, rad/s, rad | assumed | 1 | " in report
    silent = CalibrationSettings.model_validate(_yaml() | {"delay": None, "velocity_delay": None})  # type: ignore[operator]
    for at_once in (False, True):
        auv = with_delays(calibrated_robot(silent, Path()), silent, at_once=at_once).vehicle
        assert {"delay", "velocity_delay"} <= set(auv.shared.names) or at_once
        none = [auv.shared.declaration.quantities[name].value.item() < 1e-5 for name in DELAYS]
        assert none == [at_once] * 2


@pytest.mark.slow
def test_what_a_current_would_change_is_what_a_fit_with_it_finds() -> None:
    """To first order; each recording has one for itself."""
    settings, recording, found = case()
    auv = found.subject.vehicle
    noise = Noise(**settings.noise.model_dump())
    known = {
        "vehicle": auv,
        "prepared": (PreparedRecording.of(recording, auv),),
        "noise": noise,
        "rollout": Rollout(stage_of(auv)),
    }
    fitted = FitContext(
        **known,
        search=Search(step=settings.step, segment_length=settings.stretch),
        estimate=found.estimate,
    )  # type: ignore[arg-type]
    names, slopes = constant_slopes(fitted, ["current"])
    ends = []
    size = 0.002
    for way in (-size, size):
        moved = auv.shared.declaration.with_start(current=way * np.eye(3)[0])
        other = replace(
            auv, shared=Unknowns(moved), per_recording=Unknowns(moved, per_recording=True)
        )
        problem = replace(
            fitted, vehicle=other, rollout=Rollout(stage_of(other, sharp=True))
        ).problem()
        ends.append(problem.solve(problem.resumed(found.estimate), tolerance=1e-9).shared)
    expected = 2.0 * size * slopes[:, names.index("current x")]
    assert np.abs(ends[1] - ends[0] - expected).max() < 0.1 * np.abs(expected).max()


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("left_out", "known"),
    [
        ((), {"velocity scale": "shown", "rate scale": "shown"}),
        (("linear_velocity",), {"velocity scale": "assumed", "rate scale": "shown"}),
        (("angular_velocity",), {"velocity scale": "shown"}),
    ],
)
def test_what_was_taken_from_a_pose_is_not_shown_by_it(
    left_out: tuple[str, ...], known: dict[str, str]
) -> None:
    settings, recording, found = case()
    channels = {**recording.channels, "position": _position(recording)}
    for name in left_out:
        del channels[name]
    _, constants = held_constants(_with_channels(channels), settings, found.inflation)
    scales = {entry.quantity: entry.known for entry in constants if "scale" in entry.quantity}
    assert scales == known


def test_columns_that_were_not_measured_show_no_scale() -> None:
    settings, recording, found = case()
    rate = replace(recording.channels["angular_velocity"], constants=(0, 1))
    channels = {**recording.channels, "angular_velocity": rate}
    _, constants = held_constants(_with_channels(channels), settings, found.inflation)
    scales = {entry.quantity: entry.known for entry in constants if "scale" in entry.quantity}
    assert scales["rate scale"] == "assumed"


def _with_channels(channels: Mapping[str, Channel]) -> FitContext:
    """Return the fit of the case, of a recording with other channels."""
    settings, recording, found = case()
    auv = found.subject.vehicle
    return FitContext(
        vehicle=auv,
        rollout=Rollout(stage_of(auv, sharp=True)),
        prepared=(PreparedRecording.of(replace(recording, channels=channels), auv),),
        noise=Noise(**settings.noise.model_dump()),
        search=Search(step=settings.step, segment_length=settings.stretch),
        estimate=replace(found.estimate, assumed=0.0),
    )


def _position(recording: Recording, scale: float = 1.0) -> Channel:
    """Integrate the velocity of a recording, less its scale, to a position."""
    velocity = recording.channels["linear_velocity"]
    R = rotations(recording.channels["attitude"], velocity.t)
    in_world = np.einsum("nij,nj->ni", R, velocity.values)
    steps = np.diff(velocity.t)[:, None] * (in_world[1:] + in_world[:-1]) / 2
    way = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    return Channel(t=velocity.t, values=way / scale - [0.0, 0.0, 20.0])


def test_a_scale_that_the_position_contradicts_leaves_open_what_depends_on_it() -> None:
    settings, recording, found = case()
    sigmas = []
    for scale in (1.0, 1.15):
        channels = {**recording.channels, "position": _position(recording, scale)}
        fitted = _with_channels(channels)
        auv = fitted.vehicle
        estimate, constants = held_constants(fitted, settings, found.inflation)
        constant = next(entry for entry in constants if entry.quantity == "velocity scale")
        assert constant.known == "shown"
        assert constant.spread == pytest.approx(scale - 1.0, abs=0.01)
        found_numbers = numbers(auv, estimate, found.inflation)
        sigmas.append({entry.name: entry.sigma for entry in found_numbers})
    alone = numbers(auv, fitted.estimate, found.inflation)
    sigma = next(entry.sigma for entry in alone if entry.name == constant.most_changed)
    wider, narrower = sigmas[1][constant.most_changed], sigmas[0][constant.most_changed]
    assert constant.change > 1.0
    assert wider**2 - narrower**2 == pytest.approx((constant.change * sigma) ** 2, rel=0.05)
    assert all(sigmas[1][name] >= sigma for name, sigma in sigmas[0].items())


@pytest.mark.slow
def test_what_twice_the_noise_changes_is_what_a_fit_with_it_finds() -> None:
    settings, recording, found = case()
    noise = settings.noise.model_copy(update={"velocity": 2.0 * settings.noise.velocity})
    calibration = calibrate(
        calibrated_robot(settings, Path()),
        settings.model_copy(update={"noise": noise}),
        [recording],
    )
    said = next(constant for constant in found.constants if constant.quantity == "noise velocity")
    alone = numbers(found.subject.vehicle, replace(found.estimate, assumed=0.0), found.inflation)
    moved = {
        number.name: abs(two.value - number.value) / number.sigma
        for number, two in zip(alone, calibration.numbers, strict=True)
    }
    assert moved[said.most_changed] == pytest.approx(
        said.change, rel=0.25
    )  # of errors with what the step of the simulation adds
    assert max(moved.values()) < 1.3 * said.change


@pytest.mark.slow
def test_profiles_and_leave_one_out_come_when_they_are_asked_for(tmp_path: Path) -> None:
    settings = tmp_path / "my.yaml"
    parts = [tmp_path / f"part{k}.csv" for k in range(2)]
    settings.write_text(SETTINGS.replace("step: 0.05", "step: 0.1"))
    auv = case()[2].subject.vehicle
    for k, path in enumerate(parts):
        write_recording(
            drive(stage_of(auv), auv.shared.start, seed=k, noise=NOISE, t_end=16.0), path
        )
    other = tmp_path / "other.csv"
    write_recording(drive(stage_of(auv), auv.shared.start, seed=2, noise=NOISE, t_end=16.0), other)
    words = [
        "identify",
        str(settings),
        *map(str, parts),
        "--profiles",
        "--leave-one-out",
        "--predict",
        str(other),
        "--out",
        str(tmp_path),
    ]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    text = (tmp_path / "report.md").read_text()
    data = json.loads((tmp_path / "report.json").read_text())
    for name in ("left_out", "predicted"):
        assert data[name]["bounds"]["channels"]
        assert f"**Predictions are {data[name]['verdict']}.**" in text
        assert data[name]["verdict"] in result.output.replace("\n", " ")
    assert [recording["recording"] for recording in data["predicted"]["bounds"]["recordings"]] == [
        "other"
    ]
    assert text.count("### How good these predictions could be") == 2
    assert text.count("### Numbers that recordings disagree on") == 1
    for each in data["numbers_disagreed_on"]:
        assert each["sentence"] in text
    assert "## Profiles" in text
    assert "### 20 s (recordings have 13" in text
    assert text.count("| added_mass surge |") == 2
    assert text.count("| mass and added mass surge |") == 1
    for name in ("profiles.png", "left_out.png", "predicted_others.png"):
        assert (tmp_path / "figures" / name).stat().st_size > 0


def test_what_stands_still_is_told_of_recordings_that_were_seen_too() -> None:
    _, _, found = case()
    still = replace(found.comparisons[0], calibrated=found.comparisons[0].before)
    moved = still.calibrated.rows[0] + [0.0, 2.0, 0.0]
    lost = replace(
        found,
        comparisons=(
            replace(
                still,
                calibrated=replace(still.calibrated, rows=(moved, *still.calibrated.rows[1:])),
            ),
        ),
    )
    sentence = next(str(each) for each in lost.worse_than_still if each.channel == "sway")
    assert sentence.startswith('drive2: sway is predicted worse than by "nothing moves"')
    assert sentence in report_text(lost)
    assert sentence in html.unescape(lost._repr_html_())
    assert sentence in [each["sentence"] for each in report_data(lost)["seen_worse_than_still"]]
    assert report_data(found)["seen_worse_than_still"] == []
    json.dumps(report_data(found), allow_nan=False)


def test_one_recording_is_not_left_out() -> None:
    settings, recording, found = case()
    with pytest.raises(InvalidInput, match="at least 2"):
        calibrate(found.subject, settings, [recording], leave_one_out=True)


def test_every_figure_of_a_prediction_stands_beside_those_that_know_less() -> None:
    _, _, found = case()
    (one,), text = found.comparisons, report_text(found)
    row = next(line for line in text.splitlines() if line.startswith("| drive2 |"))
    told = [
        f"{errors(each)[-1]:.2g}" for each in (one.calibrated, one.before, one.static, one.balance)
    ]
    assert f"{told[0]} ({'; '.join(told[1:])})" in row
    for each in found.whiteness:
        assert f"| {each.channel} | {each.size:.2g} |" in text


def test_mistakes_in_settings_are_told_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "my.yaml"
    path.write_text(SETTINGS + "lern: {}\n")
    with pytest.raises(InvalidInput, match="lern"):
        read_settings(path)
    path.write_text(SETTINGS.replace("{prior: 0.02}", "{prior: 0.02, bounds: [0.01, 0.02]}"))
    with pytest.raises(InvalidInput, match="one of them"):
        calibrated_robot(read_settings(path), tmp_path)


def test_equal_names_of_recordings_are_refused() -> None:
    settings, recording, found = case()
    with pytest.raises(InvalidInput, match="name of its own"):
        calibrate(found.subject, settings, [recording, recording])


def test_a_robot_out_of_the_water_is_refused(tmp_path: Path) -> None:
    (tmp_path / "my.urdf").write_text((robot_folder("bluerov2_alpha5") / "robot.urdf").read_text())
    (tmp_path / "my.yaml").write_text(SETTINGS.replace("bluerov2_alpha5", "my.urdf"))
    with pytest.raises(InvalidInput, match="has no hydrodynamics of a link in water"):
        calibrated_robot(read_settings(tmp_path / "my.yaml"), tmp_path)
