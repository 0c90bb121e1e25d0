"""Tables of a campaign: intervals as published, sensitivities of functions whose indices are known,
pairs counted right.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from uvms_ocp.campaign.paired_comparison import _pairs
from uvms_ocp.campaign.report import cause_table, outcome_table
from uvms_ocp.campaign.run_metrics import (
    METRICS,
    OF_EACH_TOOL,
    distribution_table,
    metrics_among,
    tool_metrics,
)
from uvms_ocp.campaign.sampling_design import Design
from uvms_ocp.campaign.sensitivity import sensitivity_table
from uvms_ocp.campaign.success_criteria import judged, parse_bounds
from uvms_ocp.campaign.success_rate import Rate
from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.robot.loading import load_robot


def table(n: int, **columns: object) -> pd.DataFrame:
    """Make a table of n runs that succeeded, with other columns."""
    defaults = {
        "run": np.arange(n),
        "outcome": "completed",
        "success": True,
        "cause": "",
        "finished": True,
        "wall_s": 1.0,
    }
    return pd.DataFrame(defaults | dict.fromkeys(METRICS, np.nan) | columns)


@pytest.mark.parametrize(
    ("number", "runs", "method", "lower", "upper"),
    [
        # Newcombe 1998, Statistics in Medicine 17, table I, methods 3 and 5.
        (81, 263, "Wilson", 0.2553, 0.3662),
        (15, 148, "Wilson", 0.0624, 0.1605),
        (0, 20, "Clopper-Pearson", 0.0, 0.1684),
        (1, 29, "Clopper-Pearson", 0.0009, 0.1776),
    ],
)
def test_intervals_are_the_published_ones(
    number: int, runs: int, method: str, lower: float, upper: float
) -> None:
    rate = Rate(number=number, runs=runs)
    assert rate.method == method
    assert rate.interval == pytest.approx((lower, upper), abs=5.1e-5)


def test_more_successes_than_runs_are_refused() -> None:
    with pytest.raises(InvalidInput):
        Rate(number=3, runs=2)


def test_causes_that_differ_in_numbers_are_one() -> None:
    causes = ["stall at 3.2 s", "stall at 41 s", "joint2 jammed", ""]
    runs = table(
        4,
        cause=causes,
        success=[False, False, False, True],
        outcome=["stalled", "stalled", "given up", "completed"],
    )
    rows = cause_table(runs)
    assert [(row["cause"], row["number"], row["run"]) for row in rows] == [
        ("stall at 3.2 s", 2, 0),
        ("joint2 jammed", 1, 2),
    ]
    assert sum(row["number"] for row in outcome_table(runs)) == 4


def test_a_table_in_which_nothing_has_a_cause_gives_none() -> None:
    assert cause_table(table(3, cause=np.nan)) == []


def test_bounds_make_failures_of_what_finished_and_successes_of_what_the_mission_was_strict_about() -> (
    None
):
    runs = table(
        3,
        tool_position_error_m=[0.004, 0.02, 0.004],
        finished=[True, True, False],
        success=[False, True, False],
        outcome=["ended too early", "completed", "aborted"],
    )
    judged_runs = judged(runs, parse_bounds(["tool_position_error_m < 0.01"]))
    assert judged_runs["success"].tolist() == [True, False, False]
    assert judged_runs["outcome"].tolist() == [
        "completed",
        "not tool_position_error_m < 0.01",
        "aborted",
    ]


@pytest.mark.parametrize(
    ("text", "error"),
    [("tool<", InvalidInput), ("speed<1", NameNotFound), ("energy_j<1e", InvalidInput)],
)
def test_a_bound_that_is_none_is_refused(text: str, error: type[Exception]) -> None:
    with pytest.raises(error):
        parse_bounds([text])


def test_a_run_without_the_figure_does_not_keep_its_bound() -> None:
    assert judged(table(1), parse_bounds(["energy_j<1"]))["success"].tolist() == [False]


def test_quantiles_are_of_the_runs_that_have_the_figure() -> None:
    (row,) = distribution_table(table(5, energy_j=[1.0, 2.0, 3.0, np.nan, np.nan]))
    assert (row["figure"], row["runs"], row["median"], row["largest"]) == ("energy_j", 3, 2.0, 3.0)


def test_what_matters_stands_out_and_what_does_not_stays_at_the_floor() -> None:
    x = np.array(
        [Design(sampler="sobol", runs=1024, parameters=3, seed=2).row(k) for k in range(1024)]
    )
    runs = table(
        1024, a=x[:, 0], b=x[:, 1], c=x[:, 2], energy_j=10 * x[:, 0] + (x[:, 1] - 0.5) ** 2 * 8
    )
    findings = {
        row["parameter"]: row for row in sensitivity_table(runs, ["a", "b", "c"], indices=False)
    }
    assert findings["a"]["rank_correlation"] > 0.9
    assert findings["a"]["pawn"] > findings["b"]["pawn"] > 0
    assert abs(findings["b"]["rank_correlation"]) < 0.1
    assert findings["c"]["pawn"] < 2 * findings["c"]["pawn_floor"]
    assert "s1" not in findings["a"]


def test_sobol_indices_of_the_ishigami_function_are_the_known_ones() -> None:
    # Ishigami and Homma 1990 with a = 7, b = 0.1: S1 = 0.3139, 0.4424, 0; ST = 0.5576, 0.4424,
    # 0.2437.
    design = Design(sampler="indices", runs=4096 * 5, parameters=3, seed=0)
    x = np.pi * (2 * np.array([design.row(k) for k in range(design.runs)]) - 1)
    y = np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    runs = table(design.runs, a=x[:, 0], b=x[:, 1], c=x[:, 2], energy_j=y)
    findings = {
        row["parameter"]: row for row in sensitivity_table(runs, ["a", "b", "c"], indices=True)
    }
    assert [findings[name]["s1"] for name in "abc"] == pytest.approx(
        [0.3139, 0.4424, 0.0], abs=0.03
    )
    assert [findings[name]["st"] for name in "abc"] == pytest.approx(
        [0.5576, 0.4424, 0.2437], abs=0.03
    )


def test_few_runs_say_nothing_of_sensitivity() -> None:
    runs = table(10, a=np.arange(10.0), energy_j=np.arange(10.0))
    assert sensitivity_table(runs, ["a"], indices=False) == []


def test_only_pairs_that_differ_speak() -> None:
    a = table(20, success=[True] * 10 + [False] * 10, energy_j=np.arange(20.0))
    b = table(20, success=[True] * 18 + [False] * 2, energy_j=np.arange(20.0) + 2.0)
    pairs = _pairs(a, b)
    assert (
        pairs["both_succeed"],
        pairs["both_fail"],
        pairs["first_only"],
        pairs["second_only"],
    ) == (10, 2, 0, 8)
    assert pairs["p_value"] == pytest.approx(2 * 0.5**8)
    (row,) = pairs["figures"]
    assert (row["mean_change"], row["lower"], row["upper"]) == (2.0, 2.0, 2.0)


def test_a_campaign_of_a_version_without_a_figure_has_the_distributions_of_the_others() -> None:
    old = table(4, duration_s=[1.0, 2.0, 3.0, 4.0], joint_margin_m=0.1)
    assert [row["figure"] for row in distribution_table(old)] == ["duration_s", "joint_margin_m"]
    assert [row["figure"] for row in distribution_table(old.drop(columns="joint_margin_m"))] == [
        "duration_s"
    ]


def test_metrics_of_each_tool_are_columns_by_its_name() -> None:
    """And of a robot with one tool there are none but its own."""
    two_arm_robot = load_robot("bluerov2_two_alpha5")
    single_arm_robot = load_robot("bluerov2_alpha5")
    assert tool_metrics(single_arm_robot) == {}
    names = []
    for tool in ("port_tool", "starboard_tool"):
        names += [f"{kind}[{tool}]" for kind in OF_EACH_TOOL]
    assert [*tool_metrics(two_arm_robot)] == names
    meanings = metrics_among(["run", "current.x", *METRICS, *names])
    assert [*meanings] == [*METRICS, *names]
    (bound,) = parse_bounds(["clearance_m[starboard_tool] > 0.2"])
    rows = table(3, **{"clearance_m[starboard_tool]": [0.1, 0.3, np.nan]}, finished=[True] * 3)
    assert judged(rows, [bound])["success"].tolist() == [False, True, False]
    with pytest.raises(NameNotFound, match=r"clearance_m\[middle\]"):
        judged(rows, parse_bounds(["clearance_m[middle] > 0.2"]))
