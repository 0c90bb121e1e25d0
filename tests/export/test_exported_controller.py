"""The controller in C is the one in Python: the same commands on every tick, whatever happens."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from compiler import COMPILER, needs_compiler
from lasting import patrol
from odd_robots import ODD, pair_of, reach_of
from tiny_robots import TINY, robot_of, scenario_of as tiny_scenario

import uvms_ocp as uo
from uvms_ocp.codegen.kernels import initial_value
from uvms_ocp.control.velocity.levels import numbers_of
from uvms_ocp.errors import InvalidInput
from uvms_ocp.export import c_files, controller, export_controller, exported_controller
from uvms_ocp.mission.phase import Phase
from uvms_ocp.robot.channels import CHANNELS
from uvms_ocp.robot.signals import SensorSpecs
from uvms_ocp.scenario.cases import SCENARIOS, case1
from uvms_ocp.scenario.options import activate, mission_of
from uvms_ocp.scenario.part_factories import our_controller
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.solvers import LexicographicActiveSet
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.task import Task
from uvms_ocp.tasks.vehicle_velocity import NullVelocity

pytestmark = [needs_compiler, pytest.mark.slow]
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
GENERATED = ("controller.c", "initial.c", "functions.c", "solver.c")
C = "c"  # the name of exports here
RECORDED = f"{C}_recorded.bin"
REPLAY = f"{C}_replay.c"
SANITIZED = ("-O0", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
RANDOM_INPUTS, SET_PARAMETERS = (
    Path(__file__).with_name(name) for name in ("random_inputs.c", "set_parameters.c")
)
CHANGED = {
    "PC": {"gain_linear": 0.31},
    "T": {"gain_angular": 0.44, "saturation_linear": 0.3},
    "JL": {"gain": 1.0},
    "LA": {"gain": 0.3},
}
FAULTY = ("altimeter:frozen@3", "thruster3:dead@6", "joint2:jam@10")


def scenario_of(name: str) -> Scenario:
    if name == "faulty":
        return case1(noise=True, faults=FAULTY, duration=25.0)
    if name in {"kinematic", "icat"}:
        return case1(
            plant="kinematic", dt=0.02, **({"solver": uo.Icat()} if name == "icat" else {})
        )
    if name in ODD:
        return reach_of(pair_of(name).odd, plant="dynamic", sensors=SensorSpecs())
    if name == "patrol":
        return patrol(rounds=2, energy=60.0, duration=30.0)
    return SCENARIOS[name](duration=30.0)


@cache
def exported(name: str) -> Path:
    """The folder of the controller of a scenario, written once."""
    folder = _FOLDERS / name
    export_controller(scenario_of(name), folder, C)
    return folder


@pytest.fixture(scope="module", autouse=True)
def _folders(tmp_path_factory: pytest.TempPathFactory) -> None:
    global _FOLDERS
    _FOLDERS = tmp_path_factory.mktemp("exported")
    exported.cache_clear()


_FOLDERS = Path()


def built(folder: Path, program: str, main: Path, options: Sequence[str] = ("-O0",)) -> Path:
    """A program of the controller and a file of its own."""
    objects = []
    generated = [folder / f"{C}_{name}" for name in GENERATED]
    for source in (main, *generated):
        objects.append(folder / f"{program}_{source.stem}.o")
        lenient_flags = ("-Wno-unused-parameter",) if source in generated else ()
        command = [
            COMPILER,
            *STRICT,
            *lenient_flags,
            *options,
            "-ffp-contract=off",
            f"-I{folder}",
            "-c",
            source,
            "-o",
            objects[-1],
        ]
        subprocess.run([str(part) for part in command], check=True)
    subprocess.run(
        [COMPILER, *options, *map(str, objects), "-lm", "-o", str(folder / program)], check=True
    )
    return folder / program


@pytest.mark.parametrize(
    "name",
    [
        "kinematic",
        "case1",
        "case2",
        "current_drift",
        "obstacle_field",
        "bluerov_inspection",
        "faulty",
        "patrol",
        "icat",
        *ODD,
    ],
)
def test_fed_with_the_recorded_measurements_it_gives_the_recorded_commands(name: str) -> None:
    folder = exported(name)
    level = (
        ("-O2",) if name == "bluerov_inspection" else ("-O0",)
    )  # one shows that bits do not depend on it
    output = subprocess.run(
        [built(folder, "replay", folder / REPLAY, level), folder / RECORDED],
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    assert ", 0 apart, " in output
    assert int(output.split()[0]) > 100


@pytest.mark.parametrize("began", [1e3, 1.76e9])
@pytest.mark.parametrize("name", ["kinematic", "faulty", "patrol"])
def test_in_c_commands_are_the_same_whatever_the_clock_shows(
    name: str, began: float, tmp_path: Path
) -> None:
    """But for what changes within the resolution of the clock, at most by 2e5 N/s and the like."""
    folder = exported(name)
    told = []
    program = built(folder, "replay", folder / REPLAY)
    recorded = np.fromfile(folder / RECORDED, dtype="<f8")
    n = int(
        subprocess.run([program, folder / RECORDED], capture_output=True, text=True).stdout.split()[
            0
        ]
    )
    robot = scenario_of(name).robot
    since = 1 + robot.n_q + robot.n_v + 3 + len(CHANNELS)
    for start in (0.0, began):
        rows = recorded.reshape(n, -1).copy()
        rows[:, [0, *range(since, since + len(CHANNELS))]] += start
        rows.tofile(tmp_path / "later.bin")
        subprocess.run(
            [program, tmp_path / "later.bin", tmp_path / "ticks.txt"], capture_output=True
        )
        told.append(np.loadtxt(tmp_path / "ticks.txt"))
    np.testing.assert_allclose(*told, rtol=0, atol=1e-9 + 2e5 * np.spacing(began))


def test_a_replay_that_differs_by_one_bit_fails_but_for_a_tolerance(tmp_path: Path) -> None:
    folder = exported("kinematic")
    changed = bytearray((folder / RECORDED).read_bytes())
    robot = scenario_of("kinematic").robot
    first = 1 + robot.n_q + robot.n_v + 3 + 2 * len(CHANNELS)  # what is told, behind what is given
    numbers = np.frombuffer(changed, dtype="<f8")
    numbers[first] = np.nextafter(numbers[first], np.inf)
    (tmp_path / "other.bin").write_bytes(bytes(changed))
    program = built(folder, "replay", folder / REPLAY)
    process = subprocess.run([program, tmp_path / "other.bin"], capture_output=True, text=True)
    assert process.returncode == 1
    assert ", 1 apart, " in process.stdout
    tolerant = subprocess.run([program, tmp_path / "other.bin", "-", "1e-9"], capture_output=True)
    assert tolerant.returncode == 0


@pytest.mark.parametrize("name", ["kinematic", "faulty", "icat"])
def test_no_input_does_harm(name: str) -> None:
    """10,000 random ones, NaN and infinities among them, under the sanitizers; what it tells stays
    finite.
    """
    folder = exported(name)
    program = built(folder, "random", RANDOM_INPUTS, SANITIZED)
    subprocess.run([program, folder / RECORDED], check=True, capture_output=True, timeout=300.0)


def test_in_the_loop_it_takes_the_place_of_pythons(tmp_path: Path) -> None:
    ours = case1(noise=True, dt=0.01, duration=12.0)
    export_controller(ours, tmp_path / "c")
    theirs = replace(ours, controller=exported_controller(tmp_path / "c"))
    record = ours.run()
    watched = theirs.run()
    for name in ("q", "command", "thrust", "torque", "phase"):
        np.testing.assert_allclose(watched[name], record[name], rtol=0.0, atol=1e-9, err_msg=name)


def test_numbers_of_tasks_are_parameters_that_need_no_compiler(tmp_path: Path) -> None:
    """Also one that comes to 1."""
    program = built(exported("kinematic"), "set", SET_PARAMETERS)
    export_controller(case1(plant="kinematic", dt=0.02, tasks=CHANGED), tmp_path / "other", C)
    recorded = str(tmp_path / "other" / RECORDED)
    assert subprocess.run([program, recorded], capture_output=True).returncode == 1
    numbers = [
        word
        for task, by in CHANGED.items()
        for name, value in by.items()
        for word in (f"{task}.{name}", repr(value))
    ]
    output = subprocess.run(
        [program, recorded, *numbers], check=True, capture_output=True, text=True
    ).stdout
    assert ", 0 apart, " in output
    assert subprocess.run([program, recorded, "MAC.threshold", "1.2"]).returncode == 3, (
        "safety rules rest on it"
    )


@pytest.mark.parametrize("name", ["kinematic", "obstacle_field"])
def test_a_parameter_is_what_the_memory_does_not_know(name: str) -> None:
    scenario = scenario_of(name)
    problem = our_controller(scenario).kinematic.problem
    core = LexicographicActiveSet().core_source(problem.function.size2_out(0), problem.sizes)

    def initial(tasks: Sequence[Task]) -> str:
        mission = replace(
            scenario.mission, hierarchy=Hierarchy(tasks, [task.name for task in tasks])
        )
        exported = our_controller(replace(scenario, mission=mission))
        return initial_value(controller.controller_memory(exported, core))

    tasks = list(scenario.mission.hierarchy.tasks)
    numbers, places = c_files.task_numbers(tasks, scenario.robot)
    initial_numbers = initial(tasks)
    every = [(k, item) for k, task in enumerate(tasks) for item in numbers_of(task)]
    assert numbers == [*(getattr(tasks[k], item) for k, item in every), 0.0, 1.0]
    for k, item in every:
        changed = replace(tasks[k], **{item: 1.1 * getattr(tasks[k], item) + 0.01})
        is_same = initial([*tasks[:k], changed, *tasks[k + 1 :]]) == initial_numbers
        assert is_same == (f"{changed.name}.{item}" in places), item


def test_tasks_without_numbers_have_no_parameters(tmp_path: Path) -> None:
    robot = robot_of(TINY["one wet link"])
    phase = Phase(name="A", activations=activate("NR"), transitions=())
    mission = mission_of(robot, [NullVelocity()], (phase,))
    scenario = replace(tiny_scenario(robot, "kinematic"), mission=mission)
    export_controller(scenario, tmp_path, C)
    subprocess.run([built(tmp_path, "set", SET_PARAMETERS), tmp_path / RECORDED], check=True)
    assert "CONTROLLER_PARAMETERS[] = {{0, 0}}" in (tmp_path / f"{C}_controller.c").read_text()


def test_a_controller_of_another_robot_is_refused() -> None:
    changed = replace(
        SCENARIOS["bluerov_inspection"](), controller=exported_controller(exported("case1"))
    )
    with pytest.raises(
        InvalidInput, match="is of a controller for another robot or mission; export this one"
    ):
        changed.run()


def test_a_folder_without_a_controller_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="has no controller; `uvms-ocp export"):
        replace(case1(), controller=exported_controller(tmp_path)).run()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"solver": uo.LexicographicQp()},
            "no form in C: solver LexicographicQp; LexicographicActiveSet and Icat have",
        ),
        (
            {"controller": lambda scenario: None},
            "no form in C: controller lambda; the toolkit's own has",
        ),
    ],
)
def test_what_has_no_form_in_c_is_refused_by_its_name(
    changes: dict, message: str, tmp_path: Path
) -> None:
    with pytest.raises(InvalidInput, match=message):
        export_controller(replace(case1(), **changes), tmp_path / "c")
    assert not (tmp_path / "c").exists()
