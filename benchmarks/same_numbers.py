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
"""From the name when the golden values were recorded to that of the version at hand."""


def renamed(text: str) -> str:
    """The text with each word that has another name now replaced; the whole of it first."""
    return RENAMED.get(text) or re.sub(
        r"[A-Za-z_]\w*", lambda word: RENAMED.get(word[0], word[0]), text
    )


@cache
def find(name: str, near: str = "") -> Any:
    """Import a class or function by its name, wherever in the package it is defined; near: a folder
    or module to prefer.

    What the top of the package does not export is looked for in its source, so that modules may
    move.
    """
    name = renamed(name)
    if hasattr(uo, name):
        return getattr(uo, name)
    root = Path(str(uo.__file__)).parent
    defined = re.compile(rf"^(?:class|def) {name}\b", re.MULTILINE)
    modules = [
        path.relative_to(root)
        for path in sorted(root.rglob("*.py"))
        if defined.search(path.read_text())
    ]
    places = [path for path in modules if near in path.with_suffix("").parts] or modules
    if len(places) != 1:
        there = ", ".join(map(str, places)) or "no module"
        raise LookupError(f"{name} is defined in {there}; give --renamed {name}=NEW")
    module = ".".join((uo.__name__, *places[0].with_suffix("").parts)).removesuffix(".__init__")
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
    """Where an item may write, and whether a moment of it is enough."""

    work: Path
    quick: bool

    def duration(self, seconds: float) -> dict[str, Any]:
        """That of a quick run [s], as an option of scenarios; none where it runs to its end."""
        return {"duration": seconds} if self.quick else {}


def run_of_case1(setting: Setting, plant: str, solver: str) -> Values:
    """Run Case 1 with ideal sensors."""
    return of_run(
        uo.scenario.case1(plant=plant, solver=find(solver)(), **setting.duration(0.1)).run()
    )


def faulty(name: str, **options: Any) -> Any:
    """A scenario with noise, a current and, in Case 1, faults of sensor, thruster and joint."""
    more = {"faults": FAULTS} if name == "case1" else {}
    return getattr(uo.scenario, name)(
        noise=True, current=(0.1, -0.1, 0.02), seed=3, **more, **options
    )


def faulty_run(setting: Setting) -> Values:
    """Run Case 1 with all that goes wrong."""
    return of_run(faulty("case1", **setting.duration(0.3)).run())


def load_run(setting: Setting) -> Values:
    """Run the smallest robot with noise and a payload that it learns and is not told of."""
    return of_run(
        uo.scenario.reach(noise=True, seed=1, learn_load=True, **setting.duration(0.3)).run()
    )


def exported(setting: Setting, name: str) -> Path:
    """The folder with the exported controller of a scenario, written once."""
    folder = setting.work / f"export-{name}"
    if not folder.is_dir():
        uo.export_controller(faulty(name, **setting.duration(0.3)), folder)
    return folder


def exported_sources(setting: Setting, name: str) -> Values:
    """Export a controller as C: its sources without comments, of the same layout."""
    folder = exported(setting, name)
    files = [path for path in sorted(folder.iterdir()) if path.suffix in (".c", ".h")]
    return {path.name: np.array(_code(path.read_text())) for path in files}


def _code(text: str) -> str:
    """C without comments and blank lines, every space as one."""
    lines = (
        " ".join(line.split())
        for line in re.sub(r"/\*.*?\*/|//[^\n]*", " ", text, flags=re.DOTALL).splitlines()
    )
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
    counts = [
        float(number) for number in re.findall(r"\d+(?:\.\d*)?(?:e[-+]?\d+)?", process.stdout)
    ]
    recorded = np.frombuffer(recording.read_bytes(), dtype="<f8")
    return {
        "recorded": recorded,
        "told": np.loadtxt(folder / "ticks.txt", ndmin=2),
        "counts": np.array(counts),
    }


