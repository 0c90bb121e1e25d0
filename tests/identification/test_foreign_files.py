"""One table in the many spellings that files have gives the same numbers, or a line that names the
cure.
"""

from __future__ import annotations

import gzip
import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from uvms_ocp.errors import InvalidInput, NameNotFound, UvmsError
from uvms_ocp.identification import RecordingMapping, check_data_quality, read_recording
from uvms_ocp.identification.file_kinds import kind_of
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.tables import column_names, read_columns
from uvms_ocp.identification.text_tables import text_layout

T = np.arange(0.0, 20.0, 0.1)
XYZ = np.column_stack([0.3 * np.sin(T), 0.1 * np.cos(T), -2.0 + 0.2 * np.sin(0.5 * T)]).round(6)
ROWS = [[f"{t:.3f}", *(f"{x:.6f}" for x in row)] for t, row in zip(T, XYZ, strict=True)]
NAMES = ["t", "x", "y", "z"]
POSITION = {"time": "t", "columns": ["x", "y", "z"]}


def table(
    *,
    names: list[str] | None = NAMES,
    cell: str = ",",
    line: str = "\n",
    before: str = "",
    rows: list[list[str]] = ROWS,
) -> str:
    head = [cell.join(names)] if names else []
    return before + line.join([*head, *(cell.join(row) for row in rows)]) + line


def decimal_comma(rows: list[list[str]]) -> list[list[str]]:
    return [[cell.replace(".", ",") for cell in row] for row in rows]


def at_noon(rows: list[list[str]], form: str) -> list[list[str]]:
    return [
        [form.format(int(float(row[0])), round(1e3 * (float(row[0]) % 1.0))), *row[1:]]
        for row in rows
    ]


def past_midnight(rows: list[list[str]]) -> list[list[str]]:
    """Times of day of a dive that begins ten seconds before midnight."""
    clock = [divmod(86_390.0 + float(row[0]), 60.0) for row in rows]
    return [
        [f"{int(m) // 60 % 24:02d}:{int(m) % 60:02d}:{s:06.3f}", *r[1:]]
        for (m, s), r in zip(clock, rows, strict=True)
    ]


SPELLINGS: dict[str, bytes] = {
    "plain": table().encode(),
    "byte order mark": table().encode("utf-8-sig"),
    "utf-16": table().encode("utf-16"),
    "latin": table(before="Tauchgang März\n").encode("cp1252"),
    "carriage returns": table(line="\r").encode(),
    "windows": table(line="\r\n").encode(),
    "packed": gzip.compress(table().encode()),
    "semicolons": table(cell=";").encode(),
    "tabs": table(cell="\t").encode(),
    "blanks": table(cell="   ").encode(),
    "bars": table(cell=" | ").encode(),
    "decimal commas": table(cell=";", rows=decimal_comma(ROWS)).encode(),
    "decimal commas and tabs": table(cell="\t", rows=decimal_comma(ROWS)).encode(),
    "quotes": table(
        names=[f'"{n}"' for n in NAMES], rows=[[f'"{c}"' for c in row] for row in ROWS]
    ).encode(),
    "preamble": table(before="Log of dive 3,,,\nvehicle: BR2,,,\n\n").encode(),
    "comment": table(before="# dive 3\n% by hand\n").encode(),
    "header in a comment": table(names=None, before="# t,x,y,z\n").encode(),
    "title of asterisks": table(before="*** dive 3 ***,of,4,June\n").encode(),
    "title of asterisks below the header": table(
        rows=[["***", "dive", "of", "June"], *ROWS]
    ).encode(),
    "row of units": table(rows=[["s", "m", "m", "m"], *ROWS]).encode(),
    "units in brackets": table(names=[" T (s) ", "X [m]", "Y [m]", "Z [m]"]).encode(),
    "milliseconds by the header": table(
        names=["t [ms]", *NAMES[1:]],
        rows=[[f"{1e3 * float(row[0]):.0f}", *row[1:]] for row in ROWS],
    ).encode(),
    "millimetres by a row of units": table(
        rows=[
            ["s", "mm", "mm", "mm"],
            *([row[0], *(f"{1e3 * float(c):.3f}" for c in row[1:])] for row in ROWS),
        ]
    ).encode(),
    "ISO times": table(rows=at_noon(ROWS, "2024-06-01T12:00:{:02d}.{:03d}Z")).encode(),
    "times with a blank": table(
        rows=at_noon(ROWS, "2024-06-01 12:00:{:02d}.{:03d}+02:00")
    ).encode(),
    "times of day": table(rows=at_noon(ROWS, "12:00:{:02d}.{:03d}")).encode(),
    "times with a comma": table(
        cell=";", rows=at_noon(ROWS, "2024-06-01 12:00:{:02d},{:03d}")
    ).encode(),
    "times with slashes": table(rows=at_noon(ROWS, "2024/06/01 12:00:{:02d}.{:03d}")).encode(),
    "times without signs between": table(
        rows=at_noon(ROWS, "20240601T1200{:02d}.{:03d}Z")
    ).encode(),
    "times in names of files": table(rows=at_noon(ROWS, "2024-06-01_12-00-{:02d}.{:03d}")).encode(),
    "times of a zone by its name": table(
        rows=at_noon(ROWS, "2024-06-01 12:00:{:02d}.{:03d} UTC")
    ).encode(),
    "days first, with points": table(rows=at_noon(ROWS, "01.06.2024 12:00:{:02d}.{:03d}")).encode(),
    "half a day": table(rows=at_noon(ROWS, "12:00:{:02d}.{:03d} PM")).encode(),
    "milliseconds after a colon": table(rows=at_noon(ROWS, "12:00:{:02d}:{:03d}")).encode(),
    "zones that change": table(
        rows=at_noon(ROWS[:100], "2024-06-01T12:00:{:02d}.{:03d}+02:00")
        + at_noon(ROWS[100:], "2024-06-01T10:00:{:02d}.{:03d}Z")
    ).encode(),
    "minutes by the header": table(
        names=["t [min]", *NAMES[1:]],
        rows=[[f"{float(row[0]) / 60.0:.9f}", *row[1:]] for row in ROWS],
    ).encode(),
    "a row of units in brackets": table(rows=[["[s]", "[m]", "[m]", "[m]"], *ROWS]).encode(),
    "a row of units and of none": table(
        names=["mode", *NAMES, "volts"],
        rows=[["-", "sec", "metres", "m", "m", "V"], *(["3", *row, "16"] for row in ROWS)],
    ).encode(),
    "times of day past midnight": table(rows=past_midnight(ROWS)).encode(),
    "a column of words": table(
        names=["mode", *NAMES], rows=[["AUTO", *row] for row in ROWS]
    ).encode(),
    "more cells than names": table(rows=[[*row, ""] for row in ROWS]).encode(),
}


