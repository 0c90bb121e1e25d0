"""Resources of a run: parts add up to the total, and two runs compare figure by figure."""

from __future__ import annotations

import numpy as np
import pytest
from compiler import long_without_compiler

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.record import Record
from uvms_ocp.report.comparison import compare
from uvms_ocp.report.phase_resources import resources
from uvms_ocp.scenario.cases.case1 import Thresholds, case1


@pytest.fixture(scope="module")
def record() -> Record:
    """A short mission with all phases on the dynamic plant."""
    thresholds = Thresholds(way_point=50.0, misalignment=4.0, landing_altitude=50.0)
    return case1(thresholds=thresholds, duration=2.0, dt=0.01, current=(0.2, 0.0, 0.0)).run()


@long_without_compiler
def test_the_parts_add_up_to_the_total(record: Record) -> None:
    rows = resources(record)
    assert [row["phase"] for row in rows] == ["A", "B", "C", "D", "total"]
    for name in ("duration_s", "thruster_energy_j", "joint_energy_j", "path_length_m"):
        assert sum(row[name] for row in rows[:-1]) == pytest.approx(rows[-1][name])
    for name in ("peak_thrust_n", "velocity_share", "torque_share"):
        assert max(row[name] for row in rows[:-1]) == rows[-1][name]


@long_without_compiler
def test_the_energy_is_what_the_drives_took(record: Record) -> None:
    total = resources(record)[-1]
    assert total["thruster_energy_j"] == pytest.approx(record["thruster_energy"][-1].sum())
    assert total["joint_energy_j"] == pytest.approx(record["joint_energy"][-1])
    assert total["thruster_energy_j"] > 1.0


@long_without_compiler
def test_shares_stay_below_one_within_the_limits(record: Record) -> None:
    total = resources(record)[-1]
    assert 0 < total["velocity_share"] <= 1
    assert 0 < total["torque_share"] <= 1
    assert total["joint_margin_rad"] > 0


@long_without_compiler
def test_a_kinematic_plant_has_no_forces_to_report() -> None:
    total = resources(case1(plant="kinematic", duration=0.2).run())[-1]
    assert (
        total["thruster_energy_j"] is total["peak_thrust_n"] is total["saturation_time_s"] is None
    )
    assert total["duration_s"] == pytest.approx(0.2)


@long_without_compiler
def test_a_run_compared_with_itself_has_not_changed(record: Record) -> None:
    changes = [row["change"] for row in compare(record, record)]
    np.testing.assert_array_equal([change for change in changes if change is not None], 0.0)


@long_without_compiler
def test_a_comparison_gives_the_change_in_percent(record: Record) -> None:
    shorter = case1(plant="kinematic", duration=0.2).run()
    rows = {row["figure"]: row for row in compare(record, shorter)}
    assert rows["duration_s"]["change"] == pytest.approx(-90.0)
    assert rows["thruster_energy_j"]["second"] is None
    assert rows["thruster_energy_j"]["change"] is None


@long_without_compiler
def test_runs_by_name_have_columns_of_their_names(record: Record) -> None:
    shorter = case1(plant="kinematic", duration=0.2).run()
    two = compare({"strict": record, "short": shorter})
    plain = compare(record, shorter)
    renamed = {"strict": "first", "short": "second"}
    assert [{renamed.get(key, key): value for key, value in row.items()} for row in two] == plain
    rows = {row["figure"]: row for row in compare({"a": record, "b": shorter, "c": record})}
    assert list(rows["duration_s"]) == ["figure", "a", "b", "c", "change of b", "change of c"]
    assert rows["duration_s"]["change of b"] == pytest.approx(-90.0)
    assert rows["duration_s"]["change of c"] == 0.0


@long_without_compiler
@pytest.mark.parametrize("names", [[], ["a"], ["a", "figure"], ["a", "change of b"]])
def test_too_few_runs_and_names_of_columns_are_refused(record: Record, names: list[str]) -> None:
    with pytest.raises(InvalidInput, match="give"):
        compare(dict.fromkeys(names, record))
