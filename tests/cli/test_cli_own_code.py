"""Every command that takes a scenario takes a file, a name in a file and a name in a module, with
any robot and water.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from refusals import told_of
from typer.testing import CliRunner

from uvms_ocp.campaign.code_source import CodeSource
from uvms_ocp.cli.commands import app
from uvms_ocp.cli.options import build_scenario
from uvms_ocp.errors import InvalidInput

COMMANDS = {
    "run": ("run", "{}"),
    "check": ("check", "{}"),
    "mission": ("mission", "{}"),
    "export": ("export", "controller", "{}", "out"),
    "campaign": ("campaign", "{}", "--parameters"),
    "plan": ("plan", "mission", "{}"),
    "compare": ("compare", "{}", "{}"),
}
FORMS = ("mission.py", "mission.py:other", "package.module:other")
MISSION = """
import uvms_ocp as uo

def scenario(**options):
    return uo.scenario.reach(**options)

def other(robot="bluerov2_alpha5", plant="kinematic"):
    return uo.scenario.reach(robot=robot, plant=plant, duration=5.0)
"""


class Asked(Exception):
    """For a scenario."""


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "__init__.py").touch()
    for path in (tmp_path / "mission.py", tmp_path / "package" / "module.py"):
        path.write_text(MISSION)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_builds_what_is_asked_for(
    command: str, form: str, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked(words: str, options: Mapping[str, Any], *_: Any) -> None:
        raise Asked(words, options.get("robot"), options.get("hydrodynamics"))

    monkeypatch.setattr("uvms_ocp.scenario.own_code.load_scenario", asked)
    words = [word.format(form) for word in COMMANDS[command]]
    machine = ["--robot", "my.urdf", "--hydrodynamics", "my.yaml"] if command != "compare" else []
    with pytest.raises(Asked) as told:
        CliRunner().invoke(app, [*words, *machine], catch_exceptions=False)
    assert told.value.args == (form, *(machine[1::2] or (None, None)))


@pytest.mark.parametrize("form", FORMS)
def test_each_form_is_built(form: str, place: Path) -> None:
    scenario = build_scenario(form, {"plant": "kinematic"})
    assert (scenario.plant, scenario.robot.name) == ("kinematic", "bluerov2_alpha5")
    assert (scenario.duration == 5.0) == form.endswith("other")


def test_two_missions_are_run_and_compared(place: Path) -> None:
    told = CliRunner().invoke(
        app, ["compare", "mission.py:other", "package.module:other", "--json"]
    )
    assert told.exit_code == 0, told.output
    assert '"change": 0.0' in told.stdout


WITHIN = """
from dataclasses import replace

import uvms_ocp as uo
from uvms_ocp.robot import Command

class Deaf:
    def __init__(self, scenario):
        pass

    def __call__(self, measurement, t):
        {tick}

def scenario():
    {scenario}
    return replace(uo.scenario.reach(plant="kinematic", duration=60.0), controller=Deaf)
"""
FAILURES = {
    "of a function": (
        WITHIN,
        {"scenario": "raise RuntimeError('two\\nlines')"},
        ":15: RuntimeError: two lines",
    ),
    "that ends the program": (WITHIN, {"scenario": "raise SystemExit(0)"}, ":15: SystemExit: 0"),
    "without end": (WITHIN, {"scenario": "scenario()"}, ":15: RecursionError: "),
    "of a file that ends the program": ("import sys\nsys.exit(0)\n", {}, ":2: SystemExit: 0"),
    "in the middle of a run": (WITHIN, {"tick": "raise KeyError(t)"}, ":12: KeyError: 0.0"),
    "that ends a run": (WITHIN, {"tick": "raise SystemExit"}, ":12: SystemExit"),
}


@pytest.mark.parametrize("kind", FAILURES)
def test_a_failure_of_ones_own_code_is_one_line_and_more_if_asked_for(
    kind: str, place: Path
) -> None:
    text, lines, message = FAILURES[kind]
    path = place / f"failing{len(kind)}.py"
    path.write_text(text.format(**{"scenario": "pass", "tick": "pass", **lines}) if lines else text)
    for command in ("run", "check") if "tick" not in lines else ("run",):
        told = told_of(f"{command} {shlex.quote(str(path))}")
        assert (told["code"], told["err"].count("\n"), told["out"], told["reached"]) == (
            2,
            1,
            "",
            "",
        )
        assert f"error: {path}{message}" in told["err"]
        more = told_of(f"{command} {shlex.quote(str(path))} --traceback")
        assert more["code"] == 2
        assert more["err"].endswith(told["err"])
        assert "Traceback (most recent call last)" in more["err"]


@pytest.mark.slow
def test_stdout_is_json_whatever_a_mission_prints(place: Path) -> None:
    (place / "chatty.py").write_text(
        WITHIN.format(scenario="print('made')", tick="print(t); return Command(v=[0.0] * 10)")
        + "print('read')\n"
    )
    told = told_of("run chatty.py --json --out out")
    assert told["code"] == 3, told
    assert json.loads(told["out"])["completed"] is False
    assert {"made", "read", "0.0"} <= set(told["err"].split())


@pytest.mark.slow
def test_stdout_is_json_whatever_a_program_prints_that_a_mission_starts(place: Path) -> None:
    started = (
        "import os\nimport subprocess\nimport sys\n\nimport uvms_ocp as uo\n\n\ndef"
        " scenario(**options):\n"
    )
    started += (
        "    subprocess.run([sys.executable, '-c', 'print(\"started\")'])\n    os.write(1,"
        " b'written\\n')\n"
    )
    started += "    return uo.scenario.case1(plant='kinematic')\n"
    (place / "starts.py").write_text(started)
    words = [sys.executable, "-m", "uvms_ocp", "check", "starts.py", "--json"]
    done = subprocess.run(words, capture_output=True, text=True, cwd=place, check=False)
    assert json.loads(done.stdout)["accepted"] is True
    assert {"started", "written"} <= set(done.stderr.split())


@pytest.mark.parametrize(
    "words", ["os:system", "subprocess:run", "os.path:exists", "builtins:exec"]
)
def test_words_call_nothing_of_python_itself(
    words: str, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    called: list[object] = []
    monkeypatch.setattr("os.system", called.append)
    with pytest.raises(InvalidInput, match="is of Python itself"):
        CodeSource(words=words, options={"command": "true"}).build()
    assert not called