def recording_of(path: Path, mapping: dict[str, object], **more: object) -> Recording:
    return read_recording(path, RecordingMapping.model_validate({"channels": mapping, **more}))


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_every_spelling_gives_the_same_numbers(spelling: str, tmp_path: Path) -> None:
    path = tmp_path / "dive.csv"
    path.write_bytes(SPELLINGS[spelling])
    read = recording_of(path, {"position": POSITION}).channels["position"]
    np.testing.assert_allclose(read.t, T, atol=1e-6)
    np.testing.assert_allclose(read.values, XYZ, atol=1e-9)


@pytest.mark.parametrize(
    ("said", "factor"),
    [
        *(
            ("deg/s", 57.29578),
            ("°/s", 57.29578),
            ("deg s^-1", 57.29578),
            ("dps", 57.29578),
            ("Degrees/sec", 57.29578),
        ),
        *(("rad s-1", 1.0), ("rad·s⁻¹", 1.0), ("RAD/S", 1.0), ("", 1.0)),
    ],
)
def test_a_unit_is_known_however_it_is_spelled(said: str, factor: float, tmp_path: Path) -> None:
    rows = [[row[0], *(f"{factor * float(cell):.6f}" for cell in row[1:])] for row in ROWS]
    names = ["t", *(f"{axis} ({said})" for axis in "pqr")]
    (tmp_path / "dive.csv").write_text(table(names=names, rows=rows), encoding="utf-8")
    read = recording_of(
        tmp_path / "dive.csv", {"angular_velocity": {"time": "t", "columns": ["p", "q", "r"]}}
    )
    np.testing.assert_allclose(read.channels["angular_velocity"].values, XYZ, atol=1e-6)


@pytest.mark.parametrize(
    ("form", "written"),
    [("%m/%d/%Y %H:%M:%S.%f", "06/01/2024 12:00:{:02d}.{:03d}"), ("%M:%S.%f", "03:{:02d}.{:03d}")],
)
def test_a_form_of_times_that_two_may_mean_is_given(
    form: str, written: str, tmp_path: Path
) -> None:
    (tmp_path / "dive.csv").write_text(table(rows=at_noon(ROWS, written)))
    with pytest.raises(InvalidInput, match=r"is no number; .*others by `table: {time:"):
        recording_of(tmp_path / "dive.csv", {"position": POSITION})
    read = recording_of(
        tmp_path / "dive.csv", {"position": POSITION}, table={"time": form}
    ).channels["position"]
    np.testing.assert_allclose(read.t, T, atol=1e-6)
    (tmp_path / "dive.csv").write_text(
        table(rows=[*ROWS[:5], ["tomorrow", *ROWS[5][1:]], *ROWS[6:]])
    )
    with pytest.raises(InvalidInput, match=r"dive\.csv: .*'tomorrow'"):
        recording_of(tmp_path / "dive.csv", {"position": POSITION}, table={"time": form})


def test_seconds_and_nanoseconds_may_be_two_columns(tmp_path: Path) -> None:
    rows = [
        [f"{1_700_000_000 + int(float(row[0]))}", f"{round(1e9 * (float(row[0]) % 1.0))}", *row[1:]]
        for row in ROWS
    ]
    (tmp_path / "dive.csv").write_text(
        table(names=["stamp.sec", "stamp.nanosec", "x", "y", "z"], rows=rows)
    )
    read = recording_of(
        tmp_path / "dive.csv", {"position": POSITION | {"time": ["stamp.sec", "stamp.nanosec"]}}
    )
    np.testing.assert_allclose(read.channels["position"].t, T, atol=1e-6)


def test_columns_without_names_have_places(tmp_path: Path) -> None:
    (tmp_path / "dive.csv").write_text(table(names=None))
    with pytest.raises(NameNotFound, match="known: #1, #2, #3, #4"):
        recording_of(tmp_path / "dive.csv", {"position": POSITION})
    places = {"time": "#1", "columns": ["#2", "#3", "#4"]}
    np.testing.assert_array_equal(
        recording_of(tmp_path / "dive.csv", {"position": places}).channels["position"].values, XYZ
    )


