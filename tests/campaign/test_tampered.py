"""A campaign's folder that somebody altered is refused in one line, never believed."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from uvms_ocp.campaign.campaign import kept_campaign
from uvms_ocp.campaign.report import campaign_report
from uvms_ocp.cli.commands import app
from uvms_ocp.errors import InvalidInput, UvmsError

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")
STORED = Path(__file__).parents[1] / "records" / "campaign_v1"
PARTS = STORED / "rows" / "part-00000002.parquet"
Manifest = dict[str, Any]
Tampering = Callable[[np.random.Generator, Manifest, Any], Any]
"""Changes the manifest, or returns other rows."""

JUNK = (None, "", "x", -1, 0, 1.5, 1e400, True, [], {}, [1], {"a": 1}, "5", -40)


def value_of_the_manifest(rng: np.random.Generator, manifest: Manifest, rows: Any) -> None:
    name = rng.choice(
        [
            "runs",
            "sampler",
            "records",
            "parameters",
            "columns",
            "scenario",
            "variations",
            "name",
            "package",
            "version",
        ]
    )
    manifest[name] = JUNK[rng.integers(len(JUNK))]
    if isinstance(manifest[name], str) and name == "name":
        manifest[name] = 5


def key_of_the_manifest(rng: np.random.Generator, manifest: Manifest, rows: Any) -> None:
    name = rng.choice(sorted(manifest.keys() - {"version"}))
    manifest[f"{name}2" if rng.integers(2) else name.upper()] = manifest.pop(name)


def kind_of_a_column(rng: np.random.Generator, manifest: Manifest, rows: Any) -> None:
    name = rng.choice(sorted(manifest["columns"]))
    manifest["columns"][name] = rng.choice(
        [
            kind
            for kind in ("int", "float", "str", "bool", "os", "")
            if kind != manifest["columns"][name]
        ]
    )


def column_of_the_manifest(rng: np.random.Generator, manifest: Manifest, rows: Any) -> None:
    del manifest["columns"][rng.choice(sorted(manifest["columns"]))]


def seed_of_the_campaign(rng: np.random.Generator, manifest: Manifest, rows: Any) -> None:
    manifest["seed"] = int(rng.integers(1, 1000))


def number_of_runs(rng: np.random.Generator, manifest: Manifest, rows: Any) -> None:
    manifest["runs"] = int(rng.integers(-40, 6))


def run_numbers(rng: np.random.Generator, manifest: Manifest, rows: Any) -> Any:
    return rows.assign(run=rows["run"] + int(rng.choice([-40, -5, -1, 1, 5, 1000, 2**40])))


def one_run_number(rng: np.random.Generator, manifest: Manifest, rows: Any) -> Any:
    k, other_row = rng.choice(len(rows), 2, replace=False)
    return rows.assign(
        run=rows["run"].where(np.arange(len(rows)) != k, rows["run"].iloc[other_row])
    )


def missing_value(rng: np.random.Generator, manifest: Manifest, rows: Any) -> Any:
    name = rng.choice(["run", "seed", "start.x", "outcome", "success", "version"])
    return rows.assign(
        **{
            name: rows[name]
            .astype(object)
            .where(np.arange(len(rows)) != rng.integers(len(rows)), None)
        }
    )


def kind_of_the_rows(rng: np.random.Generator, manifest: Manifest, rows: Any) -> Any:
    name = rng.choice(rows.columns)
    return rows.assign(
        **{
            name: [f"{value}!" for value in rows[name]]
            if rows[name].dtype != object
            else np.arange(len(rows))
        }
    )


def column_of_the_rows(rng: np.random.Generator, manifest: Manifest, rows: Any) -> Any:
    name = rng.choice(rows.columns)
    return rows.drop(columns=name) if rng.integers(2) else rows.rename(columns={name: f"{name} "})


def another_column(rng: np.random.Generator, manifest: Manifest, rows: Any) -> Any:
    return rows.assign(more=1.0)


def row_that_is_there_twice(rng: np.random.Generator, manifest: Manifest, rows: Any) -> Any:
    again = rows.iloc[[int(rng.integers(len(rows)))]].assign(duration_s=float(rng.random()))
    return rows.loc[[*rows.index, *again.index]].assign(
        duration_s=[*rows["duration_s"], *again["duration_s"]]
    )


def status(rng: np.random.Generator, manifest: Manifest, rows: Any) -> Any:
    return rows.assign(
        outcome=str(
            rng.choice(["solved", "", "Completed", "completed ", "<b>completed</b>", "os:system"])
        ),
        success=False,
    )


def success(rng: np.random.Generator, manifest: Manifest, rows: Any) -> Any:
    return rows.assign(success=~rows["success"].astype(bool))


def not_finite(rng: np.random.Generator, manifest: Manifest, rows: Any) -> Any:
    name = rng.choice([name for name in rows.columns if rows[name].dtype == float])
    return rows.assign(**{name: float(rng.choice([np.inf, -np.inf]))})


def parameter_not_finite(rng: np.random.Generator, manifest: Manifest, rows: Any) -> Any:
    name = rng.choice(list(manifest["parameters"]))
    return rows.assign(**{name: float(rng.choice([np.inf, -np.inf]))})


def time_below_zero(rng: np.random.Generator, manifest: Manifest, rows: Any) -> Any:
    return rows.assign(wall_s=-float(rng.uniform(0.1, 10.0)))


def seed_of_a_run(rng: np.random.Generator, manifest: Manifest, rows: Any) -> Any:
    return rows.assign(seed=rows["seed"] + (np.arange(len(rows)) == rng.integers(len(rows))))


def version_of_a_run(rng: np.random.Generator, manifest: Manifest, rows: Any) -> Any:
    return rows.assign(version="9.9")


def words(rng: np.random.Generator, manifest: Manifest, rows: Any) -> None:
    part = rng.choice(["scenario", "variations"])
    name = rng.choice(["words", "attribute", "options", "files"])
    manifest[part][name] = [
        None,
        5,
        "./other.py",
        "/etc/hostname.py:x",
        ["a"],
        {"../../a.py": "0"},
        {"": 1},
    ][rng.integers(7)]


def distribution(rng: np.random.Generator, manifest: Manifest, rows: Any) -> None:
    manifest["parameters"]["start.x"] = str(
        rng.choice(["Normal(mean=0.0, sigma=0.2)", "", "Uniform(0, 1)"])
    )


TAMPERINGS: tuple[Tampering, ...] = (
    value_of_the_manifest,
    key_of_the_manifest,
    kind_of_a_column,
    column_of_the_manifest,
    seed_of_the_campaign,
    number_of_runs,
    run_numbers,
    one_run_number,
    missing_value,
    kind_of_the_rows,
    column_of_the_rows,
    another_column,
    row_that_is_there_twice,
    status,
    success,
    not_finite,
    seed_of_a_run,
    version_of_a_run,
    words,
    distribution,
    parameter_not_finite,
    time_below_zero,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy whose manifest and rows are written anew for each tampering."""
    target = tmp_path_factory.mktemp("tampered") / "campaign"
    shutil.copytree(STORED, target, copy_function=shutil.copyfile)
    return target


