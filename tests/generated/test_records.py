"""Any file in the place of a record or of a trajectory: read and as promised, or refused in one line."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from promises import DAMAGES, Damage, Tally, damaged, damaged_bytes

from uvms_ocp.record import Record
from uvms_ocp.report.compare import compare
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial

RECORDS = Path(__file__).parents[1] / "records"
KEPT = (
    "t",
    "q",
    "v",
    "x",
    "x_rate",
    "phase",
    "gates",
    "quantities",
    "status",
    "thrust",
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
    *(np.full((4, 13), np.nan), np.full(4, 7), np.arange(4.0)[::-1], np.array(["a"] * 4), np.array([None] * 4)),
    *(np.full((4, 14), 1e308), np.zeros(4, dtype=complex), np.zeros(4, dtype=">f8"), np.zeros(4, dtype="<M8[s]")),
)


def test_any_change_of_a_record_is_as_promised_or_refused_in_one_line(tmp_path: Path) -> None:
    tally, path = Tally(bad=600), tmp_path / "record.npz"
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
        @given(st.sampled_from(sorted(series)), st.sampled_from(range(len(ARRAYS))))
        def other(name: str, which: int) -> None:
            holds(written(meta, {**series, name: ARRAYS[which]}))  # noqa: B023 -- is called in this round of the loop

        other()
    tally.check()


def test_any_record_that_is_read_can_be_compared_or_is_refused(tmp_path: Path) -> None:
    """What a loader lets through, reports must bear."""
    path = tmp_path / "record.npz"
    kind = parts("run_v0_1.npz")
    tally = Tally(bad=0, good=21)

    @settings(max_examples=150)
    @given(damaged(kind["meta"], most=1))
    def holds(meta: Any) -> None:
        path.write_bytes(written(meta, kind["series"]))
        record = tally.outcome(lambda: Record.load(path))
        if record is not None:
            assert tally.outcome(lambda: compare(record, record)) != []

    holds()
    tally.check()


def test_any_change_of_a_trajectory_is_as_promised_or_refused_in_one_line(tmp_path: Path) -> None:
    tally, path = Tally(bad=250), tmp_path / "plan.npz"
    rng = np.random.default_rng(0)
    PiecewisePolynomial(breaks=np.arange(3.0), coefficients=rng.standard_normal((4, 2, 3))).to_numpy(path)
    whole = path.read_bytes()

    def holds(content: bytes) -> None:
        path.write_bytes(content)
        curve = tally.outcome(lambda: PiecewisePolynomial.from_numpy(path))
        if curve is not None:
            assert (np.diff(curve.breaks) > 0.0).all()
            assert np.isfinite(curve.coefficients).all()
            assert curve.coefficients.shape[1] == len(curve.breaks) - 1

    settings(max_examples=400)(given(DAMAGES.map(lambda damage: damaged_bytes(whole, damage)))(holds))()

    @settings(max_examples=150)
    @given(st.sampled_from(["breaks", "coefficients", "more"]), st.sampled_from(range(len(ARRAYS))))
    def other(name: str, which: int) -> None:
        good = {"breaks": np.arange(3.0), "coefficients": np.ones((4, 2, 3))}
        file = io.BytesIO()
        np.savez(file, **{**good, name: ARRAYS[which]})
        holds(file.getvalue())

    other()
    tally.check()


def test_members_of_archives_may_be_called_anything(tmp_path: Path) -> None:
    tally, path = Tally(bad=60, good=0), tmp_path / "record.npz"

    @settings(max_examples=60)
    @given(
        st.lists(
            st.tuples(st.text(min_size=1, max_size=6), st.binary(max_size=20)), max_size=4, unique_by=lambda m: m[0]
        )
    )
    def holds(members: list[tuple[str, bytes]]) -> None:
        with zipfile.ZipFile(path, "w") as archive:
            for name, content in members:
                archive.writestr(zipfile.ZipInfo(name), content)
        assert tally.outcome(lambda: Record.load(path)) is None

    holds()
    tally.check()