@pytest.mark.parametrize("first", ["***,***,***,***", "***, 0.5,***, 0.25", "*** dive 3 ***,,0,0"])
def test_a_row_of_asterisks_is_no_header(first: str, tmp_path: Path) -> None:
    """They stand for numbers that found no room, or frame a title."""
    (tmp_path / "dive.csv").write_text(table(names=None, before=f"{first}\n"))
    read = recording_of(
        tmp_path / "dive.csv", {"position": {"time": "#1", "columns": ["#2", "#3", "#4"]}}
    )
    np.testing.assert_array_equal(read.channels["position"].values, XYZ)


@pytest.mark.parametrize(
    ("head", "time"),
    [("%t,x,y,z", "%t"), ("# t,x,y,z", "# t"), ("#t,x,y,z", "t"), ("t,x,y,z", "%t")],
)
def test_a_name_is_found_with_and_without_the_sign_of_a_comment(
    head: str, time: str, tmp_path: Path
) -> None:
    (tmp_path / "dive.csv").write_text(table(names=None, before=f"{head}\n"))
    read = recording_of(tmp_path / "dive.csv", {"position": POSITION | {"time": time}}).channels[
        "position"
    ]
    np.testing.assert_allclose(read.t, T, atol=1e-6)


def test_what_is_given_is_not_looked_for(tmp_path: Path) -> None:
    (tmp_path / "dive.txt").write_bytes(table(cell="|").encode("utf-16-le"))
    with pytest.raises(InvalidInput, match="binary"):
        text_layout(tmp_path / "dive.txt")
    read = recording_of(
        tmp_path / "dive.txt",
        {"position": POSITION},
        table={"encoding": "utf-16-le", "delimiter": "|"},
    )
    np.testing.assert_array_equal(read.channels["position"].values, XYZ)
    assert read.layout == (
        "dive.txt: utf-16-le, '|' between cells, decimals after '.', header in line 1",
    )


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"ULog\x01\x12\x35more", "cannot be read|uvms-ocp.ulog."),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "git lfs pull"),
        (b"$GPGGA,1,2,3\n", "NMEA"),
        (b"\xfd7zXZ\x00", "packed by xz"),
        (b"\x00\x01\x02" * 50, "binary"),
        (b'{"t": [0.0, 1.0}', "neither lines of JSON nor one object"),
        (b'{\n "t": 0.0\n}\n{\n "t": 1.0\n}\n', "neither lines of JSON.*jq -c"),
        (b"\x93NUMPY\x01\x00v\x00", "cannot be read"),
        (gzip.compress(b'{"t": 0.0}\n{"t": 1.0}\n', mtime=0), "packed by gzip.*unpack it"),
        (
            table(rows=at_noon(ROWS, "01/06/2024 12:00:{:02d}.{:03d}")).encode(),
            "is no number.*times as 2024-05-31T23:59:59.5",
        ),
        (
            table(names=["t", "x", "x", "z"]).encode(),
            r"2 columns are called 'x'; give one by its place: #2, #3",
        ),
        (
            table(rows=[*ROWS[:5], ["1_0", *ROWS[5][1:]], *ROWS[6:]]).encode(),
            "row 6, column 't': '1_0' is no number",
        ),
        (
            table(rows=[*ROWS[:5], ROWS[5][:2], *ROWS[6:]]).encode(),
            "row 6 has 2 cells; its table has 4 columns",
        ),
    ],
)
def test_what_cannot_be_read_names_its_kind_and_the_cure(
    content: bytes, message: str, tmp_path: Path
) -> None:
    (tmp_path / "dive.csv").write_bytes(content)
    with pytest.raises(InvalidInput, match=message) as error:
        recording_of(tmp_path / "dive.csv", {"position": {**POSITION, "columns": ["x", 0.0, "z"]}})
    assert "\n" not in str(error.value)


def test_a_few_bytes_do_not_hold_lines_without_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uvms_ocp.identification.text_files.MOST_ROWS", 1000)
    (tmp_path / "a.csv").write_bytes(gzip.compress(b"t,x,y,z\n" + b"#\n" * 100_000, mtime=0))
    with pytest.raises(InvalidInput, match="more than 1000 lines"):
        recording_of(tmp_path / "a.csv", {"position": POSITION})


def arrays_npz(path: Path) -> None:
    np.savez(path, t=T, pose=XYZ, name=np.array("dive 3"))


def arrays_mat(path: Path) -> None:
    from scipy.io import savemat

    savemat(path, {"t": T, "pose": XYZ, "log": {"depth": XYZ[:, 2]}})


def arrays_hdf5(path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason='needs pip install "uvms-ocp[files]"')
    with h5py.File(path, "w") as file:
        file["t"], file["pose"] = T, XYZ


@pytest.mark.parametrize(
    ("ending", "write"), [(".npz", arrays_npz), (".mat", arrays_mat), (".h5", arrays_hdf5)]
)
def test_named_arrays_are_tables(
    ending: str, write: Callable[[Path], None], tmp_path: Path
) -> None:
    write(tmp_path / f"dive{ending}")
    one = {"time": "t", "columns": [f"pose[{k}]" for k in range(3)]}
    read = recording_of(tmp_path / f"dive{ending}", {"position": one}).channels["position"]
    np.testing.assert_array_equal(read.t, T)
    np.testing.assert_array_equal(read.values, XYZ)
    with pytest.raises(NameNotFound, match=r"known: (t, )?pose\[0\], pose"):
        recording_of(
            tmp_path / f"dive{ending}", {"position": POSITION | {"columns": ["x", "y", "z"]}}
        )


