"""Compare what two versions of the code compute, number by number: runs, plans, a campaign, an
identification, exported C.

    python benchmarks/same_numbers.py --record FOLDER    write the golden values, one file per item
    python benchmarks/same_numbers.py --against FOLDER   compute again and compare; exit code 1 where they differ

Both on one machine and with OMP_NUM_THREADS=1: the last bits of a sum depend on the processor and
on threads. Times of computation and texts for people are left out. What a version calls otherwise
is given by `--renamed OLD=NEW`, as often as needed, or as lines of a file by `@FILE`: classes,
functions, attributes, columns, keys, identifiers in C. Where a name is missing, values of the same
bits under another one are found without.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

import uvms_ocp as uo

Values = dict[str, np.ndarray]
RENAMED: dict[str, str] = {}
"""Names of the version at hand, by those when the golden values were recorded."""


def renamed(text: str) -> str:
    """The text with each word that has another name now replaced; the whole of it first."""
    if text in RENAMED:
        return RENAMED[text]
    return re.sub(r"[A-Za-z_]\w*", lambda word: RENAMED.get(word[0], word[0]), text)


@cache
def find(name: str, prefer: str = "") -> Any:
    """Import a class or function by its name, wherever in the package it is defined; prefer: a
    folder or module.

    What the top of the package does not export is looked for in its source, so that modules may
    move.
    """
    name = renamed(name)
    if hasattr(uo, name):
        return getattr(uo, name)
    root = Path(str(uo.__file__)).parent
    definition = re.compile(rf"^(?:class|def) {name}\b", re.MULTILINE)
    modules = []
    for path in sorted(root.rglob("*.py")):
        if definition.search(path.read_text()):
            modules.append(path.relative_to(root))
    preferred = [path for path in modules if prefer in path.with_suffix("").parts]
    modules = preferred or modules
    if len(modules) != 1:
        places = ", ".join(map(str, modules)) or "no module"
        raise LookupError(f"{name} is defined in {places}; give --renamed {name}=NEW")
    parts = (uo.__name__, *modules[0].with_suffix("").parts)
    module = ".".join(parts).removesuffix(".__init__")
    return getattr(import_module(module), name)


def attribute(value: Any, name: str) -> Any:
    """The attribute under the name that it has now."""
    return getattr(value, renamed(name))


# What is computed
# ------------------------------------------------------------------------------------------------------

FAULTS = ("altimeter:frozen@8", "thruster3:dead@15", "joint2:jam@20")
SOLVERS = {"lexls": "LexicographicActiveSet", "lexqp": "LexicographicQp", "icat": "Icat"}
PLANTS = ("kinematic", "dynamic")
OCP_BACK_ENDS = ("ipopt", "stagewise")
SQP_BACK_ENDS = ("stagewise", "hpipm")
PATIENCE = 600.0
"""[s] for solvers, which must not end by the clock."""
GOAL = ("--tool", "12.2", "37.4", "-39.5", "--position", "11", "37", "-38.5")
PLANS = {
    "curve": (*GOAL, "--sphere", "11.8,37.2,-38.9,0.1"),
    "ocp": (*GOAL, "--time-limit", f"{PATIENCE:g}"),
    "mission": ("case1", "--time-limit", f"{PATIENCE:g}"),
}
IDENTIFIED = """
robot: bluerov2_alpha5
arm: taken off
hull: [[-0.25, -0.2, -0.15], [0.25, 0.2, 0.15]]
lag: 0.2
learn:
  added_mass: {free: [surge, sway]}
  quadratic_drag: {free: [surge, sway]}
  volume: {prior: 0.02}
  lag: {}
noise: {velocity: 0.01, rate: 0.02, vertical: 0.01}
step: 0.02
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class Setting:
    """The folder where an item may write, and whether a moment of it is enough."""

    work: Path
    quick: bool

    def duration(self, seconds: float) -> dict[str, Any]:
        """Return the duration of a quick run [s] as an option of scenarios; none where it runs to
        its end.
        """
        return {"duration": seconds} if self.quick else {}


