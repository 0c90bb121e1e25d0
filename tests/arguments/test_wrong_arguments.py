"""A wrong argument is named, in one line, by the call that took it: every wrong value for every
argument of everything public.

No argument may be of a type that nothing here takes; of other wrong values some are right
somewhere.
"""

from __future__ import annotations

import inspect
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from public_surface import Call, surface
from valid_calls import (
    EXPENSIVE,
    POOL,
    REFUSES,
    STARRED,
    owner_of,
    right_arguments,
    robot,
    scenario,
)

import uvms_ocp as uo
from uvms_ocp import identification
from uvms_ocp.errors import ArgumentNotFound, InvalidInput, UvmsError
from uvms_ocp.reference.cited_names import exported_names
from uvms_ocp.robot.signals import Command, Reading, Readings
from uvms_ocp.sim import UniformCurrent
from uvms_ocp.solvers import Icat
from uvms_ocp.tasks import MinimumAltitude

CALLS = surface()
WORDS = {
    "faults": ("fault",),
    "limit": ("threshold",),
    "tolerance": ("threshold",),
    "q0": ("q",),
    "written": ("q",),
    "start": ("q",),
    "reference": ("q",),
    "posture": ("joints",),
    "waypoints": ("way points?",),
    "quantities": ("quantity",),
    "p": ("parameters",),
    "order": ("task",),
    "density": ("water_density",),
    "dt": ("control period",),
    "factor": ("break",),
    "floor_z": ("z",),
    "heights": ("height",),
    "joints": ("joint",),
    "position": ("goal",),
    "axes": ("axis",),
    "curves": ("curve",),
    "times": ("time",),
    "when": ("conditions",),
}
"""What messages call a parameter."""


def _paced(call: Call) -> Any:
    """With its mark: these two simulate before they refuse."""
    return pytest.param(call, marks=pytest.mark.slow) if call.title == "plan_mission" else call


def _nothing() -> None:
    """A function of no arguments."""


WRONG_TYPES = (object(), 1j, ..., {3: object()}, np.array(["a"]), np.array([object()]))
NAN = float("nan")
ACCEPTED = {
    (
        "PassThrough.__call__",
        "command",
    ): "not read, and taken only to stand where an `Estimator` does"
}
"""Parameters that may be of any type, and why."""
MAY_BE_NAN = (
    *("t", "x", "y"),  # at which something is asked: the answer is NaN
    *(
        "value",
        "altimeter_range",
        "altimeter_std",
        "age",
        "joint_age",
        "since",
    ),  # as measured, before there was anything
    *("solve_time", "violation", "cost", "distance", "squared"),  # of results
)
"""Parameters that take NaN where they take numbers. For all others it is no number."""
WRONG: tuple[Any, ...] = (
    *WRONG_TYPES,
    *(None, "nonsense", "", b"bytes", "a\0b", "two\nlines"),
    *(True, 0, -1, 3, 10**30, 0.5, -1.0, 1e308, NAN, float("inf")),
    *((), [], {}),
    [object()],
    ["a", "b"],
    [1.0, [2.0, 3.0]],
    {"nonsense": 1.0},
    np.zeros(0),
    np.zeros(2),
    np.zeros((2, 3)),
    np.zeros(1000),
    np.full(3, np.nan),
    np.full((3, 3), np.inf),
    _nothing,
)


ANY_NORM = {
    **dict.fromkeys(
        ("State.q", "StateEstimate.q"), "as integrated or measured: whoever uses it looks"
    ),
    **dict.fromkeys(
        ("PlanRequest.start", "OcpRequest.start", "Setup.start"),
        "looked at where it is planned or checked",
    ),
    **dict.fromkeys(
        ("Robot.joint_values.q", "Robot.with_joint_values.q"), "of which joints alone are read"
    ),
    **dict.fromkeys(
        ("ToolGoal.as_tasks.start", "PostureGoal.as_tasks.start", "Term.references.q"),
        "not read here",
    ),
    **dict.fromkeys(
        ("Ball.centre_in_world.q", "BallClearance.references.q", "Coordinates.x_beyond_limits.q"),
        "of motions that are judged and drawn as they are",
    ),
}
"""Configurations whose quaternion may have any norm, and why."""
SHAPES: dict[str, tuple[tuple[int, ...], ...]] = {
    **dict.fromkeys(("position", "angular_velocity", "linear_velocity"), ((3,),)),
    "attitude": ((4,),),
    **dict.fromkeys(("joint_positions", "joint_velocities"), ((2,), (3,), (4,), (5,))),
    **dict.fromkeys(("depth", "altimeter_range"), ((),)),
}
"""Of the value of every channel of `Readings`, among those that are tried."""
RIGHT: dict[tuple[str, str], tuple[Any, ...]] = {
    ("KinematicController", "dt"): (3, 0.5),  # for which programs are compiled
    ("RealTimeSqp.solve", "clock"): (_nothing,),  # which is asked, and gives no time
}
"""Values that are not tried."""


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@pytest.mark.sampled(60)
@pytest.mark.parametrize("call", [*map(_paced, CALLS)], ids=lambda call: call.title)
def test_wrong_arguments_are_named(call: Call) -> None:
    right = right_arguments(call)
    if call.title not in EXPENSIVE:
        _right(call, right)
    wrong = []
    for name in call.parameters:
        wrong += _faults(call, right, name)
    assert not wrong, f"{len(wrong)} of {call.title}\n" + "\n".join(wrong)


def test_the_surface_is_large() -> None:
    n = 0
    for call in CALLS:
        n += sum(len(_values(call, name)) for name in call.parameters)
    assert n > 42_000