def objects(*, indent: int | None, rows: bool) -> str:
    """Of JSON: arrays by names, or a list of rows, the last number of which is missing."""
    poses = [*XYZ[:-1].tolist(), [*XYZ[-1, :-1].tolist(), None]]
    if rows:
        return json.dumps(
            [
                {"t": t, "pose": dict(zip("xyz", xyz, strict=True))}
                for t, xyz in zip(T, poses, strict=True)
            ],
            indent=indent,
        )
    columns = dict(zip("xyz", np.array(poses, dtype=object).T.tolist(), strict=True))
    return json.dumps(
        {"vehicle": "dive 3", "t": T.tolist(), "pose": columns, "said": ["a", "b"]}, indent=indent
    )


@pytest.mark.parametrize("rows", [False, True])
@pytest.mark.parametrize("indent", [None, 1])
def test_one_object_of_json_is_a_table(indent: int | None, rows: bool, tmp_path: Path) -> None:
    """It was taken for lines of messages, of which the first was no JSON."""
    path = tmp_path / "dive.json"
    path.write_text(objects(indent=indent, rows=rows))
    read = recording_of(
        path, {"position": {"time": "t", "columns": [f"pose.{axis}" for axis in "xyz"]}}
    ).channels["position"]
    np.testing.assert_allclose(read.values, XYZ[:-1])
    assert kind_of(path) == "arrays"
    assert {"t", "pose.x", "pose.y", "pose.z"} == set(column_names(path))


@pytest.mark.parametrize("start", ["\ufeff", "\r\n", " "])
def test_json_is_known_however_it_begins(start: str, tmp_path: Path) -> None:
    path = tmp_path / "dive.json"
    rows = [{"t": 0.0, "pose": {"x": 1.0}}, {"t": 1.0}, {"t": 2.0, "pose": {"x": 3.0}}]
    path.write_text(
        start + json.dumps(rows, indent=1).replace("\n", "\r\n"), encoding="utf-8", newline=""
    )
    assert set(column_names(path)) == {"t", "pose.x"}
    np.testing.assert_array_equal(
        read_columns(path, ["t", "pose.x"]), [[0.0, 1.0], [1.0, np.nan], [2.0, 3.0]]
    )


def test_lines_of_json_may_begin_with_a_mark_of_their_order(tmp_path: Path) -> None:
    lines = [
        json.dumps({"type": "pose", "t": t, "x": list(xyz)})
        for t, xyz in zip(T, XYZ.tolist(), strict=True)
    ]
    (tmp_path / "dive.jsonl").write_text("\n".join(lines), encoding="utf-8-sig")
    one = {"topic": "pose", "time": "t", "columns": ["x"]}
    np.testing.assert_array_equal(
        recording_of(tmp_path / "dive.jsonl", {"position": one}).channels["position"].values, XYZ
    )


@pytest.mark.parametrize("turned", [False, True])
def test_an_array_without_a_name_has_columns_by_their_places(turned: bool, tmp_path: Path) -> None:
    array = np.column_stack([T, XYZ])
    np.save(tmp_path / "dive.npy", array.T if turned else array)
    one = {"time": "#1", "columns": ["#2", "#3", "-#4"]}
    read = recording_of(tmp_path / "dive.npy", {"position": one}).channels["position"]
    np.testing.assert_array_equal(read.t, T)
    np.testing.assert_array_equal(read.values, XYZ * [1.0, 1.0, -1.0])


def test_an_array_without_numbers_has_no_columns(tmp_path: Path) -> None:
    np.save(tmp_path / "dive.npy", np.zeros((0, 3)))
    with pytest.raises(UvmsError, match=r"dive\.npy"):
        recording_of(
            tmp_path / "dive.npy", {"position": {"time": 0.1, "columns": ["#1", "#2", "#3"]}}
        )


def test_a_period_is_a_number(tmp_path: Path) -> None:
    with pytest.raises(ValidationError):
        RecordingMapping.model_validate({"channels": {"position": POSITION | {"time": True}}})


