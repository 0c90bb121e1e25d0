"""Words in names mean the same in any spelling."""

from __future__ import annotations

import pinocchio as pin
import pytest

from uvms_ocp.robot.name_words import NameWords

KINDS = ("sensor", "altimeter", "load cell", "finger", "tip", "propeller")


@pytest.mark.parametrize(
    ("spellings", "kinds"),
    [
        (("echosounder", "echo_sounder", "echo-sounder", "echoSounder"), {"sensor", "altimeter"}),
        (("wrist_loadcell", "wrist_load_cell", "WristLoadCell"), {"load cell"}),
        (("left_fingertip", "left_finger_tip", "leftFingerTip", "FingerTipLeft"), {"finger"}),
        (("endeffector", "end_effector", "endEffector"), {"tip"}),
        (("tool_frame", "toolFrame", "ToolFrame"), {"tip"}),
        (("left_prop", "leftProp"), {"propeller"}),
    ],
)
def test_a_word_is_the_same_in_any_spelling(spellings: tuple[str, ...], kinds: set[str]) -> None:
    words = NameWords(pin.Model())
    for name in spellings:
        assert {kind for kind in KINDS if words.is_called(kind, name)} == kinds, name