def run_of_case1(setting: Setting, plant: str, solver: str) -> Values:
    """Run Case 1 with ideal sensors."""
    scenario = uo.scenario.case1(plant=plant, solver=find(solver)(), **setting.duration(0.1))
    return of_run(scenario.run())


def faulty(name: str, **options: Any) -> Any:
    """A scenario with noise, a current and, in Case 1, faults of sensor, thruster and joint."""
    if name == "case1":
        options["faults"] = FAULTS
    make = getattr(uo.scenario, name)
    return make(noise=True, current=(0.1, -0.1, 0.02), seed=3, **options)


def faulty_run(setting: Setting) -> Values:
    """Run Case 1 with all that goes wrong."""
    return of_run(faulty("case1", **setting.duration(0.3)).run())


def load_run(setting: Setting) -> Values:
    """Run the smallest robot with noise and a payload that it learns and is not told of."""
    scenario = uo.scenario.reach(noise=True, seed=1, learn_load=True, **setting.duration(0.3))
    return of_run(scenario.run())


def exported(setting: Setting, name: str) -> Path:
    """The folder with the exported controller of a scenario, written once."""
    folder = setting.work / f"export-{name}"
    if not folder.is_dir():
        uo.export_controller(faulty(name, **setting.duration(0.3)), folder)
    return folder


def exported_sources(setting: Setting, name: str) -> Values:
    """Export a controller as C: its sources without comments, of the same layout."""
    folder = exported(setting, name)
    sources = {}
    for path in sorted(folder.iterdir()):
        if path.suffix in (".c", ".h"):
            sources[path.name] = np.array(_code(path.read_text()))
    return sources


def _code(text: str) -> str:
    """C without comments and blank lines, every space as one."""
    no_comments = re.sub(r"/\*.*?\*/|//[^\n]*", " ", text, flags=re.DOTALL)
    lines = [" ".join(line.split()) for line in no_comments.splitlines()]
    return "\n".join(line for line in lines if line)


def exported_replay(setting: Setting, name: str) -> Values:
    """Build an exported controller and replay the recorded run: what was recorded, and what C
    answers at every tick.
    """
    folder = exported(setting, name)
    sources = sorted(path.name for path in folder.glob("*.c"))
    (recording,) = folder.glob("*recorded.bin")
    level = "-O0" if setting.quick else "-O1"
    subprocess.run(
        ["cc", "-std=c99", level, "-ffp-contract=off", *sources, "-lm", "-o", "replay"],
        cwd=folder,
        check=True,
    )
    process = subprocess.run(
        ["./replay", recording.name, "ticks.txt"], cwd=folder, capture_output=True, text=True
    )
    numbers = re.findall(r"\d+(?:\.\d*)?(?:e[-+]?\d+)?", process.stdout)
    return {
        "recorded": np.frombuffer(recording.read_bytes(), dtype="<f8"),
        "told": np.loadtxt(folder / "ticks.txt", ndmin=2),
        "counts": np.array([float(number) for number in numbers]),
    }


def plan_by_command(setting: Setting, method: str) -> Values:
    """Plan by the command line: the record and the trajectory that it writes."""
    out = setting.work / f"plan-{method}"
    words = [sys.executable, "-m", "uvms_ocp", "plan", method, *PLANS[method], "--out", str(out)]
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    values = {}
    for path in sorted(out.glob("*.npz")):
        for name, array in stored(path).items():
            if array.dtype.kind != "U":
                values[f"{path.stem}/{name}"] = array
    return values


