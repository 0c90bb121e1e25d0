"""Mistakes in the options of a plan: one line on stderr, exit code 2, nothing written; and what the
help tells.
"""

from __future__ import annotations

import inspect
from pathlib import Path

import pytest
from command_line import called

from uvms_ocp.cli import plan
from uvms_ocp.cli.option_groups import expand_options
from uvms_ocp.ocp.request import OcpRequest
from uvms_ocp.planning.request import PlanRequest


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["curve"], "give one goal"),
        (
            ["curve", "--to", "2", "0", "-1", "--robot", "planar5"],
            "--to: planar5 has no free vehicle pose; give --joint NAME=Q",
        ),
        (["ocp", "--to", "2", "0", "-1", "--robot", "planar5"], "with any of x0"),
        (
            ["curve", "--joint", "x0=1", "--rpy", "0", "0", "1", "--robot", "planar5"],
            "--rpy: planar5 has no free vehicle pose",
        ),
        (
            ["ocp", "--to", "3", "0", "0", "--time-limit", "0"],
            "time_limit = 0.0; give a number > 0",
        ),
        (
            ["curve", "--to", "3", "0", "0", "--obstacles", "list.yaml"],
            "give a mapping such as obstacles: [{name: ball",
        ),
        (["ocp", "--to", "3", "0", "0", "--nlp", "snopt"], "unknown NLP solver 'snopt'"),
        (["ocp", "--to", "3", "0", "0", "--steps", "0"], "n_steps = 0; give a whole number >= 1"),
        (
            ["ocp", "--to", "3", "0", "0", "--current", "nan", "0", "0"],
            "current[0] = nan; give a number, finite",
        ),
        (
            ["ocp", "--to", "3", "0", "0", "--sphere", "0,0,0,0.3"],
            "the start is in collision: sphere1",
        ),
        (["curve", "--tool", "1", "0", "0", "--joint", "joint1=0"], "give one goal"),
        (["curve", "--tool-rpy", "1", "0", "0"], "give one goal"),
        (["curve", "--tool", "nan", "0", "0"], "position[0] = nan; give a number, finite"),
        (["curve", "--joint", "joint1"], "give NAME=VALUE"),
        (["curve", "--joint", "joint9=0.1"], "unknown axis 'joint9'"),
        (["curve", "--joint", "joint1=9"], "the goal) has joint1 = 9"),
        (["curve", "--to", "1", "0", "0", "--axes", "joints"], "the goal moves x"),
        (["curve", "--to-rpy", "0.5", "0", "0"], "the goal moves roll"),
        (["curve", "--to", "0", "0", "0"], "way point"),
        (["curve", "--to", "3", "0", "0", "--axes", "arm"], "unknown axes 'arm'"),
        (
            ["curve", "--to", "3", "0", "0", "--sphere", "3,0,0,0.3"],
            "(the goal) is in collision: sphere1",
        ),
        (
            ["curve", "--to", "3", "0", "0", "--sphere", "0,0,0,0.3"],
            "(the start) is in collision: sphere1",
        ),
        (["curve", "--to", "3", "0", "0", "--sphere", "1,0,0"], "give 4 numbers"),
        (["curve", "--to", "3", "0", "0", "--sphere", "1,0,0,-1"], "greater than 0"),
        (["curve", "--to", "3", "0", "0", "--box", "1,0,0,a,1,1"], "give 6 numbers"),
        (
            ["curve", "--to", "3", "0", "0", "--clearance", "0"],
            "clearance = 0.0; give a number > 0",
        ),
        (["curve", "--to", "3", "0", "0", "--obstacles", "none.yaml"], "cannot be read"),
        (
            ["curve", "--to", "3", "0", "0", "--obstacles", "bad.yaml"],
            "obstacles.0: a box has 3 sizes, not 2",
        ),
        (["curve", "--to", "3", "0", "0", "--robot", "girona"], "unknown robot 'girona'"),
        (["curve", "--to", "3", "0", "0", "--out", "bad.yaml/out"], "cannot write there"),
    ],
)
def test_mistakes_get_one_line_and_exit_code_2(
    arguments: list[str], message: str, tmp_path: Path
) -> None:
    (tmp_path / "bad.yaml").write_text(
        "obstacles: [{name: a, shape: box, size: [1, 1], position: [0, 0, 0]}]"
    )
    (tmp_path / "list.yaml").write_text(
        "[{name: a, shape: sphere, size: [1], position: [9, 9, 9]}]"
    )
    process = called("plan", *arguments, cwd=tmp_path)
    assert process.returncode == 2
    assert message in process.stderr
    assert len(process.stderr.strip().splitlines()) == 1
    assert process.stdout == ""
    assert {path.name for path in tmp_path.iterdir()} == {"bad.yaml", "list.yaml"}


def test_the_help_tells_all_methods_in_a_line_each() -> None:
    lines = called("plan", "--help", cwd=Path()).stdout.splitlines()
    commands = lines[lines.index("Commands:") + 1 :]
    assert [line.split()[0] for line in commands] == ["curve", "ocp", "mission"]
    assert "shapes alone" in commands[0]
    assert "water" in commands[1]
    assert not any(line.endswith("...") for line in commands)


@pytest.mark.parametrize(
    ("method", "option"),
    [("curve", "--duration"), ("curve", "--current"), ("ocp", "--axes"), ("ocp", "--seed")],
)
def test_an_option_of_the_other_method_is_unknown(method: str, option: str) -> None:
    process = called("plan", method, "--to", "3", "0", "0", option, "1", cwd=Path())
    assert process.returncode == 2
    assert f"No such option: {option}" in process.stderr


def options_of(method: str) -> dict[str, object]:
    """Names and defaults of the options of a command."""
    command = expand_options(getattr(plan, method))
    return {name: option.default for name, option in inspect.signature(command).parameters.items()}


def test_options_that_both_methods_have_are_the_same_and_come_first() -> None:
    curve = list(options_of("curve"))
    ocp = list(options_of("ocp"))
    shared_options = [name for name in curve if name in ocp and name not in ("out", "as_json")]
    assert shared_options == curve[: len(shared_options)] == ocp[: len(shared_options)]
    assert curve[len(shared_options) :] == ["axes", "seed", "out", "as_json"]
    assert ocp[len(shared_options) :] == [
        "duration",
        "steps",
        "current",
        "seabed",
        "time_limit",
        "nlp",
        "out",
        "as_json",
    ]


def test_options_default_to_what_the_requests_have() -> None:
    fields = {"steps": "n_steps", "nlp": "plugin"}
    for method, request in (("curve", PlanRequest), ("ocp", OcpRequest)):
        defaults = {
            name: parameter.default
            for name, parameter in inspect.signature(request).parameters.items()
        }
        for name, default in options_of(method).items():
            field = fields.get(name, name)
            if default is None or name == "obstacles":
                continue  # what the request has
            if field in defaults and defaults[field] is not inspect.Parameter.empty:
                assert default == defaults[field]
