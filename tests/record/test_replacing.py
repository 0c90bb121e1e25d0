"""A folder of results appears whole or not at all, and nothing in it that is not ours is
touched.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from uvms_ocp.errors import InvalidInput, OutputError
from uvms_ocp.record.output import claim_folder, recover_folder

NAMES = ("report.json", "figures/a.png")


def write(folder: Path, *names: str, text: str = "x") -> None:
    with claim_folder(folder, names) as claim, claim.staged() as staging:
        for name in names:
            (staging / name).parent.mkdir(parents=True, exist_ok=True)
            (staging / name).write_text(text)


def contents(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): path.read_text()
        for path in folder.rglob("*")
        if path.is_file() and ".uvms_ocp" not in path.parts
    }


def test_a_folder_appears_whole(tmp_path: Path) -> None:
    target = tmp_path / "a" / "b"
    with claim_folder(target, NAMES) as claim:
        with claim.staged() as staging:
            (staging / "figures").mkdir()
            (staging / "figures" / "a.png").write_text("new")
            assert contents(target) == {}
        assert claim.written() == [target / "figures" / "a.png"]
    assert contents(target) == {"figures/a.png": "new"}


def test_an_error_leaves_nothing_behind(tmp_path: Path) -> None:
    with (
        pytest.raises(RuntimeError),
        claim_folder(tmp_path / "a" / "b", NAMES) as claim,
        claim.staged() as staging,
    ):
        (staging / "half").write_text("x")
        raise RuntimeError
    assert not list(tmp_path.iterdir())


def test_files_of_an_earlier_command_go_and_foreign_files_and_folders_stay(tmp_path: Path) -> None:
    for folder in ("figures", "empty"):
        (tmp_path / folder).mkdir()
    (tmp_path / "figures" / "mine.png").write_text("mine")
    write(tmp_path, "old.npz", "figures/old.png", "plots/old.png", "empty/old.png", text="old")
    write(tmp_path, "report.json", text="new")
    assert contents(tmp_path) == {"report.json": "new", "figures/mine.png": "mine"}
    assert not (tmp_path / "plots").exists()
    assert (tmp_path / "empty").is_dir()


def test_what_the_user_removed_is_written_again_even_with_the_same_contents(tmp_path: Path) -> None:
    write(tmp_path, *NAMES)
    (tmp_path / "report.json").unlink()
    write(tmp_path, *NAMES)
    assert set(contents(tmp_path)) == set(NAMES)


def _edit(path: Path) -> None:
    path.write_text(path.read_text() + "edited")


def _same_size(path: Path) -> None:
    path.write_text("y" * len(path.read_text()))


def _link(path: Path) -> None:
    (path.parent.parent / "elsewhere").mkdir()
    path.rename(path.parent.parent / "elsewhere" / path.name)
    path.symlink_to(path.parent.parent / "elsewhere" / path.name)


def _folder(path: Path) -> None:
    path.unlink()
    (path / "inside").mkdir(parents=True)


CHANGES: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "edited": ("report.json", _edit, "report.json: changed since"),
    "edited_to_the_same_size": ("figures/a.png", _same_size, "a.png: changed since"),
    "edited_and_not_written_anew": ("extra.csv", _edit, "extra.csv: changed since"),
    "replaced_by_a_folder": ("report.json", _folder, "report.json: changed since"),
    "replaced_by_a_link": ("report.json", _link, "report.json: changed since"),
    "in_a_folder_that_is_a_link": ("figures", _link, "figures: a link, which is not followed"),
    "read_only": ("report.json", lambda path: path.chmod(0o444), "report.json: read-only"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_ours_that_was_changed_since_is_refused_before_the_work_and_kept(
    change: str, tmp_path: Path
) -> None:
    name, apply, message = CHANGES[change]
    target = tmp_path / "out"
    write(target, *NAMES, "extra.csv")
    apply(target / name)
    before = contents(tmp_path)
    with pytest.raises(InvalidInput, match=message) as caught, claim_folder(target, NAMES):
        pytest.fail("the work began")
    assert "\n" not in str(caught.value)
    assert contents(tmp_path) == before


@pytest.mark.parametrize("name", [*NAMES, "figures", "report.json/inside"])
def test_foreign_files_where_we_would_write_are_refused_before_the_work(
    name: str, tmp_path: Path
) -> None:
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / name).write_text("mine")
    with (
        pytest.raises(InvalidInput, match="move it away or choose another folder"),
        claim_folder(tmp_path, NAMES),
    ):
        pytest.fail("the work began")
    assert contents(tmp_path) == {name: "mine"}
    assert not (tmp_path / ".uvms_ocp").exists()


def test_a_foreign_file_that_appears_during_the_work_is_refused_then(tmp_path: Path) -> None:
    with (
        pytest.raises(InvalidInput, match=r"report\.json: not written by"),
        claim_folder(tmp_path, NAMES) as claim,
    ):
        (tmp_path / "report.json").write_text("mine")
        with claim.staged() as staging:
            (staging / "report.json").write_text("new")
    assert contents(tmp_path) == {"report.json": "mine"}
    assert not (tmp_path / ".uvms_ocp").exists()


def test_two_commands_do_not_write_to_one_folder(tmp_path: Path) -> None:
    with claim_folder(tmp_path, NAMES):
        with (
            pytest.raises(OutputError, match="another command writes there"),
            claim_folder(tmp_path, NAMES),
        ):
            pytest.fail("the work began")
        recover_folder(
            tmp_path
        )  # the results are those of an earlier command: reading needs no lock
    write(tmp_path, *NAMES)


@pytest.mark.skipif(sys.platform == "win32", reason="names of devices")
@pytest.mark.parametrize(
    "name", ["/dev/full/out", "/dev/full", "x" * 300, "a/" * 3000, "/proc/out"]
)
def test_what_cannot_be_a_folder_is_one_line(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with (
        pytest.raises(OutputError, match=r"cannot write there \(.*\); choose another folder"),
        claim_folder(Path(name), NAMES),
    ):
        pytest.fail("the work began")
    assert not list(tmp_path.iterdir())


OTHER_MANIFESTS = {
    "garbage": "no",
    "empty": "",
    "deep": "[" * 100_000,
    "lying": json.dumps(
        {"version": 1, "files": {"../mine": {"size": 1, "sha256": "x"}}, "folders": []}
    ),
    "absolute": json.dumps(
        {"version": 1, "files": {"/mine": {"size": 1, "sha256": "x"}}, "folders": []}
    ),
    "later": json.dumps({"version": 2, "files": {}, "folders": []}),
}


@pytest.mark.parametrize("name", ["manifest.json", "journal.json", "undoing.json"])
@pytest.mark.parametrize("kind", OTHER_MANIFESTS)
def test_a_damaged_manifest_or_journal_is_one_line(kind: str, name: str, tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("x")
    target = tmp_path / "out"
    write(target, *NAMES)
    (target / ".uvms_ocp" / name).write_text(OTHER_MANIFESTS[kind])
    before = contents(tmp_path)
    with (
        pytest.raises(InvalidInput, match=rf"{name}: damaged") as caught,
        claim_folder(target, NAMES),
    ):
        pytest.fail("the work began")
    assert "\n" not in str(caught.value)
    assert contents(tmp_path) == before


def test_a_manifest_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    (tmp_path / ".uvms_ocp" / "manifest.json").mkdir(parents=True)
    with (
        pytest.raises(OutputError, match=r"manifest.json: cannot read it \(.*\); choose another"),
        claim_folder(tmp_path, NAMES),
    ):
        pytest.fail("the work began")


def test_a_foreign_file_in_the_way_of_a_recovery_is_refused_and_kept(tmp_path: Path) -> None:
    program = (
        "import os, pathlib, sys; from uvms_ocp.record.output import claim_folder\nwith"
        " claim_folder(pathlib.Path(sys.argv[1]), ['b']) as claim:\n    with claim.staged() as"
        " staging:\n        (staging / 'b').write_text('new')\n        os.link = os.replace ="
        " lambda a, b: os._exit(9) if 'new' in str(a) else rename(a, b)\n        rename ="
        " os.rename\n"
    )
    assert (
        subprocess.run([sys.executable, "-c", program, str(tmp_path)], check=False).returncode == 9
    )
    (tmp_path / "b").write_text("mine")
    with pytest.raises(InvalidInput, match="b: in the way"):
        recover_folder(tmp_path)
    assert contents(tmp_path) == {"b": "mine"}
    os.rename(tmp_path / "b", tmp_path / "away")
    recover_folder(tmp_path)
    assert contents(tmp_path) == {"b": "new", "away": "mine"}
