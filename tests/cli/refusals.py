"""Commands that are refused. As a program it calls the commands that it is given, one by one, and
prints the outcome of each.
"""

from __future__ import annotations

import json
import shlex
import shutil
import sys
import traceback
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.tables import write_recording

RECORD = Path(__file__).parents[1] / "records" / "run_v0_1.npz"
MISSION = """
from dataclasses import replace

import uvms_ocp as uo
from uvms_ocp.robot.signals import State

def scenario(**options):
    return uo.scenario.reach(**options)

def fixed(robot="bluerov2_alpha5"):
    return uo.scenario.reach(robot=robot)

def swept():
    return uo.scenario.reach(current=(2.0, 0.0, 0.0))

def nothing():
    return 3

def late():
    raise RuntimeError("no boat\\nno cable")

def bad_solver():
    return uo.scenario.reach(solver=Broken)

class Broken:
    takes_forces = False

    def __init__(self, scenario):
        self.state = State(q=scenario.start, v=[0.0] * scenario.robot.n_v)

    def step(self, command, dt):
        self.state = None

    def telemetry(self):
        return {}

def broken():
    return replace(uo.scenario.reach(duration=60.0), plant=Broken)

def no_frame():
    return uo.scenario.case1(tasks={"T": {"frame": "tol"}})

word = "reach"
"""
VARY = """
from uvms_ocp.campaign import Normal, Variation

variations = [Variation("{}", Normal(0.0, 0.1))]
"""
FILES = {
    "mission.py": MISSION,
    "raises.py": "x = 1\nraise ValueError('two\\nlines')\n",
    "syntax.py": "def scenario(:\n",
    "vary.py": VARY.format("start.x"),
    "vary_unknown.py": VARY.format("start.w"),
    "vary_raises.py": "raise ValueError('two\\nlines')\n",
    "vary_word.py": "variations = 'word'\n",
    "garbage.npz": "no record",
    "garbage.csv": "a,b\n1\n",
    "text.txt": "words",
    "bad.yaml": "obstacles: [{name: a, shape: box, size: [1, 1], position: [0, 0, 0]}]",
    "list.yaml": "[{name: a, shape: sphere, size: [1], position: [9, 9, 9]}]",
    "robots/nothing/hydrodynamics.yaml": "links: {}",
    "robots/garbage/robot.urdf": "<robot",
    "learn.yaml": """robot: bluerov2_alpha5
arm: taken off
hull: [[-0.25, -0.2, -0.15], [0.25, 0.2, 0.15]]
learn: {added_mass: {}}
""",
    "wrench.yaml": """robot: bluerov2_alpha5
arm: taken off
hull: [[-0.25, -0.2, -0.15], [0.25, 0.2, 0.15]]
commands: wrench
learn: {volume: {}}
""",
    "unknown_robot.yaml": "robot: girona\nlearn: {added_mass: {}}\n",
    "unknown_key.yaml": "robot: bluerov2_alpha5\nlearning: {added_mass: {}}\n",
    "not_free.yaml": """robot: bluerov2_alpha5
arm: taken off
hull: [[-0.25, -0.2, -0.15], [0.25, 0.2, 0.15]]
learn: {volume: {free: []}}
""",
    "taken": "a file, not a folder",
    "foreign/scene.html": "mine",
    "foreign/plan.npz": "mine",
    "foreign/report.md": "mine",
    "foreign/case1_controller.c": "mine",
    "there.py": "x = 1\n",
    "empty/readme": "",
}
_STILL = {"linear_velocity": 3, "angular_velocity": 3, "wrench": 6}
REFUSED: tuple[tuple[str, str], ...] = (
    # run
    ("run case9", "unknown scenario"),
    ("run nowhere.py", "there is no such file"),
    ("run mission.py:none", "unknown name"),
    ("run mission.py:nothing", "made a int"),
    ("run mission.py:word", "is a str"),
    ("run mission.py:late", ""),
    ("run mission.py:bad_solver", "solver"),
    ("run mission.py:fixed --plant kinematic", "takes no option plant"),
    ("run raises.py", "ValueError"),
    ("run syntax.py", "syntax.py"),
    ("run no.module:name", "there is no such module"),
    ("run --solver lexpq", "unknown solver"),
    ("run --robot girona", "unknown robot"),
    ("run --robot robots/nothing", "robot.urdf"),
    ("run --robot robots/garbage", "robot.urdf"),
    ("run --robot planar5", ""),
    ("run --robot girona_maris7 --hydrodynamics none.yaml", "none.yaml"),
    ("run --hydrodynamics bad.yaml", "without a robot"),
    ("run --robot girona_maris7 --hydrodynamics bad.yaml", "bad.yaml"),
    ("run --plant wet", "unknown plant"),
    ("run --duration -1", "give a finite time"),
    ("run --duration nan", "duration = nan"),
    ("run --duration 1e308", "a day"),
    ("run --seed -1", "seed = -1"),
    ("run --seabed nan", "seabed"),
    ("run --seabed 0", "seafloor"),
    ("run --current 300 0 0 --plant kinematic", "give at most 10 m/s"),
    ("run --fault altimetre:frozen@8", "Did you mean"),
    ("run --fault thruster9:dead@8", "the robot has 8 thrusters"),
    ("run --plant kinematic --fault thruster3:dead", "no thrusters"),
    ("run --out taken/out", "cannot write there"),
    ("run --out foreign", "not written by an earlier command"),
    ("run --follow none.npz", "none.npz"),
    ("run --follow garbage.npz", "garbage.npz"),
    ("run --follow empty", "plan.npz"),
    ("run mission.py:swept", "pre-flight refuses reach"),
    ("run mission.py:swept --json", "pre-flight refuses reach"),
    ("run mission.py:no_frame", "unknown frame"),
    ("run mission.py:no_frame --force", "unknown frame"),
    # check and mission
    ("check case9", "unknown scenario"),
    ("check raises.py", "ValueError"),
    ("check --current nan 0 0", "current"),
    ("check --robot planar5", ""),
    ("mission case9", "unknown scenario"),
    ("mission raises.py --mermaid", "ValueError"),
    # compare and show
    ("compare none other", "none"),
    ("compare run.npz none", "none"),
    ("compare run.npz garbage.npz", "garbage.npz"),
    ("compare run.npz empty", "holds no record.npz"),
    ("compare raises.py raises.py", "ValueError"),
    ("compare case1 none", "none"),
    ("compare none case1", "none"),
    ("compare case1 case9", "case9"),
    ("compare case1 empty", "holds no record.npz"),
    ("compare mission.py:fixed mission.py:none", "unknown name"),
    ("compare mission.py:fixed raises.py", "ValueError"),
    ("compare case1 garbage.npz", "garbage.npz"),
    ("show nowhere", "nowhere"),
    ("show empty", "holds no record.npz"),
    ("show run.npz --hydrodynamics water.yaml", "without a robot; give both, --robot"),
    ("show run.npz --ghost run.npz --ghost run.npz", "two ghosts"),
    ("show run.npz --ghost none.npz", "none.npz"),
    ("show run.npz --fps 0 --out page.html", "fps"),
    ("show run.npz --out taken/page.html", "cannot write there"),
    ("show garbage.npz", "garbage.npz"),
    # plans
    ("plan curve", "give one goal"),
    ("plan curve --to 2 0 -1 --robot planar5", "no free vehicle pose"),
    ("plan curve --joint joint1", "give NAME=VALUE"),
    ("plan curve --joint joint9=0.1", "unknown axis"),
    ("plan curve --joint joint1=9", "joint1 = 9"),
    ("plan curve --to 1 0 0 --axes joints", "the goal moves x"),
    ("plan curve --to 0 0 0", "way point"),
    ("plan curve --to 3 0 0 --axes arm", "unknown axes"),
    ("plan curve --to 3 0 0 --sphere 3,0,0,0.3", "is in collision"),
    ("plan curve --to 3 0 0 --sphere 0,0,0,0.3", "is in collision"),
    ("plan curve --to 3 0 0 --sphere 1,0,0", "give 4 numbers"),
    ("plan curve --to 3 0 0 --clearance 0", "clearance"),
    ("plan curve --to 3 0 0 --obstacles none.yaml", "cannot be read"),
    ("plan curve --to 3 0 0 --obstacles bad.yaml", "a box has 3 sizes"),
    ("plan curve --to 3 0 0 --obstacles list.yaml", "give a mapping"),
    ("plan curve --to 3 0 0 --robot girona", "unknown robot"),
    ("plan curve --to 3 0 0 --out taken/out", "cannot write there"),
    ("plan curve --to 3 0 0 --out foreign", "not written by an earlier command"),
    ("plan curve --to 1e6 0 0", "within 10000 m"),
    ("plan ocp --to 3 0 0 --time-limit 0", "time_limit"),
    ("plan ocp --to 3 0 0 --nlp snopt", "unknown NLP solver"),
    ("plan ocp --to 3 0 0 --steps 0", "n_steps = 0"),
    ("plan ocp --to 3 0 0 --current nan 0 0", "current"),
    ("plan ocp --to 3 0 0 --duration 0", "duration"),
    ("plan ocp --to 3 0 0 --sphere 0,0,0,0.3", "the start is in collision"),
    ("plan ocp --to 3 0 0 --sphere 3,0,0,0.5", "the goal is in collision"),
    ("plan ocp --tool 1 0 -2 --seabed -1.5", "seafloor - tool"),
    ("plan ocp --joint joint1=9", "joint 'joint1': given 9"),
    ("plan ocp --joint joint9=9", "unknown"),
    ("plan ocp --to 3 0 0 --out foreign", "not written by an earlier command"),
    ("plan mission nothing", "unknown scenario"),
    ("plan mission transit", "the floor rises"),
    ("plan mission reach --nlp none", "unknown NLP solver"),
    ("plan mission reach --within -1", "duration"),
    ("plan mission reach --step 0", "step"),
    ("plan mission reach --step nan", "step"),
    ("plan mission reach --time-limit 0", "time_limit"),
    ("plan mission reach --out foreign", "not written by an earlier command"),
    ("plan mission raises.py", "ValueError"),
    ("plan mission reach --current 300 0 0", "give at most 10 m/s"),
    ("plan mission reach --robot planar5", ""),
    ("plan mission mission.py:no_frame", "unknown frame"),
    # campaigns
    ("campaign case9", "unknown scenario"),
    ("campaign case1 --sampler sobel", "Did you mean"),
    ("campaign case1 --report", "no campaign is there"),
    ("campaign case1 --rerun 1", "no campaign is there"),
    ("campaign case1 --vary nowhere.py", "there is no such file"),
    ("campaign case1 --vary vary.txt", "no Python code"),
    ("campaign case1 --vary vary_unknown.py", "start.w"),
    ("campaign case1 --vary vary_raises.py", "ValueError"),
    ("campaign case1 --vary vary_word.py", ""),
    ("campaign case1 --vary vary.py --records some", "records"),
    ("campaign case1 --vary vary.py --runs 0", "runs"),
    ("campaign case1 --vary vary.py --workers 0", "workers"),
    ("campaign case1 --vary vary.py --time-limit 0", "time_limit"),
    ("campaign case1 --vary vary.py --out taken/c", ""),
    ("campaign case1 --vary vary.py --success words", ""),
    ("campaign case1 --vary vary.py --success unknown<3", ""),
    ("campaign case1 --vary vary.py --fault altimetre:frozen@8", "Did you mean"),
    ("campaign case1 --vary vary.py --seed -1", "seed"),
    ("campaign raises.py --vary vary.py", "ValueError"),
    ("campaign nothing.py --parameters", "there is no such file"),
    ("campaign mission.py:swept --vary vary.py", "pre-flight refuses the mission itself"),
    ("campaign mission.py:swept --vary vary.py --json", "pre-flight refuses the mission itself"),
    # recordings
    ("excite none.yaml --out out", "none.yaml"),
    ("excite bad.yaml --out out", "bad.yaml"),
    ("excite unknown_robot.yaml --out out", "unknown"),
    ("excite unknown_key.yaml --out out", "learning"),
    ("excite wrench.yaml --out out", "commands: thrust"),
    ("excite learn.yaml --share 0 --out out", "--share"),
    ("excite learn.yaml --duration 0 --out out", "duration"),
    ("excite learn.yaml --slew -1 --out out", "slew"),
    ("excite learn.yaml --pool 0 0 0 --out out", "pool"),
    ("excite learn.yaml --pool 0.1 0.1 0.1 --out out", "pool"),
    ("excite learn.yaml --out foreign", "not written by an earlier command"),
    ("excite not_free.yaml --out out", "nothing in it is free"),
    ("identify learn.yaml none.csv --out out", "there is no such file"),
    ("identify learn.yaml garbage.csv --out out", "garbage.csv"),
    ("identify none.yaml drive.csv --out out", "none.yaml"),
    ("identify learn.yaml drive.csv --out out", "no thrust is recorded"),
    ("identify learn.yaml drive.csv --mapping none.yaml --out out", "none.yaml"),
    ("identify wrench.yaml drive.csv --leave-one-out --out out", "at least 2"),
    ("identify not_free.yaml drive.csv --out out", "nothing in it is free"),
    ("identify wrench.yaml drive.csv --out foreign", "not written by an earlier command"),
    ("check-recording none.csv", "there is no such file"),
    ("thruster-curve none.csv --pwm a --thrust b", "there is no such file"),
    (
        "thruster-curve drive.csv --pwm a --thrust b --unit stone",
        "unknown unit 'stone'; known: N, kgf",
    ),
    ("thruster-curve drive.csv --pwm a --thrust b --at 16", "--voltage and --at belong together"),
    ("thruster-curve drive.csv --pwm a --thrust b", "unknown column of drive.csv 'a'"),
    ("check-recording garbage.csv", "garbage.csv"),
    ("check-recording drive.csv --mapping none.yaml", "none.yaml"),
    # robots and files
    ("check-robot girona", "unknown robot"),
    ("check-robot girona_maris7 --base wheels", "given 'wheels'"),
    ("check-robot girona_maris7 --mimic follow", "mimic"),
    ("new-mission mission.txt", "give the name of a Python file"),
    ("new-mission there.py", "is there already"),
    ("new-mission new.py --robot robots/garbage", ""),
    ("new-robot taken", ""),
    # export
    ("export controller case9 out", "unknown scenario"),
    ("export controller case1 taken/c", "cannot write there"),
    ("export controller case1 foreign", "not written by an earlier command"),
    ("export controller raises.py out", "ValueError"),
    ("export controller mission.py:no_frame out", "unknown frame"),
    ("export controller case1 out --plant wet", "unknown plant"),
    ("export controller case1 out --name 2nd", "give an identifier of C"),
    ("export controller case1 out --name left-arm", "give an identifier of C"),
    ("export controller case1 out --robot girona", "unknown robot"),
)


