"""Violations of limits are judged from where the robot truly was; studies of nothing are
refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from compiler import long_without_compiler
from studies.random_limits import close_quarters, largest, limit_violations, random_limits
from studies.random_missions import random_missions
from studies.study import Study

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.meta_values import PhaseMeta
from uvms_ocp.record.record import Record
from uvms_ocp.record.run_meta import RunMeta
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.seafloor import FlatSeafloor

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return close_quarters(seed=0)


def at(*configurations: np.ndarray) -> Record:
    """A record whose measured altitude is always 100 m."""
    n = len(configurations)
    series = {
        "t": np.arange(n) * 0.1,
        "q": np.array(configurations),
        "quantities": np.full((n, 1), 100.0),
    }
    meta = RunMeta(
        scenario="placed",
        robot="any",
        joints=(),
        phases=(PhaseMeta(name="A"),),
        quantities=("MAC.altitude",),
        plant="kinematic",
        solver="none",
        floating=True,
        dt=0.1,
        completed=True,
    )
    return Record(series=series, meta=meta)


def lowered(scenario: Scenario, depth: float) -> np.ndarray:
    q = np.array(scenario.start)
    q[2] -= depth
    return q


def test_a_start_inside_all_limits_violates_none(scenario: Scenario) -> None:
    violations = limit_violations(scenario, at(scenario.start))
    assert set(violations) == {"joints_rad", "MAC_m", "CL_m", "SC_m"}
    assert not any(violations.values())


def test_the_altitude_is_that_of_the_true_configuration_above_the_floor(scenario: Scenario) -> None:
    deep = limit_violations(scenario, at(lowered(scenario, 10.0)))["MAC_m"]
    deeper = limit_violations(scenario, at(lowered(scenario, 11.0)))["MAC_m"]
    assert deep > 0.0
    assert deeper - deep == pytest.approx(1.0)
    environment = replace(scenario.environment, seafloor=FlatSeafloor(z=-3.5))
    raised = replace(scenario, environment=environment)
    above_raised = limit_violations(raised, at(lowered(scenario, 10.0)))["MAC_m"]
    assert above_raised - deep == pytest.approx(0.5)


def test_the_worst_tick_counts(scenario: Scenario) -> None:
    alone = limit_violations(scenario, at(lowered(scenario, 10.0)))
    record = at(scenario.start, lowered(scenario, 10.0), scenario.start)
    assert limit_violations(scenario, record) == alone


@pytest.mark.parametrize("index", [2, -1])
def test_a_configuration_that_is_no_number_violates_limits(scenario: Scenario, index: int) -> None:
    broken = np.array(scenario.start)
    broken[index] = np.nan
    violations = limit_violations(scenario, at(scenario.start, broken))
    assert violations["MAC_m"] == violations["CL_m"] == violations["SC_m"] == np.inf
    assert (violations["joints_rad"] == np.inf) == (index == -1)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e-3])
def test_a_run_with_a_value_that_is_no_number_counts_as_violated(value: float) -> None:
    row = {
        "joints_rad": 0.0,
        "MAC_m": 0.0,
        "largest_step": 1.0,
        "slowed_share": 0.0,
        "path_m": 1.0,
    }
    (total,) = largest([{**row, "seed": 0}, {**row, "seed": 1, "MAC_m": value}, {**row, "seed": 2}])
    assert (total["violated"], total["seeds"]) == (1, "1")
    assert not total["MAC_m"] <= 0.0


@pytest.mark.parametrize("study", [random_limits, random_missions])
@pytest.mark.parametrize(
    ("n", "seed", "message"),
    [(0, 0, "n = 0 runs"), (-3, 0, "n = -3 runs"), (1, -1, "seed = -1; give a whole number >= 0")],
)
def test_a_study_of_nothing_or_of_a_negative_seed_is_refused(
    study: Callable[..., Study], n: int, seed: int, message: str
) -> None:
    with pytest.raises(InvalidInput, match=message):
        study(n=n, seed=seed)


@long_without_compiler
def test_the_seeds_of_a_study_follow_each_other() -> None:
    assert [case["seed"] for case in random_limits(n=3, seed=5).cases] == [5, 6, 7]
