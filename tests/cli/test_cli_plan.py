"""The planning commands: what they write, and their exit codes."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path
from subprocess import CompletedProcess

import numpy as np
import pytest
from command_line import called

from uvms_ocp.record.record import Record
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial

OBSTACLES = """
obstacles:
  - {name: pile, shape: cylinder, size: [0.2, 2.0], position: [1.2, 1.3, 0.0]}
  - {name: crate, shape: box, size: [0.4, 0.4, 0.4], position: [4.5, 0.0, 0.0], rpy: [0.0, 0.0, 0.3]}
  - {name: pipe, shape: capsule, size: [0.1, 1.0], position: [0.0, 3.0, 0.0]}
"""
TOOL = (3.0, 0.8, -0.6)

Run = tuple[CompletedProcess[str], Path]


def plan(*arguments: str, cwd: Path) -> CompletedProcess[str]:
    return called("plan", *arguments, cwd=cwd)


def results(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file() and ".uvms_ocp" not in path.parts]


@pytest.fixture(scope="module")
def around(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("plan")
    (folder / "obstacles.yaml").write_text(OBSTACLES)
    goal = (
        "--tool",
        *map(str, TOOL),
        "--sphere",
        "1.7,0.3,-0.4,0.35",
        "--obstacles",
        "obstacles.yaml",
    )
    return plan("curve", *goal, "--out", "out", "--json", cwd=folder), folder / "out"


def test_a_goal_behind_an_obstacle_is_reached_free_of_collision(around: Run) -> None:
    process, _ = around
    report = json.loads(process.stdout)
    assert process.returncode == 0, process.stderr
    assert report["collision_free"] is True
    assert report["min_clearance_m"] > 0.0
    assert 0.0 <= report["min_clearance_at_s"] <= report["duration_s"]
    assert report["tool_error"]["position_m"] < 1e-5


def test_what_is_kept_from_each_obstacle_and_between_links_are_numbers_of_their_own(
    around: Run,
) -> None:
    """Links that are near each other by design would hide what a plan keeps from a rock."""
    process, _ = around
    report = json.loads(process.stdout)
    clearances = report["clearances_m"]
    assert set(clearances) == {*(item["name"] for item in report["obstacles"]), "its own links"}
    assert min(clearances.values()) == pytest.approx(report["min_clearance_m"], abs=1e-3)
    assert f"{clearances['its own links']:.3g} m to its own links" in " ".join(
        process.stderr.split()
    )


def test_every_output_is_written(around: Run) -> None:
    _, folder = around
    files = {str(path.relative_to(folder)) for path in results(folder)}
    figures = {f"figures/{name}.png" for name in ("vehicle_motion", "joint_motion", "clearance")}
    assert files == figures | {"plan.npz", "plan.csv", "record.npz", "report.json", "scene.html"}


def test_json_is_all_that_stdout_holds(around: Run) -> None:
    process, folder = around
    assert json.loads(process.stdout) == json.loads((folder / "report.json").read_text())
    assert "free of collision" in process.stderr


def test_the_plan_ends_with_the_tool_at_its_goal_and_keeps_the_limits(around: Run) -> None:
    process, folder = around
    report = json.loads(process.stdout)
    curve = PiecewisePolynomial.from_numpy(folder / "plan.npz")
    record = Record.load(folder / "record.npz")
    robot = load_robot("girona_maris7_full")
    np.testing.assert_allclose(
        Kinematics(robot, record["q"][-1]).pose("tool").translation, TOOL, atol=1e-5
    )
    np.testing.assert_allclose(curve.evaluate(curve.end), report["goal"], atol=1e-9)
    ratios = [ratio for axes in report["limit_ratios"].values() for ratio in axes.values()]
    assert max(ratios) == pytest.approx(1.0, abs=0.01)


def test_the_table_names_its_axes(around: Run) -> None:
    with (around[1] / "plan.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0][:2] == ["t", "d0_x"]
    assert rows[0][-1] == "d4_joint7"
    assert len(rows) > 100


def test_the_recorded_velocity_is_the_derivative_of_the_configuration(around: Run) -> None:
    record = Record.load(around[1] / "record.npz")
    q = record["q"]
    v = record["v"]
    t = record["t"]
    np.testing.assert_allclose(np.gradient(q[:, 7:], t, axis=0)[1:-1], v[1:-1, 6:], atol=1e-3)


def test_the_scene_holds_the_obstacles(around: Run) -> None:
    record = Record.load(around[1] / "record.npz")
    assert [item.name for item in record.meta.surroundings.obstacles] == [
        "pile",
        "crate",
        "pipe",
        "sphere1",
    ]
    assert "<html" in (around[1] / "scene.html").read_text()[:2000].lower()


def test_a_fixed_robot_moves_its_joints_alone(tmp_path: Path) -> None:
    goal = ("--joint", "theta1=1.2", "--joint", "x0=0.5", "--robot", "planar5")
    process = plan("curve", *goal, "--out", "out", "--json", cwd=tmp_path)
    assert process.returncode == 0, process.stderr
    assert json.loads(process.stdout)["goal"] == pytest.approx([0.5, 0.0, 0.0, 1.2, -1.0])


@pytest.mark.slow
def test_a_goal_that_no_posture_reaches_exits_with_3_and_advice(tmp_path: Path) -> None:
    process = plan(
        "curve", "--tool", "9", "0", "0", "--axes", "joints", "--out", "out", "--json", cwd=tmp_path
    )
    assert process.returncode == 3
    report = json.loads(process.stdout)
    assert report["collision_free"] is False
    assert "move the goal" in report["advice"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"report.json", ".uvms_ocp"}


OCP_OF_TWO = ("ocp", "--steps", "2")
FAILING = {  # the plan, and the method by which another one was found before
    "infeasible": ((*OCP_OF_TWO, "--to", "2", "0", "0", "--current", "3", "0", "0"), ("curve",)),
    "unreached": (("curve", "--tool", "9", "0", "0", "--axes", "joints"), OCP_OF_TWO),
}


@pytest.fixture(scope="module")
def replanned(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Run]:
    """Each failing plan, in a folder of a plan that was found."""
    folder = tmp_path_factory.mktemp("again")
    for method in {method for _, method in FAILING.values()}:
        assert (
            plan(*method, "--to", "0.3", "0", "0", "--out", method[0], cwd=folder).returncode == 0
        )
    runs = {}
    for name, (options, method) in FAILING.items():
        shutil.copytree(folder / method[0], folder / name)
        runs[name] = plan(*options, "--out", name, cwd=folder), folder / name
    return runs


@pytest.mark.slow
@pytest.mark.parametrize("name", FAILING)
def test_a_plan_that_fails_leaves_nothing_of_an_earlier_one(
    name: str, replanned: dict[str, Run]
) -> None:
    process, folder = replanned[name]
    assert process.returncode == 3, process.stdout + process.stderr
    assert {path.name for path in folder.iterdir()} == {"report.json", ".uvms_ocp"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["infeasible"])
def test_optimal_control_without_a_usable_plan_says_why_and_claims_no_motion(
    name: str, replanned: dict[str, Run]
) -> None:
    process, folder = replanned[name]
    report = json.loads((folder / "report.json").read_text())
    assert name in report["status"]
    assert report["reason"]
    assert report["advice"].split(":")[0] in " ".join(process.stdout.split())
    assert report["collision_free"] is False
    assert report["min_clearance_m"] is None
    assert " s long" not in process.stdout


def test_a_goal_inside_an_obstacle_is_refused_with_the_shapes_and_their_depth(
    tmp_path: Path,
) -> None:
    goal = ("--to", "3", "0", "0", "--sphere", "3,0,0,0.5")
    process = plan("ocp", *goal, "--out", "out", cwd=tmp_path)
    assert process.returncode == 2
    assert "the goal is in collision: sphere1 - base_link_0 overlap by" in process.stderr
    assert len(process.stderr.strip().splitlines()) == 1


def test_a_goal_below_the_floor_is_refused_too(tmp_path: Path) -> None:
    process = plan(
        "ocp", "--tool", "1", "0", "-2", "--seabed", "-1.5", "--out", "out", cwd=tmp_path
    )
    assert process.returncode == 2
    assert "the goal is in collision: seafloor - tool overlap by 0.5 m" in process.stderr


@pytest.mark.slow
@pytest.mark.parametrize("method", ["curve", "ocp"])
def test_the_example_of_the_readme_passes_the_sphere_that_the_start_is_near_to(
    method: str, tmp_path: Path
) -> None:
    way = (
        "--tool",
        "12.2",
        "37.4",
        "-39.5",
        "--position",
        "11",
        "37",
        "-38.5",
        "--sphere",
        "11.8,37.2,-38.9,0.1",
    )
    patient = ("--time-limit", "120") if method == "ocp" else ()
    process = plan(method, *way, *patient, "--out", "out", "--json", cwd=tmp_path)
    assert process.returncode == 0, process.stderr
    report = json.loads(process.stdout)
    assert report["collision_free"] is True
    assert report["tool_error"]["position_m"] < 1e-4
    assert report["min_clearance_m"] > (0.034 if method == "ocp" else 0.0)


@pytest.mark.slow
def test_a_robot_shut_in_exits_with_3_and_shows_the_collision(tmp_path: Path) -> None:
    wall = ("--robot", "planar5", "--box", "2,0,0,0.1,30,30")
    process = plan("curve", "--joint", "x0=4", *wall, "--out", "out", "--json", cwd=tmp_path)
    assert process.returncode == 3
    report = json.loads(process.stdout)
    assert report["min_clearance_m"] <= 0.0
    assert "box1" in report["min_clearance_between"]
    assert "way points" in report["advice"]
    assert (tmp_path / "out" / "scene.html").exists()


@pytest.fixture(scope="module")
def controlled(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("ocp")
    options = ("--duration", "14", "--steps", "20", "--current", "0.1", "0", "0")
    goal = ("--tool", *map(str, TOOL), "--sphere", "1.7,0.3,-0.4,0.35")
    return plan("ocp", *goal, *options, "--out", "out", "--json", cwd=folder), folder / "out"


@pytest.mark.slow
def test_optimal_control_reaches_the_goal_with_what_the_thrusters_have(controlled: Run) -> None:
    process, folder = controlled
    report = json.loads(process.stdout)
    assert process.returncode == 0, process.stderr
    assert report == json.loads((folder / "report.json").read_text())
    assert report["status"] == "solved"
    assert report["collision_free"] is True
    assert report["tool_error"]["position_m"] < 1e-5
    assert 0 < report["peak_thrust_n"] < 150
    assert report["energy_j"] > 0
    assert "all goals are met" in process.stderr


@pytest.mark.slow
def test_optimal_control_writes_its_plan_with_forces(controlled: Run) -> None:
    _, folder = controlled
    files = {str(path.relative_to(folder)) for path in results(folder)}
    figures = {
        f"figures/{name}.png" for name in ("vehicle_motion", "joint_motion", "clearance", "efforts")
    }
    assert files == figures | {"plan.npz", "plan.json", "record.npz", "report.json", "scene.html"}
    arrays = np.load(folder / "plan.npz")
    text = json.loads((folder / "plan.json").read_text())
    assert arrays["thrust"].shape == (20, 8)
    np.testing.assert_allclose(text["q"], arrays["q"])
    np.testing.assert_allclose(
        Record.load(folder / "record.npz")["q"][-1], arrays["q"][-1], atol=1e-6
    )


@pytest.mark.slow
def test_optimal_control_that_misses_its_goal_exits_with_3_and_says_why(tmp_path: Path) -> None:
    options = ("--duration", "1", "--steps", "5", "--robot", "planar5")
    process = plan("ocp", "--joint", "x0=0.9", *options, "--out", "out", "--json", cwd=tmp_path)
    assert process.returncode == 3, process.stderr
    report = json.loads(process.stdout)
    assert report["status"] == "horizon too short"
    assert "more time" in report["advice"]
    assert (tmp_path / "out" / "plan.npz").exists()


def test_a_solver_that_runs_out_of_time_says_what_to_give(tmp_path: Path) -> None:
    goal = ("--joint", "x0=0.9", "--robot", "planar5")
    process = plan("ocp", *goal, "--time-limit", "1e-6", "--out", "out", cwd=tmp_path)
    assert process.returncode == 3, process.stderr
    text = " ".join(process.stdout.split())
    assert "unfinished" in text
    assert "raise time_limit" in text
    assert "max_iterations" not in text


def compared(*folders: Path) -> CompletedProcess[str]:
    return called("compare", *folders, "--json", cwd=Path())


@pytest.mark.slow
def test_plans_of_either_method_compare_figure_by_figure(around: Run, controlled: Run) -> None:
    process = compared(around[1], controlled[1])
    assert process.returncode == 0, process.stderr
    rows = {row["figure"]: row for row in json.loads(process.stdout)}
    reports = [
        json.loads((folder / "report.json").read_text()) for _, folder in (around, controlled)
    ]
    for figure in ("duration_s", "min_clearance_m"):
        ours = [report[figure] for report in reports]
        assert [rows[figure]["first"], rows[figure]["second"]] == pytest.approx(ours)
        assert rows[figure]["change"] == pytest.approx(100.0 * (ours[1] / ours[0] - 1.0))
        assert f"{rows[figure]['change']:+.4g} %" in process.stderr
    assert rows["energy_j"]["first"] is None
    assert rows["energy_j"]["second"] == pytest.approx(reports[1]["energy_j"])
    assert rows["peak_thrust_n"]["second"] == pytest.approx(reports[1]["peak_thrust_n"])


@pytest.mark.slow
def test_a_plan_against_anything_else_is_refused_in_one_line(around: Run, tmp_path: Path) -> None:
    shutil.copy(Path(__file__).parents[1] / "records" / "run_v0_1.npz", tmp_path / "run.npz")
    np.savez(tmp_path / "other.npz", t=np.zeros(1), __meta__=np.array("{}"))
    np.savez(tmp_path / "broken.npz", t=np.zeros(1), __meta__=np.array('{"completed": "yes"}'))
    for name, message in (
        ("run.npz", "first is a plan, second a run; give runs alone or plans alone"),
        ("other.npz", "a record of neither a run nor a plan"),
        ("broken.npz", "broken.npz: "),
        ("", "holds no record.npz; give the folder of a run"),
    ):
        process = compared(around[1], tmp_path / name)
        assert process.returncode == 2
        assert message in process.stderr
        assert len(process.stderr.strip().splitlines()) == 1