@pytest.mark.parametrize("ending", [".csv", ".npy", ".jsonl"])
def test_rows_without_times_have_those_of_a_period(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"dive{ending}"
    if ending == ".npy":
        np.save(path, XYZ)
    elif ending == ".csv":
        path.write_text("".join(f"{x},{y},{z}\n" for x, y, z in XYZ))
    else:
        path.write_text("".join(f'{{"x": {x}, "y": {y}, "z": {z}}}\n' for x, y, z in XYZ))
    columns = ["x", "y", "z"] if ending == ".jsonl" else ["#1", "#2", "#3"]
    for period, unit in ((0.04, "s"), (40.0, "ms")):
        one = {"time": period, "time_unit": unit, "columns": columns}
        read = recording_of(path, {"position": one}).channels["position"]
        np.testing.assert_allclose(read.t, 0.04 * np.arange(len(XYZ)), atol=1e-12)
        np.testing.assert_allclose(read.values, XYZ)


def test_what_was_not_measured_is_not_called_dead(tmp_path: Path) -> None:
    (tmp_path / "tow.csv").write_text("t,u,v\n" + "".join(f"{t},{np.sin(t)},0.25\n" for t in T))
    one = {"time": "t", "columns": ["u", "v", 0.0]}
    doubts = check_data_quality(recording_of(tmp_path / "tow.csv", {"linear_velocity": one}))
    assert [issue.problem for issue in doubts if "dead" in issue.problem] == [
        "dead: y stay within 1e-05 m/s"
    ]


@pytest.mark.parametrize("burst", [2, 3])
def test_messages_in_bursts_are_not_taken_for_two_sensors(burst: int) -> None:
    """Of every ten messages some are held up until the last of them: nothing is there twice."""
    t = 0.05 * np.arange(600)
    held = t.copy()
    for k in range(burst - 1):
        held[8 - k :: 10] = t[9::10] - 1e-5 * (k + 1)
    values = np.column_stack([np.sin(t), np.cos(0.7 * t), 0.3 * np.sin(1.1 * t)])
    both = Recording(name="dive", channels={"position": Channel(t=held, values=values)})
    assert not any("two sensors" in issue.problem for issue in check_data_quality(both))


def test_a_workbook_is_a_table(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason='needs pip install "uvms-ocp[files]"')
    book = openpyxl.Workbook()
    for row in [["dive 3"], NAMES, *np.column_stack([T, XYZ]).tolist()]:
        book.active.append(row)
    book.save(tmp_path / "dive.xlsx")
    read = recording_of(tmp_path / "dive.xlsx", {"position": POSITION}).channels["position"]
    np.testing.assert_allclose(read.values, XYZ, atol=1e-12)


def test_of_a_workbook_the_first_sheet_with_a_table_is_read_and_it_is_said_of_which(
    tmp_path: Path,
) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason='needs pip install "uvms-ocp[files]"')
    book = openpyxl.Workbook()
    book.active.append(["Of three dives, see the other sheets."])
    for k in (1, 2):
        for row in [NAMES, *np.column_stack([T, k * XYZ]).tolist()]:
            (
                book[f"dive {k}"]
                if f"dive {k}" in book.sheetnames
                else book.create_sheet(f"dive {k}")
            ).append(row)
    book.save(tmp_path / "dive.xlsx")
    first = recording_of(tmp_path / "dive.xlsx", {"position": POSITION})
    np.testing.assert_allclose(first.channels["position"].values, XYZ, atol=1e-12)
    assert first.layout == ("dive.xlsx: sheet dive 1 of Sheet, dive 1, dive 2, header in line 1",)
    second = recording_of(tmp_path / "dive.xlsx", {"position": POSITION}, table={"sheet": "dive 2"})
    np.testing.assert_allclose(second.channels["position"].values, 2.0 * XYZ, atol=1e-12)
    with pytest.raises(
        NameNotFound, match=r"unknown sheet of dive\.xlsx 'dive 3'; known: Sheet, dive 1, dive 2"
    ):
        recording_of(tmp_path / "dive.xlsx", {"position": POSITION}, table={"sheet": "dive 3"})


def test_lines_of_json_have_topics_by_their_type(tmp_path: Path) -> None:
    lines = [
        f'{{"type": "velocity", "time": {1e3 * t}, "vx": {x}, "vy": {y}, "ok": true}}'
        for t, (x, y, _) in zip(T, XYZ, strict=True)
    ]
    (tmp_path / "dvl.json").write_text("\n".join(['{"type": "position_local", "ts": 1}', *lines]))
    one = {
        "topic": "velocity",
        "time": "time",
        "time_unit": "ms",
        "columns": ["vx", "-vy", 0.0],
        "rows": {"ok": 1},
    }
    read = recording_of(tmp_path / "dvl.json", {"linear_velocity": one}).channels["linear_velocity"]
    np.testing.assert_allclose(read.values, np.column_stack([XYZ[:, 0], -XYZ[:, 1], 0 * T]))
    with pytest.raises(NameNotFound, match="known: position_local, velocity"):
        recording_of(tmp_path / "dvl.json", {"linear_velocity": {**one, "topic": "speed"}})


@pytest.mark.parametrize(
    "end", ["", '\n{"t": 20.0, "x": 0.', '\n{"t": 20.0, "p": {"x": 0.0}', "\n"]
)
def test_lines_of_json_without_a_type_need_no_topic_and_the_last_may_break_off(
    end: str, tmp_path: Path
) -> None:
    lines = [
        f'{{"t": {t}, "x": {x}, "y": {y}, "z": {z}}}' for t, (x, y, z) in zip(T, XYZ, strict=True)
    ]
    (tmp_path / "dive.jsonl").write_text("\n".join(lines) + end)
    recording = recording_of(tmp_path / "dive.jsonl", {"position": POSITION})
    np.testing.assert_allclose(recording.channels["position"].values, XYZ)
    doubts = (
        (("position", f"the last line, {len(T) + 1}, breaks off and is left out"),)
        if end.strip()
        else ()
    )
    assert recording.issues_in_file == doubts
    (tmp_path / "dive.jsonl").write_text("\n".join([*lines[:5], '{"t": 0.', *lines[5:]]))
    with pytest.raises(InvalidInput, match="line 6 is no JSON"):
        recording_of(tmp_path / "dive.jsonl", {"position": POSITION})


@pytest.mark.parametrize(
    "wrong", ['{"t": 20.0, "x": nan, "y": 0.0, "z": 0.0}', '{"t": 20.0, "x": 0.0}}', "stopped"]
)
@pytest.mark.parametrize("end", ["", "\n"])
def test_a_whole_last_line_that_is_no_json_is_an_error_as_any_other_is(
    wrong: str, end: str, tmp_path: Path
) -> None:
    (tmp_path / "dive.jsonl").write_text(
        '{"t": 0.0, "x": 0.0, "y": 0.0, "z": 0.0}\n' * 3 + wrong + end
    )
    with pytest.raises(InvalidInput, match="line 4 is no JSON"):
        recording_of(tmp_path / "dive.jsonl", {"position": POSITION})


