"""Any file in the place of a record or of a trajectory: read and as promised, or refused in one
line.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawing import binary, chosen, integers, texts
from hypothesis import given, settings, strategies as st
from promises import DAMAGES, Damage, Tally, damaged, damaged_bytes

from uvms_ocp.ocp.plan import Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpLevel, single_phase
from uvms_ocp.ocp.terms import Effort
from uvms_ocp.record.record import Record
from uvms_ocp.report.comparison import compare, transition_table
from uvms_ocp.report.end_of_run import cause_of_end
from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import State
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial

pytestmark = pytest.mark.slow

RECORDS = Path(__file__).parents[1] / "records"
KEPT = (
    "t",
    "q",
    "v",
    "command",
    "altimeter_range",
    "tick_time",
    "x",
    "x_rate",
    "phase",
    "activations",
    "residual",
    "activity",
    "quantities",
    "status",
    "thrust",
    "asked_thrust",
    "torque",
    "thruster_energy",
    "clearance",
)
"""Series that are tried; the others are treated alike."""


def parts(name: str) -> dict[str, Any]:
    """Metadata and series of a stored record."""
    record = Record.load(RECORDS / name)
    meta = json.loads(record.meta.model_dump_json())
    meta["surroundings"]["floor"] = None
    meta["surroundings"]["obstacles"] = meta["surroundings"]["obstacles"][:1]
    return {"meta": meta, "series": {name: record[name] for name in KEPT if name in record.series}}


def written(meta: Any, series: dict[str, np.ndarray]) -> bytes:
    file = io.BytesIO()
    np.savez(file, __meta__=np.array(json.dumps(meta)), **series)  # type: ignore[arg-type]
    return file.getvalue()


def check_record(record: Record) -> None:
    t = record["t"]
    assert t.ndim == 1
    assert np.isfinite(t).all()
    assert (t[1:] > t[:-1]).all()
    assert {len(array) for array in record.series.values()} == {len(t)}
    assert all(array.dtype.kind in "fiub" for array in record.series.values())
    assert np.isfinite(record["q"]).all() if "q" in record.series else True
    assert record.meta.phases
    if "phase" in record.series:
        assert 0 <= record["phase"].min() <= record["phase"].max() < len(record.meta.phases)


ARRAYS: tuple[Any, ...] = (
    *(
        np.zeros(0),
        np.array(1.0),
        np.zeros(4),
        np.zeros((4, 1)),
        np.zeros((3, 13)),
        np.zeros((4, 0)),
        np.zeros((4, 13, 2)),
    ),
    *(
        np.full((4, 13), np.nan),
        np.full(4, 7),
        np.arange(4.0)[::-1],
        np.array(["a"] * 4),
        np.array([None] * 4),
    ),
    *(
        np.full((4, 14), 1e308),
        np.zeros(4, dtype=complex),
        np.zeros(4, dtype=">f8"),
        np.zeros(4, dtype="<M8[s]"),
    ),
)


def test_any_change_of_a_record_is_as_promised_or_refused_in_one_line(tmp_path: Path) -> None:
    tally = Tally(bad=600)
    path = tmp_path / "record.npz"
    kinds = [parts("run_v0_1.npz"), parts("plan_ocp_v0_1.npz")]

    def holds(content: bytes) -> None:
        path.write_bytes(content)
        record = tally.outcome(lambda: Record.load(path))
        if record is not None:
            check_record(record)

    for kind in kinds:
        meta, series = kind["meta"], kind["series"]
        whole = written(meta, series)
        path.write_bytes(whole)
        check_record(Record.load(path))

        @settings(max_examples=150)
        @given(DAMAGES)
        def broken(damage: Damage) -> None:
            holds(damaged_bytes(whole, damage))  # noqa: B023 -- is called in this round of the loop

        broken()

        @settings(max_examples=250)
        @given(damaged(meta))
        def lying(lie: Any) -> None:
            holds(written(lie, series))  # noqa: B023 -- is called in this round of the loop

        lying()

        @settings(max_examples=150)
        @given(chosen(sorted(series)), integers(len(ARRAYS) - 1))
        def other(name: str, index: int) -> None:
            # B023: it is called in this round of the loop
            holds(written(meta, {**series, name: ARRAYS[index]}))  # noqa: B023

        other()
    tally.check()


REPORTS: tuple[Callable[[Record], Any], ...] = (
    lambda record: compare(record, record),
    summarize,
    cause_of_end,
    lambda record: transition_table({"one": record}),
)
ODD_SERIES: tuple[Callable[[np.ndarray], np.ndarray], ...] = (
    *(
        lambda a: a[..., None],
        lambda a: a.reshape(len(a), -1)[:, 0],
        lambda a: a.reshape(len(a), -1)[:, :0],
    ),
    *(
        lambda a: a.reshape(len(a), -1)[:, 1:],
        lambda a: np.hstack([a, a]),
        lambda a: a[:1],
        lambda a: a[::-1],
    ),
    *(lambda a, kind=kind: a.astype(kind) for kind in ("f2", "f4", "i8", "u1", "?", ">f8", "i2")),
    *(
        lambda a, x=x: np.full_like(a, x, dtype=float)
        for x in (0.0, 1e30, -1e30, 1e31, 5e-324, np.nan, np.inf)
    ),
    *(
        lambda a, x=x: np.where(np.arange(a.size).reshape(a.shape) == 7, x, a)
        for x in (0.0, 1e30, np.nan, -np.inf)
    ),
)
"""What may have become of a series; in the last line, of one of its numbers."""


@pytest.mark.parametrize("form", ["parquet", "mcap"])
def test_any_change_of_an_exported_record_is_as_promised_or_refused_in_one_line(
    form: str, tmp_path: Path
) -> None:
    tally = Tally(bad=30)
    path = tmp_path / f"record.{form}"
    content = (RECORDS / f"run_v1.{form}").read_bytes()
    load = getattr(Record, f"from_{form}")

    @settings(max_examples=100)
    @given(DAMAGES)
    def broken(damage: Damage) -> None:
        path.write_bytes(damaged_bytes(content, damage))
        record = tally.outcome(lambda: load(path))
        if record is not None:
            check_record(record)

    path.write_bytes(content)
    check_record(load(path))
    broken()
    tally.check()


def test_any_record_that_is_read_can_be_reported_or_is_refused(tmp_path: Path) -> None:
    """What a loader lets through, reports must bear."""
    tally = Tally(bad=300, good=100)
    path = tmp_path / "record.npz"
    meta, series = (parts("run_v0_1.npz")[part] for part in ("meta", "series"))

    def holds(meta: Any, series: dict[str, np.ndarray]) -> None:
        path.write_bytes(written(meta, series))
        record = tally.outcome(lambda: Record.load(path))
        for report in REPORTS if record is not None else ():
            # B023: it is called in this round of the loop
            tally.outcome(lambda: json.dumps(report(record)))  # noqa: B023

    settings(max_examples=250)(
        given(damaged(meta, max_changes=1))(lambda lie: holds(lie, series))
    )()

    @settings(max_examples=250)
    @given(chosen(sorted(series)), integers(len(ODD_SERIES) - 1))
    def odd(name: str, index: int) -> None:
        holds(meta, {**series, name: ODD_SERIES[index](series[name])})

    odd()

    @settings(max_examples=30)
    @given(chosen(sorted(series)))
    def without(name: str) -> None:
        holds(meta, {key: array for key, array in series.items() if key != name})

    without()
    tally.check()


def test_any_change_of_a_trajectory_is_as_promised_or_refused_in_one_line(tmp_path: Path) -> None:
    tally = Tally(bad=250)
    path = tmp_path / "plan.npz"
    rng = np.random.default_rng(0)
    PiecewisePolynomial(
        breaks=np.arange(3.0), coefficients=rng.standard_normal((4, 2, 3))
    ).to_numpy(path)
    whole = path.read_bytes()

    def holds(content: bytes) -> None:
        path.write_bytes(content)
        curve = tally.outcome(lambda: PiecewisePolynomial.from_numpy(path))
        if curve is not None:
            assert (np.diff(curve.breaks) > 0.0).all()
            assert np.isfinite(curve.coefficients).all()
            assert curve.coefficients.shape[1] == len(curve.breaks) - 1

    settings(max_examples=400)(
        given(DAMAGES.map(lambda damage: damaged_bytes(whole, damage)))(holds)
    )()

    @settings(max_examples=150)
    @given(chosen(["breaks", "coefficients", "more"]), integers(len(ARRAYS) - 1))
    def other(name: str, index: int) -> None:
        good = {"breaks": np.arange(3.0), "coefficients": np.ones((4, 2, 3))}
        file = io.BytesIO()
        np.savez(file, **{**good, name: ARRAYS[index]})
        holds(file.getvalue())

    other()
    tally.check()


def test_members_of_archives_may_be_called_anything(tmp_path: Path) -> None:
    tally = Tally(bad=60, good=0)
    path = tmp_path / "record.npz"

    @settings(max_examples=60)
    @given(
        st.lists(
            st.tuples(texts(min_size=1, max_size=6), binary(max_size=20)),
            max_size=4,
            unique_by=lambda m: zipfile.ZipInfo(m[0]).filename,
        )
    )
    def holds(members: list[tuple[str, bytes]]) -> None:
        with zipfile.ZipFile(path, "w") as archive:
            for name, content in members:
                archive.writestr(zipfile.ZipInfo(name), content)
        assert tally.outcome(lambda: Record.load(path)) is None

    holds()
    tally.check()


def test_any_change_of_a_plan_is_as_promised_or_refused_in_one_line(tmp_path: Path) -> None:
    tally = Tally(bad=250)
    arm = load_robot("planar5")
    start = State(q=arm.configuration(), v=np.zeros(arm.n_v))
    level = OcpLevel(name="effort", terms=(Effort(),))
    plan = Planner(
        single_phase(robot=arm, start=start, duration=1.0, n_steps=2, levels=[level], water=False)
    ).plan()
    for suffix in ("npz", "json"):
        path = plan.save(tmp_path / f"plan.{suffix}")
        whole = path.read_bytes()

        def holds(content: bytes, path: Path = path) -> None:
            path.write_bytes(content)
            loaded = tally.outcome(lambda: Plan.load(path))
            if loaded is not None:
                assert loaded.trajectory.q.shape == plan.trajectory.q.shape
                assert np.isfinite(loaded.trajectory.q).all()
                assert (np.diff(loaded.trajectory.t) > 0.0).all()
                loaded.to_record()

        settings(max_examples=300)(
            given(DAMAGES.map(lambda damage, whole=whole: damaged_bytes(whole, damage)))(
                lambda content: holds(content)
            )
        )()
    tally.check()
