"""The scene as a browser shows it: drawn by Chromium without a window, where playwright and
Chromium are found.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import matplotlib.image as mpl_image
import numpy as np
import pinocchio as pin
import pytest
from scene_picture import EXPECTED, SIZE, at, coarse, record_to_look_at
from synthetic_record import synthetic_record

from uvms_ocp.record.meta_values import (
    AlarmMeta,
    FaultMeta,
    MarkerMeta,
    PhaseMeta,
    SurroundingsMeta,
)
from uvms_ocp.record.record import Record
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.viz import show
from uvms_ocp.viz.scene.page import ScenePage
from uvms_ocp.viz.scene.page_server import served
from uvms_ocp.viz.scene.pictures import missing

pytestmark = pytest.mark.slow

if missing():
    pytest.skip(missing(), allow_module_level=True)
PHONE = {"width": 390, "height": 780}


@dataclass
class Sheet:
    """An open page, and what it did that it should not."""

    page: Any
    wrong: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)

    def __call__(self, script: str) -> Any:
        return self.page.evaluate(script)


def _open(chromium: Any, page: ScenePage, viewport: dict[str, int]) -> Iterator[Sheet]:
    with served(page) as address:
        sheet = Sheet(chromium.new_page(viewport=viewport))
        sheet.page.on("console", lambda message: sheet.wrong.append(message.text))
        sheet.page.on("pageerror", lambda error: sheet.wrong.append(str(error)))
        sheet.page.on("dialog", lambda dialog: sheet.wrong.append(dialog.message))
        sheet.page.on(
            "request", lambda request: sheet.asked.append(request.url.removeprefix(address))
        )
        sheet.page.goto(f"{address}#t=0")
        yield sheet
        sheet.page.close()


@pytest.fixture(scope="module")
def run(robot: Robot) -> Record:
    return record_to_look_at(robot)


@pytest.fixture(scope="module")
def sheet(chromium: Any, run: Record, robot: Robot) -> Iterator[Sheet]:
    yield from _open(chromium, show(run, robot), dict(zip(("width", "height"), SIZE, strict=True)))


@pytest.fixture(scope="module")
def posed(chromium: Any, robot: Robot) -> Iterator[Sheet]:
    yield from _open(chromium, show(robot), {"width": 800, "height": 500})


def test_the_picture_is_the_expected_one_but_for_noise(sheet: Sheet) -> None:
    picture = coarse(at(sheet.page, 3.0))
    expected = mpl_image.imread(EXPECTED)[..., :3]
    assert np.std(picture, axis=(0, 1)).min() > 0.05, "not empty"
    assert np.abs(picture - expected).mean() < 0.02
    assert np.abs(picture - coarse(at(sheet.page, 0.0))).mean() > 0.005, (
        "another time looks different"
    )


def test_nothing_is_asked_of_a_network_and_nothing_is_complained_about(sheet: Sheet) -> None:
    at(sheet.page, 1.0)
    assert [address for address in sheet.asked if not address.startswith(("data:", "blob:"))] == [
        ""
    ], "the page itself"
    assert sheet.wrong == []


def test_it_plays_and_stops_and_goes_to_any_time(sheet: Sheet) -> None:
    at(sheet.page, 0.0)
    sheet.page.keyboard.press("Space")
    _wait_until(sheet, "clock.t > 0.1")
    sheet.page.keyboard.press("Space")
    stopped_time = sheet("clock.t")
    sheet.page.wait_for_timeout(200)
    assert sheet("clock.t") == stopped_time
    box = sheet.page.locator("#timeline").bounding_box()
    sheet.page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert sheet("clock.t") == pytest.approx(3.0, abs=0.02)
    sheet.page.keyboard.press("ArrowLeft")
    assert sheet("clock.t") == pytest.approx(2.0, abs=0.02)


def _wait_until(sheet: Sheet, condition: str) -> None:
    for _ in range(100):
        if sheet(condition):
            return
        sheet.page.wait_for_timeout(100)
    raise AssertionError(condition)


def test_links_stand_where_pinocchio_says(sheet: Sheet, run: Record, robot: Robot) -> None:
    at(sheet.page, 4.0)
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, run["q"][200])
    drawn_places = [
        _place(sheet, f"[...DETAILS.body.slice(0, -1), {name!r}]") for name in _nodes(robot)
    ]
    expected = np.array([X.translation for X in list(data.oMi)[1:]])
    np.testing.assert_allclose(
        np.array(drawn_places) - drawn_places[0], expected - expected[0], atol=1e-3
    )


def _nodes(robot: Robot) -> list[str]:
    return [f"{k:02d} {name}" for k, name in enumerate(robot.model.names) if k]


def _place(sheet: Sheet, path: str) -> Any:
    """In W but for a shift: three.js has y up."""
    x, y, z = sheet(f"nodeAt({path}).getWorldPosition(new THREE.Vector3()).toArray()")
    return np.array([x, -z, y])


def test_boxes_of_the_legend_show_and_hide(sheet: Sheet) -> None:
    row = sheet.page.locator("#rows label", has_text="thrust")
    visible = "arrows.filter(({group, node}) => group.label === 'thrust' && node.visible).length"
    at(sheet.page, 3.0)
    assert sheet(visible) > 0
    row.locator("input").uncheck()
    assert sheet(visible) == 0
    row.locator("input").check()
    assert sheet(visible) > 0


def test_the_panel_of_meshcat_is_out_of_the_way(sheet: Sheet) -> None:
    assert sheet.page.locator(".dg:visible").count() == 0


def test_what_a_sensor_is_and_what_was_said_is_read_out_while_it_holds(sheet: Sheet) -> None:
    collected = []
    for t in (0.5, 1.3, 3.0):
        at(sheet.page, t)
        collected.append(sheet.page.locator("#readouts").inner_text())
    assert "altimeter_range" not in collected[0]
    assert "altimeter_range suspect: the same value 4 times" in collected[1]
    assert re.search(r"altimeter_range lost\n", collected[2])


def test_sliders_move_the_links_as_pinocchio_does_and_say_how_in_python(
    posed: Sheet, robot: Robot
) -> None:
    rng = np.random.default_rng(3)
    sliders = posed.page.locator("#joints input")
    for k in range(sliders.count()):
        low, high = (float(sliders.nth(k).get_attribute(name)) for name in ("min", "max"))
        sliders.nth(k).fill(f"{low + (high - low) * round(rng.uniform(0.2, 0.8), 3)}")
    words = posed.page.locator("#words").inner_text()
    q = eval(words.removeprefix("q = "), {"robot": robot})
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    expected = np.array([X.translation for X in list(data.oMi)[1:]])
    drawn_values = np.array(
        [_place(posed, f"[...DETAILS.body.slice(0, -1), {name!r}]") for name in _nodes(robot)]
    )
    np.testing.assert_allclose(drawn_values - drawn_values[0], expected - expected[0], atol=2e-3)
    assert np.linalg.norm(q[:3]) > 0.1, "the vehicle was moved too"


def test_hostile_names_are_text(chromium: Any, robot: Robot) -> None:
    evil = "<img src=x onerror=alert(1)>"
    record = synthetic_record(
        robot,
        scenario=evil,
        phases=(PhaseMeta(name="A", title=evil), PhaseMeta(name=evil)),
        alarms=(AlarmMeta(t=1.0, text=evil),),
        channels=("position", evil),
        faults=(FaultMeta(text=evil, target=evil, kind="dead", t=1.0),),
        surroundings=SurroundingsMeta(markers=(MarkerMeta(name=evil, position=(1.0, 0.0, -37.0)),)),
        quantities=(f"{evil}.error", *record_to_look_at(robot).meta.quantities[1:]),
    )
    for sheet in _open(
        chromium, show(record, robot, ghosts={evil: record}), {"width": 640, "height": 400}
    ):
        at(sheet.page, 1.5)
        assert sheet.page.locator("img").count() == 0
        assert evil in sheet.page.locator("body").inner_text()
        assert sheet.wrong == []


def test_on_a_phone_nothing_is_cut_off_and_nothing_lies_on_the_controls(
    chromium: Any, run: Record, robot: Robot
) -> None:
    for sheet in _open(chromium, show(run, robot), PHONE):
        at(sheet.page, 1.5)
        boxes = [
            item.bounding_box()
            for item in sheet.page.locator("#bar > *, #heading, #readouts, #side").all()
        ]
        assert len(boxes) == 8
        for box in boxes:
            assert 0 <= box["x"] <= box["x"] + box["width"] <= PHONE["width"]
            assert 0 <= box["y"] <= box["y"] + box["height"] <= PHONE["height"]
        bar = sheet.page.locator("#bar").bounding_box()
        panels = [sheet.page.locator(name).bounding_box() for name in ("#readouts", "#side")]
        assert all(box["y"] + box["height"] < bar["y"] for box in panels)
        assert panels[0]["x"] + panels[0]["width"] < panels[1]["x"], "the panels lie side by side"


def test_a_fixed_base_robot_is_drawn_too(chromium: Any) -> None:
    planar = load_robot("planar5")
    for sheet in _open(
        chromium, show(synthetic_record(planar), planar), {"width": 640, "height": 400}
    ):
        assert np.std(coarse(at(sheet.page, 3.0)), axis=(0, 1)).min() > 0.02
        assert sheet.wrong == []