def plan_by_command(setting: Setting, method: str) -> Values:
    """Plan by the command line: the record and the trajectory that it writes."""
    out = setting.work / f"plan-{method}"
    words = [sys.executable, "-m", "uvms_ocp", "plan", method, *PLANS[method], "--out", str(out)]
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    return {
        f"{path.stem}/{name}": array
        for path in sorted(out.glob("*.npz"))
        for name, array in stored(path).items()
        if array.dtype.kind != "U"
    }


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
    variations = [variation(renamed(name), uniform(low, high)) for name, low, high in drawn]
    options = {"noise": True, "dt": 0.02, **setting.duration(0.2)}
    asked = find("Campaign")(
        scenario="case1",
        variations=variations,
        runs=2 if setting.quick else 4,
        seed=1,
        options=options,
    )
    asked.run(setting.work / "campaign", workers=1)
    parts = [
        pd.read_parquet(path) for path in sorted((setting.work / "campaign").rglob("*.parquet"))
    ]
    table = pd.concat(parts).sort_values("run")
    numbers = table.select_dtypes(["number", "bool"])
    return {str(name): numbers[name].to_numpy() for name in numbers if not is_clock(str(name))}


def identification(setting: Setting) -> Values:
    """Identify a vehicle from the record of its own run: all numbers of the report."""
    record = driven(duration=4.0 if setting.quick else 20.0)
    paths = setting.work / "identified.yaml", setting.work / "driven.npz"
    paths[0].write_text(IDENTIFIED)
    record.save(paths[1])
    settings = find("read_settings", "identification")(paths[0])
    recordings = [find("read_recording", "identification")(paths[1])]
    subject = find("calibrated_robot", "identification")(settings, setting.work)
    result = find("calibrate", "identification")(subject, settings, recordings)
    values = of_run(record, "run/")
    for number in attribute(result, "numbers"):
        entries = ("value", "sigma", "interval", "determined")
        values |= {
            f"{number.name}/{entry}": np.array(attribute(number, entry)) for entry in entries
        }
    for name in ("shared", "information"):
        values[name] = np.array(attribute(attribute(result, "estimate"), name))
    return {**values, "inflation": np.array(attribute(result, "inflation"))}


