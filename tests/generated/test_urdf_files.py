"""Any URDF: a model with the masses, shapes and limits that its XML says, or refused in one
line.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from drawing import chosen, either, floats
from hypothesis import given, settings, strategies as st
from promises import DAMAGES, Tally, damaged_bytes

from uvms_ocp.robot.urdf import UrdfModels, read_urdf

pytestmark = pytest.mark.slow

_LINK = """<link name="{name}">
 <inertial><origin xyz="0 0 0.1" rpy="0 0 0"/><mass value="{mass}"/>
  <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>
 <visual><geometry><sphere radius="0.2"/></geometry></visual>
 <collision><origin xyz="0 0 0.1" rpy="0 0 0"/><geometry>{shape}</geometry></collision></link>
"""
_JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
 <origin xyz="0 0 0.3" rpy="0 0 0"/><axis xyz="0 1 0"/>
 <limit lower="-1.5" upper="2.0" effort="30" velocity="1.25"/></joint>
"""
WHOLE = "".join(
    (
        '<robot name="arm">\n',
        _LINK.format(name="base_link", mass="100", shape='<box size="1 0.6 0.5"/>'),
        _LINK.format(name="link1", mass="4.5", shape='<cylinder radius="0.05" length="0.4"/>'),
        _LINK.format(name="link2", mass="2.25", shape='<sphere radius="0.07"/>'),
        _JOINT.format(name="joint1", parent="base_link", child="link1"),
        _JOINT.format(name="joint2", parent="link1", child="link2"),
        "</robot>\n",
    )
)
_VALUES = [match.span(1) for match in re.finditer(r'="([^"]*)"', WHOLE)]
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_ODD = (
    *(
        "",
        " ",
        "1 ",
        " 1",
        "1\n",
        "1_0",
        "\u0661",
        "0x10",
        "1e400",
        "-1",
        "0",
        "nan",
        "inf",
        "1,5",
        "1.5.2",
        "1e",
        "--1",
    ),
    *("1 2", "0 0 0", "0 0 0 ", "1 2 3 4", "a", "base_link", "link1"),
    *("revolute", "continuous", "fixed", "mimic", "&lt;", "\u202e"),
)


@st.composite
def damaged_values(draw: st.DrawFn) -> bytes:
    """One or two values of attributes are others."""
    text = WHOLE
    for start, end in sorted(
        draw(st.lists(chosen(_VALUES), min_size=1, max_size=2, unique=True)), reverse=True
    ):
        old = WHOLE[start:end]
        blanks = chosen(
            [
                f"{old} ",
                f" {old}",
                f"{old}\n",
                f"{old}\t",
                f"{old}_0",
                f"{old}f",
                old.replace(".", ","),
            ]
        )
        new = draw(either(chosen(_ODD), floats().map(repr), blanks))
        text = text[:start] + new.replace("<", "") + text[end:]
    return text.encode()


def numbers(text: str | None, n: int = 1) -> list[float]:
    """As a strict reader understands them: blanks before a number are skipped, after it they are
    not.
    """
    words = (text or "").lstrip().split(" ")
    assert len(words) == n, text
    assert all(_NUMBER.fullmatch(word) for word in words), text
    return [float(word) for word in words]


def sizes(shape: ElementTree.Element) -> list[float]:
    """Of the parts of a shape; placeholders, of no size, touch nothing and are left out."""
    lengths = []
    for part in shape.iterfind("geometry/*"):
        for value in part.attrib.values():
            lengths += numbers(value, n=len(value.split(" ")))
    return lengths


def is_sound(shape: ElementTree.Element) -> bool:
    """Whether what only draws can be drawn; what cannot is left out, too."""
    try:
        places = []
        for origin in shape.iterfind("origin"):
            places += [numbers(value, n=3) for value in origin.attrib.values()]
        return min(sizes(shape)) > 0.0 and bool(np.isfinite(places).all())
    except (AssertionError, ValueError):
        return False


def check_model(path: Path, models: UrdfModels) -> None:
    root = ElementTree.parse(path).getroot()
    model = models.model
    masses = [numbers(mass.get("value"))[0] for mass in root.iterfind("link/inertial/mass")]
    assert np.isclose(sum(inertia.mass for inertia in model.inertias), sum(masses), rtol=1e-12)
    assert models.collision.ngeoms == sum(
        any(sizes(shape)) for shape in root.iterfind("link/collision")
    )
    drawn = root.findall("link/visual")
    assert sum(map(is_sound, drawn)) <= models.visual.ngeoms <= len(drawn)
    for joint in root.iterfind("joint"):
        limit = joint.find("limit")
        if joint.get("type") == "revolute" and limit is not None:
            place = model.joints[model.getJointId(joint.get("name", ""))]
            i, q = place.idx_v, place.idx_q
            assert model.velocityLimit[i] == numbers(limit.get("velocity"))[0]
            assert model.effortLimit[i] == numbers(limit.get("effort"))[0]
            assert model.lowerPositionLimit[q] == numbers(limit.get("lower", "0"))[0]
            assert model.upperPositionLimit[q] == numbers(limit.get("upper", "0"))[0]


def test_any_change_of_a_urdf_is_built_as_it_says_or_refused_in_one_line(tmp_path: Path) -> None:
    tally = Tally(bad=350)
    path = tmp_path / "robot.urdf"
    path.write_text(WHOLE)
    check_model(path, read_urdf(path, free_flyer=False))
    bytes_of_it = DAMAGES.map(lambda damage: damaged_bytes(WHOLE.encode(), damage))

    @settings(max_examples=700)
    @given(either(damaged_values(), damaged_values(), bytes_of_it))
    def holds(content: bytes) -> None:
        path.write_bytes(content)
        models = tally.outcome(lambda: read_urdf(path, free_flyer=False))
        if models is not None:
            check_model(path, models)

    holds()
    tally.check()