def campaign(setting: Setting) -> Values:
    """Run a small campaign and read its Parquet files."""
    import pandas as pd

    drawn = (
        ("water.drag", 0.5, 1.5),
        ("current.speed", 0.0, 0.2),
        ("payload.mass", 0.0, 1.0),
        ("start.yaw", -0.3, 0.3),
    )
    variation = find("Variation", "campaign")
    uniform = find("Uniform", "campaign")
    variations = []
    for name, low, high in drawn:
        variations.append(variation(renamed(name), uniform(low, high)))
    options = {"noise": True, "dt": 0.02, **setting.duration(0.2)}
    study = find("Campaign")(
        scenario="case1",
        variations=variations,
        runs=2 if setting.quick else 4,
        seed=1,
        options=options,
    )
    folder = setting.work / "campaign"
    study.run(folder, workers=1)
    parts = [pd.read_parquet(path) for path in sorted(folder.rglob("*.parquet"))]
    table = pd.concat(parts).sort_values("run")
    numbers = table.select_dtypes(["number", "bool"])
    return {str(name): numbers[name].to_numpy() for name in numbers if not is_clock(str(name))}


def identification(setting: Setting) -> Values:
    """Identify a vehicle from the record of its own run: all numbers of the report."""
    record = driven(duration=4.0 if setting.quick else 20.0)
    settings_path = setting.work / "identified.yaml"
    settings_path.write_text(IDENTIFIED)
    record_path = setting.work / "driven.npz"
    record.save(record_path)
    settings = find("read_settings", "identification")(settings_path)
    recordings = [find("read_recording", "identification")(record_path)]
    subject = find("calibrated_robot", "identification")(settings, setting.work)
    result = find("calibrate", "identification")(subject, settings, recordings)
    values = of_run(record, "run/")
    for number in attribute(result, "numbers"):
        for entry in ("value", "sigma", "interval", "determined"):
            values[f"{number.name}/{entry}"] = np.array(attribute(number, entry))
    for name in ("shared", "information"):
        values[name] = np.array(attribute(attribute(result, "estimate"), name))
    return {**values, "inflation": np.array(attribute(result, "inflation"))}


def driven(duration: float) -> Any:
    """The record of a vehicle without its arm whose thrusters get random thrust for a duration
    [s].
    """
    robot = uo.without_arm(uo.load_robot("bluerov2_alpha5"))
    arrived = uo.Below(quantity="PC.position_error", limit=0.1)
    end = uo.Transition(to=uo.DONE, when=(arrived,))
    task = find("VehiclePose", "tasks")(name="PC", goal=uo.pose_at((50.0, 0.0, -20.0)))
    phase = uo.Phase(name="go", activations={"PC": 1.0}, transitions=(end,))
    shape = (round(2 * duration) + 2, len(robot.thruster_names))
    thrust = 6.0 * np.random.default_rng(0).normal(size=shape)
    command = find("Command", "signals")
    at_rest = np.zeros(robot.n_v)
    return uo.Scenario(
        name="driven",
        robot=robot,
        mission=uo.Mission(hierarchy=uo.Hierarchy([task]), phases=(phase,)),
        environment=uo.Environment(seafloor=uo.FlatSeafloor(z=-40.0)),
        start=robot.configuration(position=(0.0, 0.0, -20.0)),
        controller=lambda scenario: (
            lambda state, t: command(v=at_rest, thrust=thrust[int(2 * t)], torque=np.zeros(0))
        ),
        dt=0.02,
        duration=duration,
    ).run()


def reach_problem(robot: Any, q: np.ndarray, n_steps: int, path: bool = False) -> Any:
    """A problem of optimal control: the tool moves away from where it is at q (n_q,) [m, rad], with
    little effort.
    """
    tool = uo.Kinematics(robot, q).pose("tool")
    tool.translation = tool.translation + np.array([0.6, -0.3, -0.3])
    task = find("ToolPose", "tasks")(goal=tool)
    term = find("TaskTerm", "ocp")
    cheap = (find("Effort", "ocp")(), find("Smoothness", "ocp")(weight=0.09))
    level = find("OcpLevel", "ocp")
    constraints: tuple[Any, ...] = ()
    if path:
        duration = 3.0
        follow = term(task=task, at=find("At").PATH, weight=100.0)
        levels = [level(name="one", terms=(follow, *cheap))]
    else:
        duration = 8.0
        levels = [level(name="tool", terms=(term(task=task),)), level(name="effort", terms=cheap)]
        constraints = (find("AtRest", "ocp")(),)
    return find("single_phase", "ocp")(
        robot=robot,
        start=find("State", "signals")(q=q, v=np.zeros(robot.n_v)),
        duration=duration,
        n_steps=n_steps,
        levels=levels,
        constraints=constraints,
        current=np.array([0.2, 0.0, 0.0]),
    )