def test_lines_of_json_are_read_as_often_for_many_channels_as_for_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "dive.jsonl").write_text(
        "".join(f'{{"t": {t}, "x": {t}, "y": 0, "z": 0}}\n' for t in range(50))
    )
    read: list[str] = []
    monkeypatch.setattr(
        "uvms_ocp.identification.json_logs.load_json",
        lambda line: read.append(line) or json.loads(line),
    )
    channels: dict[str, object] = {"position": POSITION}
    recording_of(tmp_path / "dive.jsonl", channels)
    once = len(read)
    recording_of(
        tmp_path / "dive.jsonl",
        channels | {"linear_velocity": POSITION, "angular_velocity": POSITION},
    )
    assert len(read) == 2 * once


# Times of day past midnight, in all channels of a recording.

DIVE = 86_398.0 + 0.1 * np.arange(200)
SPEED = {"time": "t", "columns": ["u", 0.0, 0.0]}


def clock(t: float) -> str:
    return f"{int(t) // 3600 % 24:02d}:{int(t) // 60 % 60:02d}:{t % 60.0:06.3f}"


def speeds(times: np.ndarray) -> str:
    return table(names=["t", "u"], rows=[[clock(t), f"{t - DIVE[0]:.3f}"] for t in times])


def require_one_clock(recording: Recording) -> None:
    """Values are the times since the begin of the dive, and so are the times but for their
    origin.
    """
    for channel in recording.channels.values():
        np.testing.assert_allclose(
            channel.t - channel.values[:, 0], recording.channels["linear_velocity"].t[0], atol=1e-6
        )
    assert max(channel.t[-1] for channel in recording.channels.values()) < DIVE[-1] - DIVE[0] + 1e-6


def test_what_comes_after_midnight_alone_is_on_the_clock_of_what_passed_it_in_the_same_file(
    tmp_path: Path,
) -> None:
    rows = [
        [clock(t), f"{t - DIVE[0]:.3f}", f"{t - DIVE[0]:.3f}" if t > 86_400.5 else ""] for t in DIVE
    ]
    (tmp_path / "dive.csv").write_text(table(names=["t", "u", "x"], rows=rows))
    position = {"time": "t", "columns": ["x", 0.0, 0.0]}
    require_one_clock(
        recording_of(tmp_path / "dive.csv", {"linear_velocity": SPEED, "position": position})
    )


@pytest.mark.parametrize("part", [slice(0, 15), slice(30, 200)], ids=["before", "after"])
def test_other_files_are_on_the_clock_of_the_one_that_passed_midnight(
    part: slice, tmp_path: Path
) -> None:
    (tmp_path / "speed.csv").write_text(speeds(DIVE))
    (tmp_path / "position.csv").write_text(speeds(DIVE[part]))
    mapping = {
        "position": {**SPEED, "file": "position.csv"},
        "linear_velocity": {**SPEED, "file": "speed.csv"},
    }
    require_one_clock(recording_of(tmp_path, mapping))


@pytest.mark.parametrize("order", [(20, 19), (21, 20, 19), (20, 19, 22, 21)])
def test_rows_out_of_order_about_midnight_pass_it_once(
    order: tuple[int, ...], tmp_path: Path
) -> None:
    times = DIVE.copy()
    times[sorted(order)] = DIVE[list(order)]
    (tmp_path / "dive.csv").write_text(speeds(times))
    (tmp_path / "sorted.csv").write_text(speeds(DIVE))
    mapping = {"linear_velocity": SPEED}
    read, right = (
        recording_of(tmp_path / name, mapping).channels["linear_velocity"]
        for name in ("dive.csv", "sorted.csv")
    )
    np.testing.assert_allclose(read.t, right.t, atol=1e-6)
    np.testing.assert_array_equal(read.values, right.values)
    assert 0.0 < read.back < 1.0


def test_times_that_are_no_times_of_day_do_not_go_on_after_a_day(tmp_path: Path) -> None:
    """A clock that was set back by hours, or by a day that is longer than ours, is doubted as
    before.
    """
    for begin, again in ((50_000.0, 0.0), (90_000.0, 3_600.0)):
        t = np.concatenate([begin + T, again + T])
        rows = [[f"{x:.3f}", *row[1:]] for x, row in zip(t, [*ROWS, *ROWS], strict=True)]
        (tmp_path / "dive.csv").write_text(table(rows=rows))
        read = recording_of(tmp_path / "dive.csv", {"position": POSITION})
        assert any("times go back" in str(doubt) for doubt in check_data_quality(read))


# What a mapping says, and what would be ignored.


def written(tmp_path: Path, **columns: np.ndarray) -> Path:
    file = io.StringIO()
    np.savetxt(
        file,
        np.column_stack(list(columns.values())),
        delimiter=",",
        header=",".join(columns),
        comments="",
        fmt="%.17g",
    )
    (tmp_path / "dive.csv").write_text(file.getvalue())
    return tmp_path / "dive.csv"


def test_constants_signs_offsets_and_scales(tmp_path: Path) -> None:
    path = written(tmp_path, t=T, a=1500.0 + 100 * XYZ[:, 0], b=1500.0 + 100 * XYZ[:, 1])
    commands = {"time": "t", "columns": ["a", "-b"], "offset": [-1500.0, 1500.0], "scale": 0.01}
    read = recording_of(path, {"propeller_commands": commands}).channels["propeller_commands"]
    np.testing.assert_allclose(read.values, XYZ[:, :2] * [1.0, -1.0], atol=1e-9)
    position = {"time": "t", "columns": [0.0, 1.0, "-a"], "scale": [1.0, 2.0, 1e-3]}
    read = recording_of(path, {"position": position}).channels["position"]
    np.testing.assert_allclose(read.values[:, :2], [[0.0, 2.0]] * len(T))