def test_a_path_may_be_given_as_a_string() -> None:
    functions = [
        call.function for call in CALLS if call.title != "Robot"
    ]  # whose field is the path itself
    functions += [
        getattr(identification, name) for name in exported_names(Path(identification.__file__))
    ]
    paths_only = set()
    for function in filter(inspect.isfunction, functions):
        for name, annotation in inspect.get_annotations(inspect.unwrap(function)).items():
            takes_path = re.search(r"\bPath\b", str(annotation))
            takes_text = re.search(r"\bstr\b", str(annotation))
            if takes_path and not takes_text and name != "return":
                paths_only.add(f"{function.__qualname__}: {name}")
    assert not paths_only


@pytest.mark.parametrize(("title", "name"), ACCEPTED)
def test_what_may_be_of_any_type_is_taken(title: str, name: str) -> None:
    call = next(call for call in CALLS if call.title == title)
    for value in WRONG_TYPES:
        _run(call, {**right_arguments(call), name: value})


@pytest.mark.parametrize("channel", SHAPES)
def test_a_channel_takes_readings_of_its_shapes_alone(channel: str) -> None:
    for shape in ((), (2,), (3,), (4,), (5,), (3, 3), (4, 1)):
        reading = Reading(value=np.zeros(shape) if shape else 1.0, t=0.0)
        if shape in SHAPES[channel]:
            assert getattr(Readings(**{channel: reading}), channel) is reading
        else:
            with pytest.raises(InvalidInput, match=rf"^Readings: {channel}\.value "):
                Readings(**{channel: reading})


def test_what_runs_at_every_tick_looks_at_ranges_and_axes_of_what_it_does_not_read() -> None:
    with pytest.raises(
        InvalidInput, match=r"^UniformField.velocity: p_W has shape \(2,\); give an array \(n, 3\)"
    ):
        UniformCurrent([0.1, 0.0, 0.0]).velocity(np.zeros(2), 0.0)
    with pytest.raises(
        InvalidInput, match=r"^KinematicPlant.step: dt = -0.1; give a number between 0 and 86400$"
    ):
        POOL["KinematicPlant"]().step(Command(v=np.zeros(robot().n_v)), -0.1)
    with pytest.raises(
        InvalidInput, match=r"^Mission.idle: activations has shape \(2,\); give \(9,\)$"
    ):
        scenario().mission.idle(scenario().mission.start(), np.zeros(2))


@pytest.mark.parametrize(
    ("call", "right"),
    [
        (uo.load_robot, "variant"),
        (MinimumAltitude, "threshold"),
        (uo.Phase, "transitions"),
        (uo.Scenario, "environment"),
    ],
)
def test_a_misspelled_name_of_an_argument_is_answered_with_the_nearest(
    call: Any, right: str
) -> None:
    with pytest.raises(ArgumentNotFound, match=f"Did you mean '{right}'"):
        call(**{right[:-2] + right[-1]: 1.0})


def test_arrays_that_do_not_fit_together_are_both_named() -> None:
    with pytest.raises(InvalidInput, match=r": rate has shape \(2,\); give \(3,\) to go with J$"):
        Icat().velocity(np.eye(3), np.ones(2), np.ones(3), (3,))


def _right(call: Call, right: dict[str, Any]) -> None:
    try:
        _run(call, right)
    except UvmsError:
        assert call.title in REFUSES
    else:
        assert call.title not in REFUSES


def _values(call: Call, name: str) -> tuple[Any, ...]:
    """Wrong ones that are tried for a parameter."""
    if call.parameters[name].kind in STARRED:
        return ()
    right = RIGHT.get((call.title, name), ())
    return (
        tuple(value for value in WRONG if repr(value) not in map(repr, right)) if right else WRONG
    )


def _faults(call: Call, right: dict[str, Any], name: str) -> Iterator[str]:
    """Answers to wrong values of one parameter that break the promise."""
    unnormalized = [] if f"{call.title}.{name}" in ANY_NORM else _unnormalized(right.get(name))
    for value in (*_values(call, name), *unnormalized):
        never = _never_right(value) or any(value is q for q in unnormalized)
        try:
            _run(call, {**right, name: value})
            if (never or (value is NAN and name not in MAY_BE_NAN)) and (
                call.title,
                name,
            ) not in ACCEPTED:
                yield f"{name} = {value!r}: accepted"
        except (UvmsError, TypeError) as error:
            text = str(error)
            if "\n" in text or not _named(name, value, text):
                yield f"{name} = {value!r}: {type(error).__name__}: {text}"
        except Exception as error:
            yield f"{name} = {value!r}: {type(error).__name__}: {error}"


def _unnormalized(right: Any) -> list[np.ndarray]:
    """A configuration, where one is right, with a quaternion of norm 2."""
    if not (
        isinstance(right, np.ndarray)
        and right.dtype == float
        and right.shape[-1:] == (robot().n_q,)
    ):
        return []
    q = right.copy()
    q[..., 3:7] *= 2.0
    return [q]


def _never_right(value: Any) -> bool:
    return any(value is wrong for wrong in WRONG_TYPES)


def _named(name: str, value: Any, text: str) -> bool:
    """Whether a message says which argument it is about: by its name, in the words of the field, or
    by what was given.
    """
    words = (name, name.replace("_", " "), *WORDS.get(name, ()))
    if any(re.search(rf"(?<!\w){word}(?!\w)", text) for word in words):
        return True
    values = []
    if not isinstance(value, (int, float, np.ndarray)):
        values.append(repr(value))
    if isinstance(value, str) and len(value) > 1:
        values.append(value)
    return any(shown in text for shown in values)


def _run(call: Call, arguments: dict[str, Any]) -> None:
    if call.owner is None:
        call.function(**arguments)
    else:
        call.function(owner_of(call), **arguments)