def ocp(setting: Setting, plugin: str) -> Values:
    """Plan a motion of the tool by one of the solvers of nonlinear programs."""
    robot = uo.load_robot("girona_maris7_full")
    start = robot.configuration(position=(0, 0, -5), rpy=(0, -0.06, 0.5))
    problem = reach_problem(robot, start, 5 if setting.quick else 20)
    options = find("NlpOptions", "nlp")(plugin=plugin, time_limit=PATIENCE)
    plan = find("Planner", "ocp")(problem, options).plan()
    values = arrays_of(attribute(plan, "trajectory"))
    for level in plan.levels:
        for name in ("residual", "prices"):
            values[f"{level.name}/{name}"] = np.array(attribute(level, name))
    return {**values, "iterations": np.array(plan.iterations)}


def receding(setting: Setting, plugin: str) -> Values:
    """Run receding-horizon control by one of the solvers of steps in real time."""
    scenario = uo.scenario.reach(duration=0.1 if setting.quick else 1.0)
    problem = reach_problem(scenario.robot, scenario.start, 5 if setting.quick else 15, path=True)
    options = find("SqpOptions", "nlp")(plugin=plugin)
    nmpc = find("Nmpc", "control")
    scenario = replace(
        scenario, controller=lambda _: nmpc(problem, options=options, clock=lambda: 0.0)
    )
    return of_run(scenario.run())


def minimum_snap(setting: Setting) -> Values:
    """Minimum snap through way points, its slopes, and the best times."""
    waypoints = np.random.default_rng(0).normal(size=(21, 3))
    curve = find("min_snap", "trajectories")(waypoints, np.arange(21.0))
    best = find("optimal_times", "trajectories")(waypoints[:5], np.arange(5.0), time_weight=1.0)
    return {
        **arrays_of(curve.trajectory),
        **arrays_of(curve.gradients(), "slopes/"),
        **arrays_of(best.trajectory, "best/"),
        "cost": np.array(curve.cost),
    }


def _items() -> dict[str, Callable[[Setting], Values]]:
    items: dict[str, Callable[[Setting], Values]] = {}
    for plant in PLANTS:
        for name, solver in SOLVERS.items():
            items[f"{plant}-{name}"] = partial(run_of_case1, plant=plant, solver=solver)
    items["faulty-run"] = faulty_run
    items["load-run"] = load_run
    items["minimum-snap"] = minimum_snap
    items["campaign"] = campaign
    items["identification"] = identification
    for plugin in OCP_BACK_ENDS:
        items[f"ocp-{plugin}"] = partial(ocp, plugin=plugin)
    for plugin in SQP_BACK_ENDS:
        items[f"nmpc-{plugin}"] = partial(receding, plugin=plugin)
    for name in ("case1", "obstacle_field"):
        items[f"export-{name}-sources"] = partial(exported_sources, name=name)
        items[f"export-{name}-replay"] = partial(exported_replay, name=name)
    for method in PLANS:
        items[f"plan-{method}"] = partial(plan_by_command, method=method)
    return items


ITEMS = _items()
"""Functions of what is computed, by the names of their files."""
SLOW = (
    "plan-curve",
    "plan-ocp",
    "plan-mission",
    "export-obstacle_field-sources",
    "export-obstacle_field-replay",
)
"""Left out of a quick run."""

# What of it is kept
# ----------------------------------------------------------------------------------------------------


def is_clock(name: str) -> bool:
    """Whether that is a time of computation, or which process computed."""
    times = r"(tick|solve|viable|controller|build|processor|real)_time|wall|worker|_us(/|$)"
    return re.search(times, name) is not None