def test_rows_choose_one_of_two_sensors_in_a_table_and_without_them_it_is_said(
    tmp_path: Path,
) -> None:
    twice = np.repeat(T, 2) + np.tile([0.0, 1e-5], len(T))
    depth = np.repeat(XYZ, 2, axis=0)
    depth[1::2, 2] -= 5.0
    path = written(
        tmp_path,
        t=twice,
        x=depth[:, 0],
        y=depth[:, 1],
        z=depth[:, 2],
        I=np.tile([0.0, 1.0], len(T)),
    )
    both = recording_of(path, {"position": POSITION})
    assert any(
        "two sensors? give rows: {NAME: VALUE}" in str(doubt) for doubt in check_data_quality(both)
    )
    one = recording_of(path, {"position": {**POSITION, "rows": {"I": 0}}})
    np.testing.assert_array_equal(one.channels["position"].values, XYZ)
    assert not check_data_quality(one)
    with pytest.raises(InvalidInput, match="no row has"):
        recording_of(path, {"position": {**POSITION, "rows": {"I": 7}}})


@pytest.mark.parametrize("ending", ["csv", "jsonl"])
def test_rows_are_chosen_by_words_too(ending: str, tmp_path: Path) -> None:
    """Such as names of sensors, and A and V of what is valid and what is not."""
    path = tmp_path / f"dive.{ending}"
    rows = [
        (t, *xyz, ("left", "right")[k % 2]) for k, (t, xyz) in enumerate(zip(T, XYZ, strict=True))
    ]
    if ending == "csv":
        path.write_text(
            "t,x,y,z,sensor name\n"
            + "".join(f"{t},{x},{y},{z}, {sensor}\n" for t, x, y, z, sensor in rows)
        )
    else:
        names = ("t", "x", "y", "z", "sensor name")
        path.write_text(
            "".join(json.dumps(dict(zip(names, row, strict=True))) + "\n" for row in rows)
        )
    read = recording_of(
        path, {"position": {**POSITION, "rows": {"sensor name": "right"}}}
    ).channels["position"]
    np.testing.assert_array_equal(read.values, XYZ[1::2])
    with pytest.raises(
        InvalidInput,
        match=(
            r"no row has {'sensor name': 'middle'}; leave rows out, or give values that there are"
        ),
    ):
        recording_of(path, {"position": {**POSITION, "rows": {"sensor name": "middle"}}})


@pytest.mark.parametrize(("share", "value"), [(0.01, -9999.0), (0.09, -32.768), (0.2, 65535.0)])
def test_values_that_stand_for_nothing_are_seen_and_left_out_on_demand(
    share: float, value: float, tmp_path: Path
) -> None:
    lost = np.random.default_rng(1).uniform(size=len(T)) < share
    given = np.where(lost[:, None], value, XYZ)
    path = written(tmp_path, t=T, x=given[:, 0], y=given[:, 1], z=given[:, 2])
    doubts = [
        str(doubt) for doubt in check_data_quality(recording_of(path, {"position": POSITION}))
    ]
    assert any(f"give missing: [{value:.10g}]" in doubt for doubt in doubts), doubts
    assert not any("is it in" in doubt for doubt in doubts), doubts
    read = recording_of(path, {"position": {**POSITION, "missing": [value]}}).channels["position"]
    np.testing.assert_array_equal(read.values, XYZ[~lost])


def test_messages_that_are_published_again_count_once(tmp_path: Path) -> None:
    times = (T[:, None] + [0.0, 4e-5, 3.5e-4]).ravel()
    again = np.repeat(XYZ, 3, axis=0)
    one = recording_of(
        written(tmp_path, t=times, x=again[:, 0], y=again[:, 1], z=again[:, 2]),
        {"position": POSITION},
    )
    np.testing.assert_array_equal(one.channels["position"].values, XYZ)
    np.testing.assert_allclose(one.channels["position"].t, T, atol=1e-12)
    assert one.channels["position"].echoes == 2 * len(T)
    assert not check_data_quality(one)


def test_velocities_in_the_world_are_turned_by_the_attitude(tmp_path: Path) -> None:
    yaw = 0.1 * T
    velocity = np.column_stack([np.cos(yaw), np.sin(yaw), 0.2 + 0 * T])  # along its own x axis
    path = written(tmp_path, t=T, yaw=yaw, u=velocity[:, 0], v=velocity[:, 1], w=velocity[:, 2])
    attitude = {"time": "t", "columns": [0.0, 0.0, "yaw"], "format": "rpy"}
    one = {"time": "t", "columns": ["u", "v", "w"], "frame": "W"}
    read = recording_of(path, {"attitude": attitude, "linear_velocity": one}).channels[
        "linear_velocity"
    ]
    np.testing.assert_allclose(read.values, [[1.0, 0.0, 0.2]] * len(T), atol=1e-9)
    with pytest.raises(InvalidInput, match="needs the attitude"):
        recording_of(path, {"linear_velocity": one})


