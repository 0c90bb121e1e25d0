"""What is uncertain: distributions agree with scipy.stats, parameters do what they say, and run k
is drawn alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from compiler import long_without_compiler
from scipy import stats

from uvms_ocp.campaign.distributions import (
    Choice,
    LogNormal,
    Normal,
    OfScipy,
    Triangular,
    Uniform,
)
from uvms_ocp.campaign.sampling_design import SAMPLERS, Design
from uvms_ocp.campaign.variations import (
    Variation,
    available_parameters,
    quantiles,
    require_available,
    vary,
)
from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.hydrodynamics import Water
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.scenario.cases.case1 import case1, two_targets
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.currents import GustyCurrent, UniformCurrent

SHARES = np.linspace(0.01, 0.99, 23)
ORACLES = [
    (Uniform(-1.0, 3.0), stats.uniform(-1.0, 4.0)),
    (Normal(2.0, 0.5), stats.norm(2.0, 0.5)),
    (LogNormal(1.5, 0.3), stats.lognorm(0.3, scale=1.5)),
    (Triangular(0.0, 1.0, 4.0), stats.triang(0.25, 0.0, 4.0)),
    (OfScipy(stats.beta(2.0, 5.0)), stats.beta(2.0, 5.0)),
]


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return case1(noise=True, current=(0.1, 0.0, 0.0))


@pytest.mark.parametrize(("ours", "oracle"), ORACLES, ids=lambda item: type(item).__name__)
def test_quantiles_are_those_of_scipy(ours: object, oracle: object) -> None:
    assert np.allclose(
        [ours.quantile(u) for u in SHARES], oracle.ppf(SHARES), rtol=1e-12, atol=1e-12
    )


def test_a_choice_gives_each_value_as_often() -> None:
    drawn = [Choice((1.0, 2.0, 5.0)).quantile(u) for u in (np.arange(300) + 0.5) / 300]
    assert [drawn.count(value) for value in (1.0, 2.0, 5.0)] == [100, 100, 100]


@pytest.mark.parametrize("ours", [Normal(0.0, 1.0), LogNormal()])
def test_the_ends_of_a_sample_are_finite(ours: Normal | LogNormal) -> None:
    assert np.isfinite([ours.quantile(0.0), ours.quantile(1.0)]).all()


def test_of_many_parameters_an_unknown_one_is_refused_with_the_nearest_first_and_where_all_are_listed(
    scenario: Scenario,
) -> None:
    with pytest.raises(
        NameNotFound, match=r"unknown parameter 'water.darg'\. Did you mean 'water.drag'\?"
    ) as refused:
        require_available([Variation("water.darg", Uniform(0.5, 1.5))], scenario)
    assert "--parameters` lists them" in str(refused.value)
    assert len(str(refused.value)) < 300 < len(", ".join(available_parameters(scenario)))


def test_a_parameter_has_one_distribution(scenario: Scenario) -> None:
    twice = [Variation("water.drag", Uniform(0.5, 1.5)), Variation("water.drag", LogNormal())]
    with pytest.raises(InvalidInput, match="varied twice"):
        require_available(twice, scenario)


def test_what_is_no_distribution_is_refused() -> None:
    with pytest.raises(InvalidInput, match="give Uniform, Normal"):
        Variation("water.drag", 0.5)


def test_a_parameter_of_ones_own_is_applied(scenario: Scenario) -> None:
    own = Variation(
        "slowness", Uniform(1.0, 2.0), apply=lambda given, value: replace(given, dt=0.01 * value)
    )
    require_available([own], scenario)
    assert vary(scenario, {"slowness": 1.5}, variations=[own]).dt == 0.015


def test_the_seed_reaches_sensors_and_gusts(scenario: Scenario) -> None:
    run = vary(scenario, {"current.gusts": 0.05}, seed=77)
    assert run.seed == 77
    assert isinstance(run.environment.current, GustyCurrent)
    assert (run.environment.current.seed, run.environment.current.sigma) == (77, 0.05)


def test_drag_is_a_factor_that_the_plant_feels_and_the_controller_does_not_know(
    scenario: Scenario,
) -> None:
    q = scenario.start
    still = np.zeros(scenario.robot.n_v)
    flow = Water(velocity=np.array([0.4, -0.2, 0.1]))

    def force(factor: float) -> np.ndarray:
        run = vary(scenario, {"water.drag": factor}, seed=0)
        assert run.robot is scenario.robot
        return robot_dynamics(run.plant_robot).inverse_dynamics(q, still, still, flow)

    nominal = robot_dynamics(scenario.robot).inverse_dynamics(q, still, still, flow)
    assert np.allclose(force(1.0), nominal, rtol=1e-9, atol=1e-9)
    assert np.allclose(force(2.0) - nominal, nominal - force(0.0), rtol=1e-9, atol=1e-9)
    assert np.linalg.norm(nominal - force(0.0)) > 1.0


def test_mass_and_added_mass_scale_what_resists(scenario: Scenario) -> None:
    q = scenario.start

    def mass_matrix(**values: float) -> np.ndarray:
        named = {name.replace("_", ".", 1): value for name, value in values.items()}
        run = vary(scenario, named, seed=0)
        return robot_dynamics(run.plant_robot or run.robot).mass_matrix(q)

    nominal = mass_matrix()
    heavy = mass_matrix(robot_mass=2.0)
    dry = mass_matrix(water_added_mass=0.0)
    assert np.allclose(heavy - nominal, dry, rtol=1e-8, atol=1e-8)


def test_a_payload_weighs_at_the_tool(scenario: Scenario) -> None:
    run = vary(scenario, {"payload.mass": 1.5}, seed=0)
    q = run.start
    still = np.zeros(run.robot.n_v)
    loaded, bare = (
        robot_dynamics(robot).inverse_dynamics(q, still, still)
        for robot in (run.plant_robot, run.robot)
    )
    R = np.array(run.robot.model.gravity.linear)
    assert np.isclose(np.linalg.norm((loaded - bare)[:3]), 1.5 * np.linalg.norm(R), rtol=1e-9)


def test_a_parameter_that_there_is_not_is_named_with_those_like_it(scenario: Scenario) -> None:
    with pytest.raises(
        NameNotFound,
        match=r"unknown parameter in values 'tasks.AT.gian'. Did you mean 'tasks.AT.gain'",
    ):
        vary(scenario, {"tasks.AT.gian": 0.3})


def test_another_number_is_the_scenario_that_has_it_and_its_randomness_stays(
    scenario: Scenario,
) -> None:
    changed = vary(replace(scenario, seed=7), {"tasks.AT.gain": 0.3})
    assert next(task for task in changed.mission.hierarchy.tasks if task.name == "AT").gain == 0.3
    assert changed.seed == 7


def test_each_tool_has_a_payload_of_its_own() -> None:
    scenario = two_targets(robot="bluerov2_two_alpha5")
    tools = scenario.robot.tools
    q = scenario.start
    still = np.zeros(scenario.robot.n_v)
    for name, tool in (("payload.mass", tools[0]), ("payload2.mass", tools[1])):
        run = vary(scenario, {name: 0.5}, seed=0)
        loaded, bare = (
            robot_dynamics(robot).inverse_dynamics(q, still, still)
            for robot in (run.plant_robot, run.robot)
        )
        weight = (
            Kinematics(run.robot, q).jacobian(tool)[2] * 0.5 * -run.robot.model.gravity.linear[2]
        )
        assert np.allclose(loaded - bare, weight, rtol=1e-9, atol=1e-9)


def test_speed_and_heading_make_a_current_whatever_their_order(scenario: Scenario) -> None:
    values = {"current.heading": 2.0, "current.speed": 0.25}
    run = vary(scenario, values, seed=0)
    current = run.environment.current
    assert isinstance(current, UniformCurrent)
    assert np.allclose(current.value, [0.25 * np.cos(2.0), 0.25 * np.sin(2.0), 0.0])


def test_sensors_change_in_truth_and_not_for_the_estimator(scenario: Scenario) -> None:
    values = {"sensors.noise": 3.0, "sensors.unmodelled_delay": 0.05, "sensors.depth.sigma": 0.2}
    run = vary(scenario, values, seed=0)
    assert run.sensors == scenario.sensors
    assert run.real_sensors.position.sigma == 3.0 * scenario.sensors.position.sigma
    assert run.real_sensors.position.delay == scenario.sensors.position.delay + 0.05
    assert run.real_sensors.depth.sigma == 0.2


def test_a_delay_is_known_to_the_estimator_and_an_unmodelled_one_comes_on_top(
    scenario: Scenario,
) -> None:
    values = {
        "sensors.delay": 0.05,
        "sensors.depth.delay": 0.2,
        "sensors.depth.unmodelled_delay": 0.03,
    }
    run = vary(scenario, values, seed=0)
    assert (
        run.specs.position.delay
        == run.real_sensors.position.delay
        == scenario.specs.position.delay + 0.05
    )
    assert run.specs.depth.delay == 0.2
    assert run.real_sensors.depth.delay == pytest.approx(0.23)
    delay_values = {"sensors.delay": 0.05}
    assert vary(scenario, delay_values, seed=0).real_sensors is None


@pytest.mark.slow
@long_without_compiler
@pytest.mark.parametrize(
    ("name", "delay"),
    [("sensors.delay", 0.05), ("sensors.delay", 0.15), ("sensors.joint_positions.delay", 0.2)],
)
def test_a_mission_bears_a_delay_that_is_known(scenario: Scenario, name: str, delay: float) -> None:
    record = vary(scenario, {name: delay}, seed=0).run()
    assert record.meta.completed
    assert not [alarm.text for alarm in record.meta.alarms if "suspect" in alarm.text]


@pytest.mark.slow
@long_without_compiler
@pytest.mark.parametrize("dt", [0.02, 0.005])
def test_a_mission_bears_20_ms_of_unmodelled_delay(scenario: Scenario, dt: float) -> None:
    late = vary(replace(scenario, dt=dt), {"sensors.unmodelled_delay": 0.02}, seed=0)
    record = late.run()
    assert record.meta.completed
    assert not [alarm.text for alarm in record.meta.alarms if "suspect" in alarm.text]


@long_without_compiler
def test_an_offset_of_zero_and_a_factor_of_one_change_nothing_that_is_measured(
    scenario: Scenario,
) -> None:
    neutral = {
        "start.yaw": 0.0,
        "floor.z": 0.0,
        "goals.PC.x": 0.0,
        "sensors.noise": 1.0,
        "thrusters.limit": 1.0,
    }
    short = replace(scenario, duration=0.2)
    run = vary(short, neutral, seed=short.seed)
    first_run = short.run()
    second_run = run.run()
    assert np.allclose(first_run["q"], second_run["q"], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["goals.PC.z", "goals.T.yaw", "goals.AT.x"])
def test_a_goal_is_moved(scenario: Scenario, name: str) -> None:
    task = name.split(".")[1]
    run = vary(scenario, {name: 0.3}, seed=0)
    before, after = (
        s.mission.hierarchy.tasks[s.mission.hierarchy.index(task)].reference(0.0)
        for s in (scenario, run)
    )
    assert 0.05 < np.abs(after - before).max() <= 0.3 + 1e-9


def test_every_parameter_says_its_unit_and_meaning(scenario: Scenario) -> None:
    parameters = available_parameters(scenario)
    assert all(
        parameter.unit and parameter.meaning and parameter.name == name
        for name, parameter in parameters.items()
    )
    assert "water.drag" not in available_parameters(replace(scenario, plant="kinematic"))


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_a_run_is_drawn_alone_as_among_all_others(sampler: str) -> None:
    design = Design(sampler=sampler, runs=32, parameters=2, seed=5)
    again = Design(sampler=sampler, runs=32, parameters=2, seed=5)
    rows = [design.row(k) for k in range(32)]
    assert (again.row(17) == rows[17]).all()
    assert again.seed_of(17) == design.seed_of(17)
    assert len({tuple(row) for row in rows}) > 20
    assert ((np.array(rows) >= 0) & (np.array(rows) <= 1)).all()


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_no_two_runs_of_a_campaign_share_a_seed_or_a_draw(sampler: str) -> None:
    design = Design(sampler=sampler, runs=256, parameters=2, seed=5)
    assert len({design.seed_of(k) for k in range(256)}) == 256
    assert len({tuple(design.row(k)) for k in range(256)}) == 256


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_another_seed_gives_another_sample(sampler: str) -> None:
    first_design, second_design = (
        Design(sampler=sampler, runs=32, parameters=2, seed=seed) for seed in (0, 1)
    )
    assert (first_design.row(3) != second_design.row(3)).any()
    assert first_design.seed_of(3) != second_design.seed_of(3)


def test_a_latin_hypercube_has_one_run_in_every_slice() -> None:
    design = Design(sampler="latin", runs=50, parameters=3, seed=1)
    slices = np.sort((np.array([design.row(k) for k in range(50)]) * 50).astype(int), axis=0)
    assert (slices == np.arange(50)[:, None]).all()


def test_a_block_of_the_indices_design_changes_one_parameter_at_a_time() -> None:
    rows = np.array(
        [Design(sampler="indices", runs=20, parameters=3, seed=1).row(k) for k in range(5)]
    )
    assert [(rows[0] != row).sum() for row in rows[1:4]] == [1, 1, 1]


@pytest.mark.parametrize(("runs", "parameters"), [(21, 3), (15, 3), (8, 1)])
def test_the_indices_design_wants_whole_blocks(runs: int, parameters: int) -> None:
    with pytest.raises(InvalidInput, match="sampler indices"):
        Design(sampler="indices", runs=runs, parameters=parameters, seed=0)


def test_an_unknown_sampler_is_refused() -> None:
    with pytest.raises(NameNotFound, match="Did you mean 'sobol'"):
        Design(sampler="sobel", runs=8, parameters=1, seed=0)


def test_values_follow_their_distributions() -> None:
    variations = [Variation("a", Normal(3.0, 0.1)), Variation("b", Uniform(0.0, 2.0))]
    design = Design(sampler="sobol", runs=512, parameters=2, seed=0)
    drawn = [quantiles(variations, design.row(k)) for k in range(512)]
    a, b = (np.array([row[name] for row in drawn]) for name in ("a", "b"))
    assert stats.kstest(a, stats.norm(3.0, 0.1).cdf).statistic < 0.02
    assert stats.kstest(b, stats.uniform(0.0, 2.0).cdf).statistic < 0.02