def of_run(record: Any, prefix: str = "") -> Values:
    """The series of a record, and the numbers of its report."""
    values = {}
    for name, array in record.series.items():
        if array.dtype.kind != "U":
            values[f"{prefix}{name}"] = array
    values |= dict(numbers_in(uo.summarize(record), f"{prefix}report"))
    return {name: array for name, array in values.items() if not is_clock(name)}


def numbers_in(value: Any, name: str) -> Iterator[tuple[str, np.ndarray]]:
    """All numbers of nested mappings and sequences, by their way there."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from numbers_in(item, f"{name}/{key}")
    elif isinstance(value, Sequence) and not isinstance(value, str):
        for k, item in enumerate(value):
            yield from numbers_in(item, f"{name}/{k}")
    elif isinstance(value, bool | int | float | np.generic):
        yield name, np.array(value)


def arrays_of(value: Any, prefix: str = "") -> Values:
    """The fields of a value that are arrays."""
    if not is_dataclass(value):
        raise TypeError(f"{type(value).__name__} is no dataclass; say what of it is to be compared")
    arrays = {}
    for field in fields(value):
        array = getattr(value, field.name)
        if isinstance(array, np.ndarray):
            arrays[f"{prefix}{field.name}"] = array
    return arrays


def stored(path: Path) -> Values:
    """The arrays of a file, but for times of computation."""
    with np.load(path) as file:
        return {name: file[name] for name in file.files if not is_clock(name)}


# How it is compared
# ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdict:
    """The comparison of one item with its golden values."""

    difference: float
    """largest of all arrays, each relative to its own largest value; infinite where counts, flags
    or shapes differ.
    """
    text: str


def judged(golden: Values, computed: Values) -> Verdict:
    """Compare all golden arrays with those of the same names, or else of the same bits."""
    expected = {renamed(name): _renamed_text(array) for name, array in golden.items()}
    spare = {name: array for name, array in computed.items() if name not in expected}
    differences = {}
    notes = []
    for name, array in expected.items():
        candidate = computed.get(name)
        if candidate is None:
            new_name = _name_of_same(array, spare)
            if new_name is None:
                notes.append(f"{name} is missing")
                differences[name] = np.inf
                continue
            candidate = spare.pop(new_name)
            notes.append(f"{name} is now {new_name}")
        if not same_bits(array, candidate):
            differences[name] = difference(array, candidate)
    if spare:
        more = ", ..." if len(spare) > 5 else ""
        notes.append(f"new: {', '.join(sorted(spare)[:5])}{more}")
    largest = max(differences.values(), default=0.0)
    if not differences:
        text = f"same bits ({len(expected)} arrays)"
    else:
        worst = sorted(differences, key=lambda name: -differences[name])
        listed = ", ".join(f"{name} {differences[name]:.3g}" for name in worst[:5])
        text = (
            f"largest relative difference {largest:.3g} ({len(worst)} of {len(expected)} arrays:"
            f" {listed})"
        )
    return Verdict(difference=largest, text="; ".join([text, *notes]))


def _name_of_same(array: np.ndarray, candidates: Values) -> str | None:
    """Return the name of the first candidate of the same bits, if there is one."""
    for name, candidate in candidates.items():
        if same_bits(array, candidate):
            return name
    return None


def _renamed_text(array: np.ndarray) -> np.ndarray:
    """Identifiers in sources by their names of today."""
    if array.dtype.kind != "U" or array.shape != ():
        return array
    return np.array(renamed(str(array)))


def same_bits(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether both have the same type, shape and bytes."""
    return (
        first.dtype == second.dtype
        and first.shape == second.shape
        and first.tobytes() == second.tobytes()
    )


