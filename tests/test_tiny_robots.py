"""Sizes of one and of none: every array keeps its axes, from the loading of a robot to the scene of
its run.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text
from tiny_robots import LIMIT, RIGID, TINY, WEIGHTLESS, Tiny, robot_of, scenario_of

from uvms_ocp.campaign.run_metrics import run_metrics
from uvms_ocp.campaign.variations import available_parameters
from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.record import Record
from uvms_ocp.record.tables import column_units
from uvms_ocp.report.comparison import compare
from uvms_ocp.report.metrics import estimate_table
from uvms_ocp.report.summary import RunSummary, summarize
from uvms_ocp.robot.signals import Command, SensorSpecs, State
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim import GustyCurrent, ShearedCurrent
from uvms_ocp.viz import plot, show, write_figures, write_scene


@pytest.mark.parametrize("name", TINY)
def test_numbers_of_joints_and_configurations_are_each_others_inverse(name: str) -> None:
    robot = robot_of(TINY[name])
    rng = np.random.default_rng(1)
    assert robot.home.shape == (robot.n_joints,)
    for _ in range(20):
        lower, upper = robot.limits.position_lower, robot.limits.position_upper
        values = rng.uniform(np.maximum(lower, -3.1), np.minimum(upper, 3.1))
        q = robot.configuration(joints=values)
        np.testing.assert_allclose(robot.joint_values(q), values, atol=1e-12)
        np.testing.assert_allclose(
            robot.with_joint_values(robot.configuration(), values), q, atol=1e-12
        )
        np.testing.assert_allclose(
            [joint.position(q) for joint in robot.joints], values, atol=1e-12
        )


@pytest.mark.sampled
@pytest.mark.parametrize("name", TINY)
def test_a_run_on_the_kinematic_plant_is_the_same_once_saved_and_loaded(
    name: str, tmp_path: Path
) -> None:
    robot = robot_of(TINY[name])
    scenario = scenario_of(robot, "kinematic")
    scenario.check()
    record = scenario.run()
    record.save(tmp_path / "record.npz")
    again = Record.load(tmp_path / "record.npz")
    assert again.meta == record.meta
    for series, values in record.series.items():
        np.testing.assert_array_equal(again[series], values)
    assert summarize(record)["phases"]


MIXED = Tiny(joints=(("prismatic", "1 0 0", LIMIT), ("revolute", "0 0 1", LIMIT)))


@pytest.mark.sampled
@pytest.mark.parametrize("name", ["one wet link", "an endless joint", "a joint that slides"])
def test_joints_that_all_turn_or_all_slide_have_one_unit_everywhere(name: str) -> None:
    robot = robot_of(TINY[name])
    scenario = scenario_of(robot, "kinematic")
    record = scenario.run()
    texts = [text.get_text() for figure in plot(record) for text in figure.findobj(Text)]
    texts += [
        show(record, robot).html,
        str(record),
        *(parameter.unit for parameter in available_parameters(scenario).values()),
    ]
    assert any("rad" in text for text in texts)
    assert not [text[:200] for text in texts if re.search("(rad|rad/s|N m) or (m|N)", text)]


def test_each_joint_has_the_unit_of_its_kind() -> None:
    robot = robot_of(MIXED)
    record = scenario_of(robot, "kinematic").run()
    units = column_units("v", robot.n_v, record.meta)
    assert units[6:] == ["m/s", "rad/s"]
    row = summarize(record)["resources"][-1]
    limits = robot.limits
    joints = record["q"][:, 7:]
    margins = np.minimum(joints - limits.position_lower, limits.position_upper - joints)
    smallest = margins.min(axis=0)
    np.testing.assert_allclose([row["joint_margin_m"], row["joint_margin_rad"]], smallest)
    way = np.abs(record["v"][:-1, 6:]).sum(axis=0) * record.run_meta.dt
    np.testing.assert_allclose([row["joint_path_m"], row["joint_path_rad"]], way)
    old = record.meta.model_copy(update={"sliding": None})
    assert column_units("v", robot.n_v, old)[6:] == ["rad/s or m/s"] * 2
    turning = scenario_of(robot_of(TINY["one wet link"]), "kinematic").run()
    figures = {row["figure"] for row in compare(record, turning)}
    assert {"joint_path_m", "joint_path_rad"} <= figures


def test_errors_of_joints_that_turn_and_that_slide_are_told_apart() -> None:
    scenario = replace(scenario_of(robot_of(MIXED), "kinematic"), sensors=SensorSpecs())
    record = scenario.run()
    half = slice(len(record) // 2, None)
    errors = (record["q_estimated"] - record["q"])[half, 7:]
    rms = np.sqrt((errors**2).mean(axis=0))
    spread = np.sqrt((record["q_std"][half, 6:] ** 2).mean(axis=0))
    rows = {row["of"]: row for row in estimate_table(record)}
    assert [*rows] == ["position", "attitude", "joints", "sliding joints"]
    for name, k in (("sliding joints", 0), ("joints", 1)):
        assert (rows[name]["rms"], rows[name]["spread"]) == pytest.approx((rms[k], spread[k]))


def test_a_robot_of_which_nothing_moves_is_refused() -> None:
    with pytest.raises(
        InvalidInput, match="'tiny' has a fixed base and no joints: nothing of it moves"
    ):
        scenario_of(robot_of(RIGID), "kinematic")


def test_a_run_that_diverges_keeps_what_came_before(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    record = scenario_of(robot_of(WEIGHTLESS), "dynamic").run()
    assert (
        "the run ends at t = 0 s: after it the plant's motion grew beyond what a record holds"
        in caplog.text
    )
    record.save(tmp_path / "record.npz")
    loaded = Record.load(tmp_path / "record.npz")
    assert loaded["q"].shape == (1, record.series["q"].shape[1])
    assert summarize(loaded)["cause"]["kind"] == "diverged"


@pytest.mark.slow
@pytest.mark.parametrize("name", TINY)
def test_a_run_in_water_is_saved_loaded_told_and_drawn(name: str, tmp_path: Path) -> None:
    robot = robot_of(TINY[name])
    scenario = scenario_of(robot, "dynamic")
    scenario.check()
    record = scenario.run()
    n = len(record)
    assert record["current"].shape == (n, 3)
    assert record["thrust"].shape == (n, len(robot.description.thrusters))
    assert record["torque"].shape == (n, robot.n_joints)
    record.save(tmp_path / "record.npz")
    loaded = Record.load(tmp_path / "record.npz")
    assert summarize(loaded)["phases"]
    assert write_figures(loaded, tmp_path)
    write_scene(loaded, robot, tmp_path / "scene.html")
    assert (tmp_path / "scene.html").stat().st_size > 0


def test_a_campaign_has_the_least_margin_of_joints_that_slide() -> None:
    scenario = scenario_of(robot_of(TINY["a joint that slides"]), "kinematic")
    record = scenario.run()
    limits = scenario.robot.limits
    q = record["q"][:, -1:]
    away = np.minimum(q - limits.position_lower, limits.position_upper - q).min()
    assert run_metrics(scenario, record)["joint_margin_m"] == pytest.approx(away)


SHEARED = ShearedCurrent(z=[-10.0, 0.0], velocities=[[0.0, 0.0, 0.0], [0.2, 0.1, 0.0]])
LAYERS = {
    "of two heights": SHEARED,
    "of one height": ShearedCurrent(z=[-10.0], velocities=[[0.1, 0.0, 0.0]]),
    "with gusts": GustyCurrent(base=SHEARED),
}


@pytest.mark.sampled
@pytest.mark.parametrize("layers", LAYERS)
@pytest.mark.parametrize("name", ["fixed base, no thrusters", "one wet link", "no joints"])
def test_a_current_that_varies_with_depth_flows_past_a_single_link(name: str, layers: str) -> None:
    scenario = scenario_of(robot_of(TINY[name]), "dynamic", duration=0.02)
    environment = replace(scenario.environment, current=LAYERS[layers])
    scenario = replace(scenario, environment=environment)
    scenario.check()
    record = scenario.run()
    assert np.linalg.norm(record["current"][1:], axis=1).min() > 0.05


def test_a_figure_of_zero_is_on_the_page() -> None:
    summary = summarize(scenario_of(robot_of(TINY["one wet link"]), "kinematic").run())
    assert "min_altimeter_m" in str(RunSummary({**summary, "min_altimeter_m": 0.0}))
    assert "min_altimeter_m" not in str(RunSummary({**summary, "min_altimeter_m": None}))


class GrowingPlant:
    """Moves ahead, at every tick faster by a factor."""

    takes_forces = False

    def __init__(self, q: np.ndarray, n_v: int, factor: float) -> None:
        self.state = State(q=q, v=np.zeros(n_v))
        self.factor = factor

    def telemetry(self) -> dict[str, float]:
        return {}

    def step(self, command: Command, dt: float) -> None:
        q = self.state.q.copy()
        v = self.state.v.copy()
        v[0] = self.factor * max(v[0], 0.1)
        q[0] += dt * v[0]
        self.state = State(q=q, v=v)


@pytest.mark.parametrize("factor", [10.0, 1e9, 1e40, 1e170, 1e308])
def test_a_run_that_outgrows_its_record_ends_at_its_last_readable_row(
    factor: float, tmp_path: Path
) -> None:
    scenario = scenario_of(robot_of(TINY["one wet link"]), "kinematic")

    def growing(scenario: Scenario, *_: object, **__: object) -> GrowingPlant:
        return GrowingPlant(np.array(scenario.start), scenario.robot.n_v, factor)

    growing.takes_forces = False  # type: ignore[attr-defined]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        record = replace(scenario, plant=growing).run()
    record.save(tmp_path / "record.npz")
    loaded = Record.load(tmp_path / "record.npz")
    assert loaded.run_meta.stopped == summarize(loaded)["cause"]["kind"] == "diverged"
    last = loaded["v"][-1, 0]
    assert last <= 1e10 <= 1.1 * factor * max(last, 0.1)
