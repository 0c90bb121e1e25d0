"""Any options: exit 0, 2 or 3 and one line; what takes days or gigabytes is refused with the
reason.

Commands are called in this process and end where the work would begin.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest
from drawing import chosen, either, floats, integers, texts
from hypothesis import given, settings, strategies as st
from promises import Tally

import uvms_ocp.ocp.request
import uvms_ocp.planning.request
import uvms_ocp.robot.loading
import uvms_ocp.scenario.options
from uvms_ocp.cli.commands import main
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.scenario.scenario import Scenario

pytestmark = pytest.mark.slow


class BeginsError(Exception):
    """The options are good, and the work would begin."""


def begins(*_: Any, **__: Any) -> Any:
    raise BeginsError


@pytest.fixture
def in_front(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """A folder of its own, robots that are loaded once, and no work."""
    monkeypatch.chdir(tmp_path)
    loaded = lru_cache(load_robot)

    def once(*files: Any, **loading: Any) -> Any:
        return load_robot(*files, **loading) if any(loading.values()) else loaded(*files)

    for module in (uvms_ocp.robot.loading, uvms_ocp.scenario.options):
        monkeypatch.setattr(module, "load_robot", once)
    monkeypatch.setattr(uvms_ocp.planning.request, "plan_soft_collision", begins)
    monkeypatch.setattr(uvms_ocp.planning.request, "tool_goal", begins)
    monkeypatch.setattr(uvms_ocp.ocp.request, "Planner", begins)
    monkeypatch.setattr(Scenario, "check", begins)
    yield
    assert list(tmp_path.iterdir()) == []


def called(
    words: Sequence[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> tuple[int, str]:
    """Exit code and what was said on stderr; 0 too where the work would begin."""
    monkeypatch.setattr(sys, "argv", ["uvms-ocp", *words])
    code: Any = 0
    try:
        main()
    except BeginsError:
        pass
    except SystemExit as end:
        code = end.code or 0
    return code, capsys.readouterr().err


OCP = ("plan", "ocp", "--to", "3", "0", "0")
CURVE = ("plan", "curve", "--to", "3", "0", "0")
RUN = ("run", "reach")
BOUNDED = [
    ((*RUN, "--duration", "1e308"), "duration = 1e+308 s; give at most 86400 s, a day"),
    ((*RUN, "--duration", "inf"), "duration = inf s; give a finite time > 0"),
    ((*RUN, "--seabed", "-1e300"), "give a finite height [m] from -100000 to 100000"),
    ((*RUN, "--current", "1e300", "0", "0"), "m/s; give at most"),
    (
        ("plan", "curve", "--to", "1e6", "0", "0"),
        "is 1e+06 m from the start; give one within 10000 m: a plan is proven clear",
    ),
    (
        ("plan", "ocp", "--to", "1e6", "0", "0"),
        "is 1e+06 m from the start; give one within 10000 m",
    ),
    (("plan", "curve", "--tool", "0", "1e308", "0"), "from the start; give one within 10000 m"),
    ((*CURVE, "--seed", "-1"), "seed = -1; give a whole number >= 0"),
    ((*RUN, "--seed", "-1"), "seed = -1; give a whole number >= 0"),
    (
        (*RUN, "--seed", "9" * 23),
        "give a whole number >= 0, of at most 9223372036854775807 in size",
    ),
    (
        (*CURVE, "--seed", "9" * 23),
        "give a whole number >= 0, of at most 9223372036854775807 in size",
    ),
    ((*CURVE, "--position", "1e9", "0", "0"), "from the start; give one within 10000 m"),
    (("plan", "curve", "--to-rpy", "0", "0", "1e9"), "give angles within two turns, 12.57 rad"),
    ((*OCP, "--steps", "1000000"), "n_steps = 1000000; give at most 2000: each step takes"),
    ((*OCP, "--duration", "1e308"), "duration 1e+308 s; give at most 86400 s, a day"),
    ((*OCP, "--time-limit", "1e300"), "time_limit = 1e+300 s; give at most 86400 s, a day"),
    ((*CURVE, "--sphere", "1e300,0,0,1"), "less than or equal to 100000"),
    ((*CURVE, "--box", "1,0,0,1,1,1e300"), "less than or equal to 100000"),
]


@pytest.mark.parametrize(
    ("words", "message"),
    BOUNDED,
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
@pytest.mark.usefixtures("in_front")
def test_what_has_no_end_is_refused_with_a_reason(
    words: tuple[str, ...],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    code, printed = called(words, monkeypatch, capsys)
    assert code == 2
    assert message in printed
    assert len(printed.strip().splitlines()) == 1


@pytest.mark.parametrize(
    "words",
    [OCP, CURVE, RUN, (*RUN, "--duration", "20000"), (*OCP, "--steps", "2000")],
    ids=" ".join,
)
@pytest.mark.usefixtures("in_front")
def test_what_has_one_begins(words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["uvms-ocp", *words])
    with pytest.raises(BeginsError):
        main()


_ODD_NUMBERS = (
    "",
    "x",
    "nan",
    "inf",
    "-inf",
    "1e308",
    "1e-320",
    "0",
    "-0.0",
    "1,5",
    "1_0",
    "0x10",
    "\u0663",
    "--",
    "1e400",
)
_ODD_WORDS = ("", "planar5", "[/]", "$\\frac{$", "a\nb", "../x")
_number = either(floats().map(repr), integers(10**12, -(10**12)).map(str), chosen(_ODD_NUMBERS))
_words = either(texts(max_size=6).filter(lambda text: "\0" not in text), chosen(_ODD_WORDS))
_NUMBERS = {
    "run": {"--duration": 1, "--seabed": 1, "--seed": 1, "--current": 3},
    "plan curve": {
        "--to": 3,
        "--to-rpy": 3,
        "--position": 3,
        "--rpy": 3,
        "--tool": 3,
        "--clearance": 1,
        "--seed": 1,
    },
    "plan ocp": {
        "--duration": 1,
        "--steps": 1,
        "--time-limit": 1,
        "--current": 3,
        "--to": 3,
        "--clearance": 1,
    },
}
_WORDS = {
    "run": ("--robot", "--plant", "--solver"),
    "plan curve": ("--robot", "--joint", "--sphere", "--box", "--obstacles", "--axes"),
    "plan ocp": ("--robot", "--joint", "--sphere", "--box", "--obstacles", "--nlp"),
}


@st.composite
def options(draw: st.DrawFn) -> list[str]:
    """A command that would begin, with one to three options of any value."""
    command = draw(chosen(sorted(_NUMBERS)))
    words = [*command.split(), *(("reach",) if command == "run" else ("--to", "3", "0", "0"))]
    for _ in range(draw(integers(3, 1))):
        if draw(st.booleans()):
            name = draw(chosen(sorted(_NUMBERS[command])))
            words += [name, *(draw(_number) for _ in range(_NUMBERS[command][name]))]
        else:
            words += [draw(chosen(_WORDS[command])), draw(_words)]
    return words


@pytest.mark.usefixtures("in_front")
def test_any_options_begin_or_are_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tally = Tally(bad=300)

    @settings(max_examples=450)
    @given(options())
    def holds(words: list[str]) -> None:
        code, printed = called(words, monkeypatch, capsys)
        assert code in (0, 2, 3), printed
        assert "Traceback" not in printed
        if code:
            assert printed.strip()
        if printed.startswith("error: "):
            assert len(printed.strip().splitlines()) == 1
        tally.bad = tally.bad + (code == 2)
        tally.good = tally.good + (code == 0)

    holds()
    tally.check()