def tampered(folder: Path, tampering: Tampering, draw: int) -> str:
    """What was altered."""
    rng = np.random.default_rng([TAMPERINGS.index(tampering), draw])
    before = (STORED / "campaign.json").read_text()
    manifest = json.loads(before)
    rows = pq.read_table(PARTS).to_pandas()
    changed = tampering(rng, manifest, rows)
    (folder / "campaign.json").write_text(json.dumps(manifest))
    target = folder / "rows" / PARTS.name
    if changed is None:
        shutil.copyfile(PARTS, target)
    else:
        pq.write_table(pa.Table.from_pandas(changed, preserve_index=False), target)
    return f"{tampering.__name__} {draw}: {json.dumps(manifest)[:300]}"


@pytest.mark.sampled
@pytest.mark.parametrize("tampering", TAMPERINGS, ids=lambda one: one.__name__)
def test_what_was_altered_is_refused_in_one_line(tampering: Tampering, folder: Path) -> None:
    for draw in range(10):
        what = tampered(folder, tampering, draw)
        with pytest.raises(UvmsError) as error:
            campaign_report(folder)
            kept_campaign(folder)
            pytest.fail(f"believed: {what}")
        assert "\n" not in str(error.value), what
        assert len(str(error.value)) < 600, what


def test_the_folder_as_it_was_is_believed_and_a_command_ends_with_2_where_it_was_altered(
    folder: Path,
) -> None:
    shutil.copyfile(STORED / "campaign.json", folder / "campaign.json")
    shutil.copyfile(PARTS, folder / "rows" / PARTS.name)
    assert campaign_report(folder)["finished"] == 6
    assert kept_campaign(folder).runs == 6
    tampered(folder, run_numbers, 0)
    with pytest.raises(InvalidInput):
        CliRunner().invoke(app, ["campaign", str(folder), "--report"], catch_exceptions=False)
