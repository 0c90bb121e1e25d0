"""The command line: exit codes, one-line errors, nothing half-written."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from command_line import called
from compiler import needs_compiler

from uvms_ocp.cli.result_folders import default_folder
from uvms_ocp.record.record import Record
from uvms_ocp.robot.loading import robot_folder
from uvms_ocp.scenario.cases.bluerov import reach


def cli(*arguments: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """A command as a process of its own."""
    command = [sys.executable, "-m", "uvms_ocp", *arguments]
    env = os.environ | environment
    return subprocess.run(
        command, cwd=cwd, env=env, capture_output=True, text=True, timeout=300, check=False
    )


@pytest.fixture(scope="module")
def complete(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[subprocess.CompletedProcess[str], Path]:
    folder = tmp_path_factory.mktemp("run")
    return cli("run", "--json", cwd=folder), folder / "uvms_runs" / "case1-dynamic-active_set"


def test_run_completes_the_mission(complete: tuple[subprocess.CompletedProcess[str], Path]) -> None:
    process, _ = complete
    assert process.returncode == 0, process.stderr
    assert json.loads(process.stdout)["completed"] is True


def test_json_is_all_that_stdout_holds(
    complete: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    process, folder = complete
    assert json.loads(process.stdout) == json.loads((folder / "report.json").read_text())
    assert "mission complete" in process.stderr


def test_the_report_has_the_documented_keys(
    complete: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    report = json.loads(complete[0].stdout)
    assert set(report) >= {
        "completed",
        "phases",
        "tool_position_error_m",
        "tool_orientation_error_rad",
        "vehicle_drift_in_last_phase_m",
        "max_velocity_step",
        "tick_us",
        "wall_s",
        "simulated_s",
        "versions",
    }
    assert set(report["tick_us"]) == {"p50", "p99", "max"}
    assert all({"name", "start_s", "end_s", "reason"} <= set(phase) for phase in report["phases"])


def test_run_writes_record_report_figures_and_scene(
    complete: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    _, folder = complete
    assert {path.name for path in folder.iterdir()} == {
        "record.npz",
        "report.json",
        "figures",
        "scene.html",
        ".uvms_ocp",
    }
    assert len(list((folder / "figures").glob("*.png"))) >= 5
    assert "<html" in (folder / "scene.html").read_text()[:2000].lower()
    record = Record.load(folder / "record.npz")
    assert np.isfinite(record["q"]).all()


@pytest.mark.slow
def test_a_mission_out_of_time_exits_with_3_and_says_why(tmp_path: Path) -> None:
    process = cli("run", "--duration", "0.5", "--out", "short", "--json", cwd=tmp_path)
    assert process.returncode == 3
    report = json.loads(process.stdout)
    assert "PC.position_error" in report["phases"][-1]["reason"]
    assert (tmp_path / "short" / "report.json").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "case9"], "unknown scenario 'case9'; known: case1"),
        (
            ["run", "--solver", "lexpq"],
            "unknown solver 'lexpq'; known: active_set, lexqp, icat. Did you mean 'lexqp'?",
        ),
        (["run", "--robot", "girona"], "unknown robot 'girona'; known: bluerov2, bluerov2_alpha5"),
        (["run", "--plant", "wet"], "unknown plant 'wet'; known: dynamic, kinematic"),
        (["run", "--duration", "-1"], "duration = -1.0 s; give a finite time > 0"),
        (["run", "--duration", "nan"], "duration = nan"),
        (["run", "--out", "taken/out"], "cannot write there"),
        (["run", "--out", ""], "names no folder"),
        (["plan", "curve", "--to", "3", "0", "0", "--out", ""], "names no folder"),
        (["export", "controller", "case1", " "], "names no folder"),
        (["run", "--out", "a\nb"], r"'a\nb' has control characters; give a folder without"),
        (
            ["run", "--current", "300", "0", "0", "--plant", "kinematic"],
            "300 m/s; give at most 10 m/s",
        ),
        (["check-robot", "girona"], "unknown robot 'girona'; known: bluerov2, bluerov2_alpha5"),
    ],
)
def test_mistakes_get_one_line_and_exit_code_2(
    arguments: list[str], message: str, tmp_path: Path
) -> None:
    (tmp_path / "taken").write_text("a file, not a folder")
    process = called(*arguments, cwd=tmp_path)
    assert process.returncode == 2
    assert message in process.stderr
    assert len(process.stderr.strip().splitlines()) == 1
    assert process.stdout == ""
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


@pytest.mark.slow
def test_a_solver_that_is_not_chosen_is_the_scenarios_own(tmp_path: Path) -> None:
    options = ("--seed", "4", "--noise", "--duration", "0.1")
    process = cli("run", "reach", *options, "--force", "--json", cwd=tmp_path)
    assert process.returncode == 3, process.stderr
    report = json.loads(process.stdout)
    assert report["solver"] == type(reach().solver).__name__
    assert (
        tmp_path / "uvms_runs" / "reach-dynamic-active_set-noise-seed4-duration0.1" / "report.json"
    ).exists()


def test_options_that_do_not_parse_exit_with_2(tmp_path: Path) -> None:
    assert called("run", "--duration", "soon", cwd=tmp_path).returncode == 2
    assert called("fly", cwd=tmp_path).returncode == 2


def test_list_names_everything(tmp_path: Path) -> None:
    process = called("list", "--json", cwd=tmp_path)
    parameters = json.loads(process.stdout)
    assert process.returncode == 0
    assert "case1" in parameters["scenarios"]
    assert "girona_maris7_full" in parameters["robots"]
    assert set(parameters["solvers"]) >= {"active_set", "lexqp", "icat"}


@pytest.mark.slow
def test_check_refuses_an_unreachable_goal_with_figures(tmp_path: Path) -> None:
    process = called("check", "case1_unreachable", "--plant", "kinematic", "--json", cwd=tmp_path)
    assert process.returncode == 2
    report = json.loads(process.stdout)
    assert report["accepted"] is False
    assert report["findings"][0]["figures"]["missing_worst_m"] > 0.3
    assert "misses the goal" in process.stderr


@pytest.mark.slow
def test_check_flags_a_seabed_above_the_way_point(tmp_path: Path) -> None:
    process = called("check", "case1", "--seabed", "-39", cwd=tmp_path)
    assert process.returncode == 2
    output = " ".join(process.stdout.split())
    assert "MAC keeps the vehicle 0.33 m above its way point" in output
    assert "the goal of T, z = -39.886 m, is 0.89 m below the seafloor" in output


@pytest.mark.slow
def test_run_refuses_what_check_refuses_unless_forced(tmp_path: Path) -> None:
    arguments = (
        "run",
        "case1_unreachable",
        "--plant",
        "kinematic",
        "--duration",
        "0.3",
        "--out",
        "here",
    )
    process = cli(*arguments, cwd=tmp_path)
    assert process.returncode == 2
    assert "pre-flight refuses case1_unreachable" in process.stderr
    assert not (tmp_path / "here").exists()
    assert cli(*arguments, "--force", cwd=tmp_path).returncode == 3
    assert (tmp_path / "here" / "record.npz").exists()


def test_two_runs_compare_from_their_folders(
    complete: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    _, folder = complete
    process = called("compare", str(folder), str(folder), "--json", cwd=folder.parent)
    assert process.returncode == 0, process.stderr
    rows = {row["figure"]: row for row in json.loads(process.stdout)}
    assert rows["duration_s"]["change"] == 0.0


def test_a_mission_prints_as_a_table_or_a_diagram(tmp_path: Path) -> None:
    assert "MAC   [R,I,S]      1    1    .    ." in called("mission", "case1", cwd=tmp_path).stdout
    assert called("mission", "case1", "--mermaid", cwd=tmp_path).stdout.startswith(
        "stateDiagram-v2"
    )


@needs_compiler
def test_export_writes_the_controller_whole_or_not_at_all(tmp_path: Path) -> None:
    process = called("export", "controller", "case1", "c", "--plant", "kinematic", cwd=tmp_path)
    assert process.returncode == 0, process.stderr
    assert {path.name for path in (tmp_path / "c").iterdir()} >= {
        "case1_controller.h",
        "case1_controller.c",
        "case1_replay.c",
        "case1_recorded.bin",
        "CMakeLists.txt",
        "README.md",
    }
    assert called("export", "controller", "case9", "d", cwd=tmp_path).returncode == 2
    assert not (tmp_path / "d").exists()
    (tmp_path / "file").write_text("")
    refused = called("export", "controller", "case1", "file/c", cwd=tmp_path)
    assert refused.returncode == 2
    assert "cannot write there" in refused.stderr
    assert "--out" not in refused.stderr  # it has no such option


@pytest.mark.slow
def test_without_a_compiler_a_run_works_and_says_so_once(tmp_path: Path) -> None:
    options = ("--plant", "kinematic", "--duration", "0.1", "--json")
    process = cli("run", *options, cwd=tmp_path, PATH=str(tmp_path), CC="")
    assert process.returncode == 3
    assert json.loads(process.stdout)["simulated_s"] == pytest.approx(0.1)
    assert (
        process.stderr.count(
            "no C compiler found (CC, cc, gcc, clang): everything works, only slower"
        )
        == 1
    )


@pytest.mark.slow
@needs_compiler
def test_without_a_folder_for_compiled_libraries_a_run_works_and_says_so_once(
    tmp_path: Path,
) -> None:
    (tmp_path / "file").write_text("")
    options = ("--plant", "kinematic", "--duration", "0.1", "--json")
    process = cli("run", *options, cwd=tmp_path, UVMS_OCP_CACHE=str(tmp_path / "file" / "cache"))
    assert process.returncode == 3
    assert json.loads(process.stdout)["simulated_s"] == pytest.approx(0.1)
    told = (
        f"cache {tmp_path}/file/cache cannot be used (Not a directory): everything works, only"
        " slower"
    )
    assert process.stderr.splitlines().count(told) == process.stderr.count("slower") == 1


@pytest.mark.slow
def test_the_old_spelling_of_the_active_set_solver_is_understood(tmp_path: Path) -> None:
    options = ("run", "--plant", "kinematic", "--duration", "0.1", "--solver", "lexls", "--json")
    process = cli(*options, cwd=tmp_path)
    assert process.returncode == 3, process.stderr
    assert json.loads(process.stdout)["solver"] == "LexicographicActiveSet"
    assert process.stderr.splitlines().count("--solver lexls is now --solver active_set") == 1
    assert (
        tmp_path / "uvms_runs" / "case1-kinematic-active_set-duration0.1" / "report.json"
    ).exists()


def test_a_robot_is_checked_by_name_as_by_its_folder(tmp_path: Path) -> None:
    by_name, by_path = (
        called("check-robot", words, "--json", cwd=tmp_path)
        for words in ("planar5", str(robot_folder("planar5")))
    )
    assert by_name.returncode == 0, by_name.stderr
    assert by_name.stdout == by_path.stdout


def test_the_help_of_a_command_tells_users_nothing_of_exceptions(tmp_path: Path) -> None:
    text = called("run", "--help", cwd=tmp_path).stdout
    assert "--force" in text
    assert "InvalidInput" not in text


def test_the_version_is_that_of_the_package(tmp_path: Path) -> None:
    assert cli("--version", cwd=tmp_path).stdout == f"uvms-ocp {version('uvms-ocp')}\n"


def test_a_foreign_file_is_refused_before_the_simulation_and_kept(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "scene.html").write_text("mine")
    for arguments in (
        ["run", "--out", "out"],
        ["plan", "curve", "--to", "1", "0", "0", "--out", "out"],
    ):
        process = called(*arguments, cwd=tmp_path)
        assert process.returncode == 2
        assert process.stdout == ""
        assert process.stderr.splitlines() == [
            (
                "error: out/scene.html: not written by an earlier command; move it away or choose"
                " another folder"
            )
        ]
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["scene.html"]
    assert (tmp_path / "out" / "scene.html").read_text() == "mine"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is full")
def test_a_full_disk_behind_stdout_is_one_line(tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        process = subprocess.run(
            [sys.executable, "-m", "uvms_ocp", "list", "--json"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert process.returncode == 2
    assert process.stderr.splitlines() == ["error: [Errno 28] No space left on device"]


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="closes a stream as a POSIX shell does")
def test_a_closed_stdout_is_no_error(tmp_path: Path) -> None:
    words = ["sh", "-c", 'exec "$0" -m uvms_ocp list >&-', sys.executable]
    process = subprocess.run(words, cwd=tmp_path, stderr=subprocess.PIPE, text=True, check=False)
    assert (process.returncode, process.stderr) == (0, "")


def test_default_folders_of_what_differs_differ() -> None:
    options = [
        {},
        {"robot": "planar5"},
        {"current": (0.3, 0.0, 0.0)},
        {"current": (0.0, 0.3, 0.0)},
        {"noise": True},
        {"noise": False},
        {"seed": 4},
        {"noise": True, "seed": 4},
        {"seabed": -40.05},
        {"duration": 0.1},
        {"duration": 0.1000000001},
    ]
    names = [
        default_folder(("case1", "dynamic", "active_set"), case_options).name
        for case_options in options
    ]
    assert names[7] == "case1-dynamic-active_set-noise-seed4"
    assert len(set(names)) == len(options)