def driven(duration: float) -> Any:
    """The record of a vehicle without its arm whose thrusters get random thrust for a duration
    [s].
    """
    robot = uo.without_arm(uo.load_robot("bluerov2_alpha5"))
    there = uo.Transition(to=uo.DONE, when=(uo.Below(quantity="PC.position_error", limit=0.1),))
    task = find("VehiclePose", "tasks")(name="PC", goal=uo.pose_at((50.0, 0.0, -20.0)))
    phase = uo.Phase(name="go", activations={"PC": 1.0}, transitions=(there,))
    thrust = 6.0 * np.random.default_rng(0).normal(
        size=(round(2 * duration) + 2, len(robot.thruster_names))
    )
    command = find("Command", "signals")
    still = np.zeros(robot.n_v)
    return uo.Scenario(
        name="driven",
        robot=robot,
        mission=uo.Mission(hierarchy=uo.Hierarchy([task]), phases=(phase,)),
        environment=uo.Environment(seafloor=uo.FlatSeafloor(z=-40.0)),
        start=robot.configuration(position=(0.0, 0.0, -20.0)),
        controller=lambda scenario: (
            lambda state, t: command(v=still, thrust=thrust[int(2 * t)], torque=np.zeros(0))
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
    more = {"at": find("At").PATH, "weight": 100.0} if path else {}
    follow = find("TaskTerm", "ocp")(task=find("ToolPose", "tasks")(goal=tool), **more)
    cheap = (find("Effort", "ocp")(), find("Smoothness", "ocp")(weight=0.09))
    level = find("OcpLevel", "ocp")
    ordered = (level(name="tool", terms=(follow,)), level(name="effort", terms=cheap))
    levels = [level(name="one", terms=(follow, *cheap))] if path else list(ordered)
    return find("single_phase", "ocp")(
        robot=robot,
        start=find("State", "signals")(q=q, v=np.zeros(robot.n_v)),
        duration=3.0 if path else 8.0,
        n_steps=n_steps,
        levels=levels,
        constraints=() if path else (find("AtRest", "ocp")(),),
        current=np.array([0.2, 0.0, 0.0]),
    )


def ocp(setting: Setting, plugin: str) -> Values:
    """Plan a motion of the tool by one of the solvers of nonlinear programs."""
    robot = uo.load_robot("girona_maris7_full")
    problem = reach_problem(
        robot,
        robot.configuration(position=(0, 0, -5), rpy=(0, -0.06, 0.5)),
        5 if setting.quick else 20,
    )
    plan = find("Planner", "ocp")(
        problem, find("NlpOptions", "nlp")(plugin=plugin, time_limit=PATIENCE)
    ).plan()
    values = arrays_of(attribute(plan, "trajectory"))
    for level in plan.levels:
        values |= {
            f"{level.name}/{name}": np.array(attribute(level, name))
            for name in ("residual", "prices")
        }
    return {**values, "iterations": np.array(plan.iterations)}


def receding(setting: Setting, plugin: str) -> Values:
    """Run receding-horizon control by one of the solvers of steps in real time."""
    scenario = uo.scenario.reach(duration=0.1 if setting.quick else 1.0)
    problem = reach_problem(scenario.robot, scenario.start, 5 if setting.quick else 15, path=True)
    options = find("SqpOptions", "nlp")(plugin=plugin)
    nmpc = find("Nmpc", "control")
    return of_run(
        replace(
            scenario, controller=lambda _: nmpc(problem, options=options, clock=lambda: 0.0)
        ).run()
    )


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


ITEMS: dict[str, Callable[[Setting], Values]] = {
    **{
        f"{plant}-{name}": partial(run_of_case1, plant=plant, solver=solver)
        for plant in PLANTS
        for name, solver in SOLVERS.items()
    },
    "faulty-run": faulty_run,
    "load-run": load_run,
    "minimum-snap": minimum_snap,
    "campaign": campaign,
    "identification": identification,
    **{f"ocp-{name}": partial(ocp, plugin=name) for name in OCP_BACK_ENDS},
    **{f"nmpc-{name}": partial(receding, plugin=name) for name in SQP_BACK_ENDS},
    **{
        f"export-{name}-{what}": partial(of, name=name)
        for name in ("case1", "obstacle_field")
        for what, of in (("sources", exported_sources), ("replay", exported_replay))
    },
    **{f"plan-{method}": partial(plan_by_command, method=method) for method in PLANS},
}
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
    return (
        re.search(
            r"(tick|solve|viable|controller|build|processor|real)_time|wall|worker|_us(/|$)", name
        )
        is not None
    )


def of_run(record: Any, prefix: str = "") -> Values:
    """The series of a record, and the numbers of its report."""
    series = {
        f"{prefix}{name}": array for name, array in record.series.items() if array.dtype.kind != "U"
    }
    numbers = dict(numbers_in(uo.summarize(record), f"{prefix}report"))
    return {name: array for name, array in (series | numbers).items() if not is_clock(name)}


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
    found = {f"{prefix}{one.name}": getattr(value, one.name) for one in fields(value)}
    return {name: array for name, array in found.items() if isinstance(array, np.ndarray)}


def stored(path: Path) -> Values:
    """The arrays of a file, but for times of computation."""
    with np.load(path) as file:
        return {name: file[name] for name in file.files if not is_clock(name)}


# How it is compared
# ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdict:
    """On one item."""

    difference: float
    """largest of all arrays, each relative to its own largest value; infinite where counts, flags
    or shapes differ.
    """
    text: str


def judged(golden: Values, now: Values) -> Verdict:
    """Compare all golden arrays with those of the same names, or else of the same bits."""
    wanted = {renamed(name): _renamed_text(array) for name, array in golden.items()}
    spare = {name: array for name, array in now.items() if name not in wanted}
    differences = {}
    notes = []
    for name, array in wanted.items():
        other = now.get(name)
        if other is None:
            same = next((key for key, each in spare.items() if same_bits(array, each)), None)
            other = None if same is None else spare.pop(same)
            notes.append(f"{name} is missing" if same is None else f"{name} is now {same}")
        if other is None or not same_bits(array, other):
            differences[name] = np.inf if other is None else difference(array, other)
    if spare:
        notes.append(f"new: {', '.join(sorted(spare)[:5])}{', ...' if len(spare) > 5 else ''}")
    largest = max(differences.values(), default=0.0)
    if not differences:
        text = f"same bits ({len(wanted)} arrays)"
    else:
        worst = sorted(differences, key=lambda name: -differences[name])
        told = ", ".join(f"{name} {differences[name]:.3g}" for name in worst[:5])
        text = (
            f"largest relative difference {largest:.3g} ({len(worst)} of {len(wanted)} arrays:"
            f" {told})"
        )
    return Verdict(difference=largest, text="; ".join([text, *notes]))


def _renamed_text(array: np.ndarray) -> np.ndarray:
    """Identifiers in sources by their names of today."""
    return np.array(renamed(str(array))) if array.dtype.kind == "U" and array.shape == () else array


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
    return float(gap / scale) if np.isfinite(gap) and scale > 0.0 else np.inf


def processor_time() -> float:
    """[s] of this process and of those that it has called."""
    return sum(os.times()[:4])


def carried_out(given: argparse.Namespace, names: Sequence[str]) -> bool:
    """Compute, record and compare item after item; true if none differs by more than is allowed."""
    fine = True
    with tempfile.TemporaryDirectory() as work:
        setting = Setting(work=Path(work), quick=given.quick)
        for name in names:
            begin = processor_time()
            try:
                with contextlib.redirect_stdout(io.StringIO()):
                    values = ITEMS[name](setting)
            except Exception as error:  # the others are still worth knowing
                if given.trace:
                    traceback.print_exc()
                verdict = Verdict(
                    difference=np.inf, text=f"failed: {type(error).__name__}: {str(error)[:300]}"
                )
            else:
                verdict = recorded_and_judged(given, name, values)
            fine &= verdict.difference <= given.tolerance
            print(f"{name}: {verdict.text} [{processor_time() - begin:.1f} s]", flush=True)
    return fine


def recorded_and_judged(given: argparse.Namespace, name: str, values: Values) -> Verdict:
    """Write the values of an item if asked to, and compare them if asked to."""
    verdict = Verdict(difference=0.0, text=f"recorded ({len(values)} arrays)")
    if given.against:
        file = given.against / f"{name}.npz"
        if not file.is_file():
            verdict = Verdict(difference=np.inf, text=f"there is no {file}")
        else:
            with np.load(file) as golden:
                verdict = judged({key: golden[key] for key in golden.files}, values)
    if given.record:
        given.record.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(given.record / f"{name}.npz", allow_pickle=False, **values)
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
    given = parser.parse_args()
    if not (given.record or given.against):
        parser.error("nothing to do; give --record FOLDER, --against FOLDER or both")
    for pair in given.renamed:
        old, equals, new = pair.partition("=")
        if not (old and equals and new):
            parser.error(f"--renamed {pair}; give OLD=NEW")
        RENAMED[old] = new
    if shutil.which("cc") is None:
        parser.error("a C compiler `cc` is needed")
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # of the commands that are called
    os.environ["UVMS_OCP_COMPILE_TIMEOUT"] = (
        "7200"  # what is not compiled in time may differ in the last bits
    )
    names = given.only or [name for name in ITEMS if not (given.quick and name in SLOW)]
    if not carried_out(given, names):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