def difference(first: np.ndarray, second: np.ndarray) -> float:
    """Largest difference relative to the largest value of the first; infinite for what is no number
    or no real one.
    """
    if first.shape != second.shape:
        return np.inf
    if first.dtype.kind != "f" or second.dtype.kind != "f":
        return 0.0 if np.array_equal(first, second) else np.inf
    differs = ~((first == second) | (np.isnan(first) & np.isnan(second)))
    if not differs.any():
        return 0.0
    gap = np.abs(first[differs] - second[differs]).max()
    scale = np.abs(first[np.isfinite(first)]).max(initial=0.0)
    if not np.isfinite(gap) or scale <= 0.0:
        return np.inf
    return float(gap / scale)


def processor_time() -> float:
    """[s] of this process and of those that it has called."""
    return sum(os.times()[:4])


def carried_out(arguments: argparse.Namespace, names: Sequence[str]) -> bool:
    """Compute, record and compare item after item; true if none differs by more than is allowed."""
    fine = True
    with tempfile.TemporaryDirectory() as work:
        setting = Setting(work=Path(work), quick=arguments.quick)
        for name in names:
            begin = processor_time()
            try:
                with contextlib.redirect_stdout(io.StringIO()):
                    values = ITEMS[name](setting)
            except Exception as error:  # the others are still worth knowing
                if arguments.trace:
                    traceback.print_exc()
                verdict = Verdict(
                    difference=np.inf, text=f"failed: {type(error).__name__}: {str(error)[:300]}"
                )
            else:
                verdict = recorded_and_judged(arguments, name, values)
            fine &= verdict.difference <= arguments.tolerance
            print(f"{name}: {verdict.text} [{processor_time() - begin:.1f} s]", flush=True)
    return fine


def recorded_and_judged(arguments: argparse.Namespace, name: str, values: Values) -> Verdict:
    """Write the values of an item if asked to, and compare them if asked to."""
    verdict = Verdict(difference=0.0, text=f"recorded ({len(values)} arrays)")
    if arguments.against:
        file = arguments.against / f"{name}.npz"
        if not file.is_file():
            verdict = Verdict(difference=np.inf, text=f"there is no {file}")
        else:
            with np.load(file) as golden:
                verdict = judged({key: golden[key] for key in golden.files}, values)
    if arguments.record:
        arguments.record.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(arguments.record / f"{name}.npz", allow_pickle=False, **values)
    return verdict


def main() -> None:
    """Record, compare or both; exit with 1 where anything differs by more than the tolerance, or
    fails.
    """
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=form, fromfile_prefix_chars="@"
    )
    parser.add_argument("--record", type=Path, metavar="FOLDER", help="write what is computed")
    parser.add_argument(
        "--against", type=Path, metavar="FOLDER", help="compare with what was written"
    )
    parser.add_argument(
        "--tolerance", type=float, default=0.0, help="largest relative difference (default: 0)"
    )
    parser.add_argument(
        "--renamed",
        action="append",
        default=[],
        metavar="OLD=NEW",
        help="what has another name now",
    )
    parser.add_argument(
        "--only", nargs="+", metavar="ITEM", choices=list(ITEMS), help=f"of {', '.join(ITEMS)}"
    )
    parser.add_argument("--quick", action="store_true", help="a moment of most items")
    parser.add_argument("--trace", action="store_true", help="print where an item failed")
    arguments = parser.parse_args()
    if not (arguments.record or arguments.against):
        parser.error("nothing to do; give --record FOLDER, --against FOLDER or both")
    for pair in arguments.renamed:
        old, equals, new = pair.partition("=")
        if not (old and equals and new):
            parser.error(f"--renamed {pair}; give OLD=NEW")
        RENAMED[old] = new
    if shutil.which("cc") is None:
        parser.error("a C compiler `cc` is needed")
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # of the commands that are called
    # [s]: what is not compiled in time may differ in the last bits
    os.environ["UVMS_OCP_COMPILE_TIMEOUT"] = "7200"
    names = list(ITEMS)
    if arguments.only:
        names = arguments.only
    elif arguments.quick:
        names = [name for name in ITEMS if name not in SLOW]
    if not carried_out(arguments, names):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