def test_degrees_are_known_by_the_header_or_doubted(tmp_path: Path) -> None:
    yaw = 45.0 + 3.0 * T
    attitude = {"time": "t", "columns": [0.0, 0.0, "yaw"], "format": "rpy"}
    path = written(tmp_path, t=T, yaw=yaw)
    silent = recording_of(path, {"attitude": attitude})
    assert any("in deg?" in str(doubt) for doubt in check_data_quality(silent))
    right = (
        recording_of(path, {"attitude": {**attitude, "unit": "deg"}}).channels["attitude"].values
    )
    text = path.read_text().replace("yaw", "yaw [deg]")
    path.write_text(text)
    np.testing.assert_array_equal(
        recording_of(path, {"attitude": attitude}).channels["attitude"].values, right
    )


@pytest.mark.parametrize(
    ("low", "high", "word"),
    [
        (1300.0, 1700.0, "pulse widths"),
        (-0.9, 0.9, "shares of the largest"),
        (-153.0, -145.0, "never near 0"),
    ],
)
def test_commands_that_are_no_newtons_are_doubted(
    low: float, high: float, word: str, tmp_path: Path
) -> None:
    command = (low + high) / 2 + (high - low) / 2 * np.sin(T)
    read = recording_of(
        written(tmp_path, t=T, m=command), {"thrust": {"time": "t", "columns": ["m"]}}
    )
    assert any(word in str(doubt) for doubt in check_data_quality(read))
    newtons = recording_of(
        written(tmp_path, t=T, m=30.0 * np.sin(T)), {"thrust": {"time": "t", "columns": ["m"]}}
    )
    assert not any(word in str(doubt) for doubt in check_data_quality(newtons))


@pytest.mark.parametrize(
    ("thrusters", "word"),
    [
        (lambda k: np.where(T < 3.0, 0.0, 1500.0 + 200.0 * np.sin(T + k)), "pulse widths in us?"),
        (lambda k: np.where(T < 3.0, 0.0, 0.5 * np.sin(T + k)), "shares of the largest"),
        (lambda k: 32768.0 + 8000.0 * np.sin(T + k), "never near 0"),
        (lambda k: np.round(127.0 + 30.0 * np.sin(T + k)), "never near 0"),
        (lambda k: 20.0 + 15.0 * np.sin(T + k), ""),
    ],
)
def test_commands_of_thrusters_are_looked_at_while_they_are_on(
    thrusters: Callable[[int], np.ndarray], word: str, tmp_path: Path
) -> None:
    path = written(tmp_path, t=T, **{f"m{k}": thrusters(k) for k in range(6)})
    doubts = check_data_quality(
        recording_of(path, {"thrust": {"time": "t", "columns": [f"m{k}" for k in range(6)]}})
    )
    assert word in str(doubts) if word else not doubts


def test_pulses_of_0_are_seen_in_shares(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        t=T,
        **{f"m{k}": np.where(T < 3.0, 0.0, 1500.0 + 200.0 * np.sin(T + k)) for k in range(6)},
    )
    one = {"time": "t", "columns": [f"m{k}" for k in range(6)], "offset": -1500.0, "scale": 0.0025}
    (doubt,) = check_data_quality(recording_of(path, {"propeller_commands": one}))
    assert "3.75 in 15 % of its numbers, all others within 1: pulses of 0" in str(doubt)
    left = check_data_quality(recording_of(path, {"propeller_commands": {**one, "missing": [0]}}))
    assert "pulses of 0" not in str(left)


def test_a_unit_that_the_file_says_is_no_doubt_and_one_that_no_channel_has_is(
    tmp_path: Path,
) -> None:
    path = written(
        tmp_path,
        t=T,
        **{
            f"{axis} [{unit}]": 10.0 * XYZ[:, k]
            for k, (axis, unit) in enumerate(zip("pqr", ["deg/s"] * 3, strict=True))
        },
    )
    read = recording_of(path, {"angular_velocity": {"time": "t", "columns": ["p", "q", "r"]}})
    assert read.layout[1:] == ("angular_velocity: in deg/s, as the file says",)
    assert not check_data_quality(read)
    path.write_text(path.read_text().replace("deg/s", "rpm"))
    read = recording_of(path, {"angular_velocity": {"time": "t", "columns": ["p", "q", "r"]}})
    assert "in rpm as the file says, and taken for rad/s: give its unit, or a scale" in str(
        check_data_quality(read)
    )


@pytest.mark.parametrize(
    ("channel", "given", "message"),
    [
        ("linear_velocity", {"world": "NED"}, "world: NED given, which means nothing of it"),
        ("position", {"body": "FRD"}, "body: FRD given"),
        ("position", {"format": "rpy"}, "format: rpy given"),
        ("position", {"frame": "W"}, "frame: W given"),
        ("position", {"unit": "deg"}, r"unit 'deg' given; allowed: m, cm, mm"),
        ("attitude", {"unit": "deg"}, "unit 'deg' given; allowed: none"),
        (
            "position",
            {"columns": ["x", "y"]},
            "2 columns given; allowed: 3; a number may stand for one",
        ),
        ("position", {"columns": ["x", "y", "z", "x"]}, "4 columns given; allowed: 3"),
        ("position", {"scale": [1.0, 2.0]}, "2 numbers of scale given"),
        ("velocity", {}, "unknown channel 'velocity'.*Did you mean 'linear_velocity'"),
    ],
)
def test_a_key_that_means_nothing_is_refused(
    channel: str, given: dict[str, object], message: str, tmp_path: Path
) -> None:
    path = written(tmp_path, t=T, x=XYZ[:, 0], y=XYZ[:, 1], z=XYZ[:, 2])
    with pytest.raises((InvalidInput, NameNotFound), match=message):
        recording_of(path, {channel: {**POSITION, **given}})