def furnish(folder: Path) -> None:
    """Fill a folder with the files that the commands name."""
    for name, text in FILES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    shutil.copy(RECORD, folder / "run.npz")
    t = np.arange(0.0, 8.0, 0.1)
    still = {name: Channel(t=t, values=np.zeros((len(t), n))) for name, n in _STILL.items()}
    attitude = Channel(t=t, values=np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))
    write_recording(
        Recording(name="drive", channels={"attitude": attitude, **still}), folder / "drive.csv"
    )


def told_of(words: str) -> dict[str, Any]:
    """Call a command in this process; return its exit code, what it prints, and the traceback of any
    other error, such as of an attempt to compile.
    """
    from uvms_ocp.cli.commands import main

    sys.argv = ["uvms-ocp", *shlex.split(words)]
    out = StringIO()
    err = StringIO()
    code = 0
    reached = ""
    with redirect_stdout(out), redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            code = end.code
        except BaseException:
            reached = traceback.format_exc()
    return {"code": code, "out": out.getvalue(), "err": err.getvalue(), "reached": reached}


class CompilesError(BaseException):
    """A compiler was looked for, which no command that is refused may do."""


def _compiles() -> None:
    raise CompilesError


def call(commands: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Call each command in the working directory; looking for a compiler is an error."""
    from uvms_ocp.codegen import c_compiler

    c_compiler.find_compiler = _compiles  # type: ignore[assignment]
    furnish(Path.cwd())
    refusals = {}
    before = _files()
    for words in commands:
        refusals[words] = told_of(words) | {"new": sorted(_files() - before)}
    return refusals


def _files() -> set[str]:
    return {str(path) for path in Path.cwd().rglob("*") if "__pycache__" not in path.parts}


if __name__ == "__main__":
    sys.stdout.write(json.dumps(call(sys.argv[1:])))
