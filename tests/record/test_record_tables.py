"""Records as tables: every series is told what it is, and Parquet gives the same record again."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from same_record import require_same

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.record.record import Record
from uvms_ocp.record.tables import QUANTITIES, SERIES, column_names, column_units
from uvms_ocp.scenario.cases.case1 import case1

RECORDS = Path(__file__).parents[1] / "records"


@pytest.fixture(scope="module")
def record() -> Record:
    return case1(noise=True, dt=0.02, duration=0.3).run()


PLANS = [Record.load(RECORDS / f"{name}.npz") for name in ("plan_curve_v0_1", "plan_ocp_v0_1")]


def test_every_series_that_is_recorded_is_in_the_table(record: Record) -> None:
    for any_record in (record, *PLANS):
        assert set(any_record.series) <= set(SERIES)
    assert all(
        kind.meaning and kind.unit and kind.shape.startswith("(") for kind in SERIES.values()
    )


def test_the_shape_of_a_series_is_what_the_table_says(record: Record) -> None:
    assert {name for name, array in record.series.items() if array.ndim == 1} == {
        name for name, kind in SERIES.items() if kind.shape == "()" and name in record.series
    }


def test_every_column_has_its_unit(record: Record) -> None:
    units = {
        column: unit
        for name, array in record.series.items()
        for column, unit in zip(
            column_names(name, array[0].size, record.meta),
            column_units(name, array[0].size, record.meta),
            strict=True,
        )
    }
    expected = {
        "q.x": "m",
        "q.qw": "-",
        "q.joint3": "rad",
        "v.yaw_rate": "rad/s",
        "wrench.yaw_rate": "N m",
    }
    expected |= {
        "q_std.yaw_rate": "rad",
        "torque.joint1": "N m",
        "T.position_error": "m",
        "HA.tilt": "rad",
    }
    assert {name: units[name] for name in expected} == expected
    of_plan = column_units("x_rate", len(PLANS[1].plan_meta.axes), PLANS[1].meta)
    assert dict(zip(PLANS[1].plan_meta.axes, of_plan, strict=True))["yaw"] == "rad/s"


def test_our_tasks_measure_nothing_without_a_unit(record: Record) -> None:
    assert {name.rpartition(".")[2] for name in record.meta.quantities} <= set(QUANTITIES)


def test_a_quantity_is_found_by_its_name(record: Record) -> None:
    column = record.meta.quantities.index("T.position_error")
    assert (record["T.position_error"] == record["quantities"][:, column]).all()
    with pytest.raises(NameNotFound, match=r"Did you mean 'T.position_error'"):
        record["T.positon_error"]


def test_a_table_has_a_column_for_every_number_and_names_that_say_whose_it_is(
    record: Record,
) -> None:
    table = record.to_dataframe()
    assert len(table) == len(record)
    assert table.shape[1] == sum(
        array[0].size if array.ndim > 1 else 1 for array in record.series.values()
    )
    assert table.columns.is_unique
    assert (table["q.joint3"] == record["q"][:, 9]).all()
    assert (table["v.yaw_rate"] == record["v"][:, 5]).all()
    assert (table["T.position_error"] == record["T.position_error"]).all()


@pytest.mark.parametrize("plan", PLANS, ids=("curve", "ocp"))
def test_plans_come_back_as_they_were(plan: Record, tmp_path: Path) -> None:
    _comes_back(plan, tmp_path)


def test_a_run_comes_back_as_it_was(record: Record, tmp_path: Path) -> None:
    _comes_back(record, tmp_path)


def _comes_back(record: Record, folder: Path) -> None:
    record.to_parquet(folder / "record.parquet")
    require_same(Record.from_parquet(folder / "record.parquet"), record)


def test_csv_has_every_digit(record: Record, tmp_path: Path) -> None:
    record.to_csv(tmp_path / "record.csv")
    with (tmp_path / "record.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["q.x"]) for row in rows] == record["q"][:, 0].tolist()


def test_a_file_of_others_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.parquet").write_bytes(b"PAR1")
    with pytest.raises(InvalidInput, match="cannot be read"):
        Record.from_parquet(tmp_path / "a.parquet")
