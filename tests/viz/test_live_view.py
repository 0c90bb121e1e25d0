"""A run that is looked at while it goes on: what is seen is what happened, in its order, and the
run is the same.
"""

from __future__ import annotations

import json
import time
from contextlib import closing
from dataclasses import dataclass, field, replace
from http.client import HTTPConnection
from threading import Thread
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pinocchio as pin
import pytest
from compiler import long_without_compiler
from same_record import require_same

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.record import Record
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.scenario.cases import case1
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.viz import show
from uvms_ocp.viz.scene.live import LiveView, live

LASTS = 0.4  # [s]
MEASURED = ("controller_time", "solve_time", "tick_time")
"""Series that two runs never share: the time that things took."""


@dataclass
class Listener:
    """What a browser would be sent, from now until the page is served no longer."""

    address: str
    frames: list[Any] = field(default_factory=list)
    kind: str = ""

    def __enter__(self) -> Listener:
        self._connection = HTTPConnection(urlsplit(self.address).netloc, timeout=30)
        self._connection.request("GET", "/frames")
        self._thread = Thread(target=self._listen)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._thread.join(timeout=30)
        self._connection.close()

    def _listen(self) -> None:
        response = self._connection.getresponse()
        self.kind = response.headers["Content-Type"]
        for line in response:
            if line.startswith(b"data: {"):
                self.frames.append(json.loads(line.removeprefix(b"data: ")))


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return case1(plant="kinematic", duration=LASTS)


@pytest.fixture(scope="module")
def seen(scenario: Scenario) -> tuple[Record, Listener]:
    """A run at the speed of the clock, and what came of it by the time that it was over."""
    view = live(scenario)
    with Listener(view.address) as listener, view:
        record = scenario.run(observer=view)
    return record, listener


@long_without_compiler
def test_frames_come_in_order_and_the_last_one_is_the_end_of_the_run(
    seen: tuple[Record, Listener],
) -> None:
    record, listener = seen
    times = [frame["t"] for frame in listener.frames]
    assert listener.kind == "text/event-stream"
    assert len(times) > 3
    assert times == sorted(set(times))
    assert times[-1] == pytest.approx(record["t"][-1])


@long_without_compiler
def test_a_frame_has_the_links_where_pinocchio_has_them_at_that_time(
    seen: tuple[Record, Listener], scenario: Scenario
) -> None:
    record, listener = seen
    model = scenario.robot.model
    data = model.createData()
    for frame in listener.frames:
        row = int(np.argmin(np.abs(record["t"] - frame["t"])))
        pin.forwardKinematics(model, data, record["q"][row])
        expected = np.array([pin.SE3ToXYZQUAT(X) for X in list(data.oMi)[1:]])
        np.testing.assert_allclose(frame["poses"], expected, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(
            frame["values"], record["quantities"][row], rtol=6e-3, atol=1e-12
        )
        assert frame["phase"] == record["phase"][row]


@long_without_compiler
def test_the_record_is_the_same_to_the_last_bit(
    seen: tuple[Record, Listener], scenario: Scenario
) -> None:
    runs = [seen[0], scenario.run()]
    watched, alone = (
        Record(
            series={name: series for name, series in run.series.items() if name not in MEASURED},
            meta=run.run_meta.model_copy(update={"wall_s": 0.0}),
        )
        for run in runs
    )
    require_same(watched, alone)


@pytest.mark.sampled
@long_without_compiler
@pytest.mark.parametrize("speed", [2.0, 4.0])
def test_a_run_does_not_overtake_the_clock(scenario: Scenario, speed: float) -> None:
    with live(scenario, speed=speed) as view:
        begun = time.monotonic()
        scenario.run(observer=view)
        assert time.monotonic() - begun >= LASTS / speed


@pytest.mark.parametrize("speed", [0.0, -1.0])
def test_a_clock_that_stands_or_goes_back_is_refused(scenario: Scenario, speed: float) -> None:
    with pytest.raises(InvalidInput, match=r"speed = .*; give a number > 0"):
        live(scenario, speed=speed)


def test_it_is_served_to_this_machine_alone(scenario: Scenario) -> None:
    with live(scenario) as view:
        place = urlsplit(view.address)
        assert place.hostname == "127.0.0.1"
        for path in ("/", "/frames"):
            with closing(HTTPConnection(place.netloc, timeout=30)) as connection:
                connection.request("GET", path, headers={"Host": "elsewhere.example"})
                assert connection.getresponse().status == 403


def test_only_a_live_page_may_ask_whoever_serves_it(scenario: Scenario) -> None:
    with (
        live(scenario) as view,
        closing(HTTPConnection(urlsplit(view.address).netloc, timeout=30)) as connection,
    ):
        connection.request("GET", "/")
        assert b"connect-src 'self'" in connection.getresponse().read()
    assert "connect-src" not in show(scenario.robot).html.partition("<title>")[0]


@pytest.mark.slow
@long_without_compiler
def test_a_browser_shows_where_the_robot_has_come_to(chromium: Any, scenario: Scenario) -> None:
    longer = replace(scenario, duration=3.0)
    wrong: list[str] = []
    with live(longer, speed=2.0) as view:
        page = chromium.new_page(viewport={"width": 800, "height": 500})
        page.on("console", lambda message: wrong.append(message.text))
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(view.address)
        record = longer.run(observer=view)
        page.wait_for_function(
            f"byId('clock').textContent === '{record['t'][-1]:.1f} s'", timeout=20_000
        )
        place = page.evaluate(
            "(() => { const {x, y, z} = nodeAt(DETAILS.body).position; return [x, y, z]; })()"
        )
        told = page.locator("#readouts").inner_text()
        page.close()
    np.testing.assert_allclose(place, record["q"][-1, :3], atol=1e-4)
    assert record.meta.phases[0].title in told
    assert wrong == []


@pytest.mark.slow
@long_without_compiler
def test_a_notebook_shows_it_by_its_own_channel(
    chromium: Any, scenario: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whose kernel may be where no browser reaches its addresses."""
    shells = pytest.importorskip("IPython.display")
    longer = replace(scenario, duration=2.0)
    told = list[str]()
    wrong = list[str]()

    class Output:
        def update(self, data: dict[str, str], *, raw: bool) -> None:
            told.append(data["application/javascript"])

    shown = list[dict[str, str]]()
    monkeypatch.setattr(
        shells,
        "display",
        lambda data, **given: shown.append(data) or (Output() if "display_id" in given else None),
    )
    with live(longer, speed=2.0) as view:
        view._ipython_display_()
        record = longer.run(observer=view)
        served_at = view.address
    assert served_at not in shown[0]["text/html"]
    assert 5 < len(told) < 15
    page = chromium.new_page(viewport={"width": 800, "height": 560})
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.set_content(shown[0]["text/html"])
    frame = page.frames[1]
    frame.wait_for_function(
        "typeof byId === 'function' && byId('clock').textContent === 'not begun'", timeout=20_000
    )
    for script in told:
        page.evaluate(script)
    last = float(json.loads(told[-1].partition("postMessage(")[2].rpartition(", '*'")[0])["t"])
    frame.wait_for_function(f"byId('clock').textContent === '{last:.1f} s'", timeout=20_000)
    place = frame.evaluate(
        "(() => { const {x, y, z} = nodeAt(DETAILS.body).position; return [x, y, z]; })()"
    )
    row = int(np.argmin(np.abs(record["t"] - last)))
    np.testing.assert_allclose(place, record["q"][row, :3], atol=1e-4)
    assert wrong == []


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7")


def _links(page: Any, robot: Robot) -> Any:
    """Where the page has the links, in W."""
    nodes = [f"{k:02d} {name}" for k, name in enumerate(robot.model.names) if k]
    return np.array(
        page.evaluate(
            f"{nodes}.map((name) => nodeAt([...DETAILS.body.slice(0, -1),"
            " name]).position.toArray())"
        )
    )


def _places(robot: Robot, q: np.ndarray) -> Any:
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    return np.array([X.translation for X in list(data.oMi)[1:]])


def _other(robot: Robot) -> np.ndarray:
    return robot.configuration(
        position=(0.4, -0.3, 0.2), rpy=(0.1, 0.2, -0.5), joints=robot.home + 0.2
    )


@pytest.mark.slow
def test_a_loop_of_ones_own_moves_a_robot_in_the_browser(chromium: Any, robot: Robot) -> None:
    q = _other(robot)
    with live(robot) as view:
        np.testing.assert_array_equal(view.q, robot.configuration())
        page = chromium.new_page(viewport={"width": 800, "height": 500})
        page.goto(view.address)
        for _ in range(50):  # until the page listens
            view.display(q)
            if np.allclose(_links(page, robot), _places(robot, q), atol=1e-4):
                break
        np.testing.assert_allclose(_links(page, robot), _places(robot, q), atol=1e-4)
        np.testing.assert_array_equal(view.q, q)
        page.close()


def test_a_robot_that_stands_elsewhere_is_shown_there_with_the_goal_at_its_tool(
    robot: Robot, scenario: Scenario
) -> None:
    q = robot.configuration(position=(1.0, 2.0, -5.0), rpy=(0.0, 0.0, 0.3))
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    with live(robot, q=q) as view:
        np.testing.assert_array_equal(view.q, q)
        tool = data.oMf[robot.frame_id(robot.tools[0])]
        assert view.goal.isApprox(tool, 1e-12)
    with pytest.raises(InvalidInput, match="give it as its start"):
        live(scenario, q=q)
    with pytest.raises(InvalidInput, match="q"):
        live(robot, q=np.zeros(3))


def test_a_loop_of_ones_own_comes_to_25_pictures_a_second(robot: Robot) -> None:
    with live(robot) as view:
        begun = time.monotonic()
        for _ in range(6):
            view.display(robot.configuration())
        assert time.monotonic() - begun >= 5 / 25
        with pytest.raises(InvalidInput, match="q"):
            view.display(np.zeros(3))


class _Notebook:
    """A page with what a live view displays: scripts run, and the text of its widget is an input
    that the test hands on.
    """

    def __init__(self, chromium: Any, view: LiveView, monkeypatch: pytest.MonkeyPatch) -> None:
        shells = pytest.importorskip("IPython.display")
        widgets = pytest.importorskip("ipywidgets")
        shown = list[Any]()
        monkeypatch.setattr(shells, "display", lambda data, **given: shown.append(data))
        view._ipython_display_()
        framed, script, self.widget = shown
        assert isinstance(self.widget, widgets.Text)
        (self.name,) = self.widget._dom_classes
        self.page = chromium.new_page(viewport={"width": 900, "height": 560})
        self.page.set_content(f"{framed['text/html']}<div class='{self.name}'><input></div>")
        self.page.evaluate(script["application/javascript"])
        self.frame = self.page.frames[1]
        self.frame.wait_for_function(
            "() => typeof goal === 'object' && goal !== null && clock.last !== undefined",
            timeout=20_000,
        )

    def hand_on(self) -> None:
        self.page.wait_for_timeout(200)
        self.widget.value = self.page.evaluate(
            f"document.querySelector('.{self.name} input').value"
        )

    def drag(self, place: str, by: tuple[float, float]) -> None:
        """What is at a place of the scene, by pixels."""
        on_screen = f"{place}.project(camera)"
        x, y = self.frame.evaluate(
            f"(() => {{ const p = {on_screen}; return [innerWidth * (p.x + 1) / 2, innerHeight * (1"
            " - p.y) / 2]; })()"
        )
        box = self.page.locator("iframe").bounding_box()
        self.page.mouse.move(box["x"] + x, box["y"] + y)
        self.page.mouse.down()
        self.page.mouse.move(box["x"] + x + by[0], box["y"] + y + by[1], steps=4)
        self.page.mouse.up()
        self.hand_on()


@pytest.mark.slow
def test_what_is_dragged_in_a_notebook_is_told_to_python(
    chromium: Any, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = list[np.ndarray]()
    with live(robot) as view:
        view.on_change = lambda view: told.append(view.q)
        notebook = _Notebook(chromium, view, monkeypatch)
        start = view.q.copy()
        goal = view.goal.copy()
        camera = notebook.frame.evaluate("camera.position.toArray()")
        notebook.frame.locator("#joints input").first.fill("1.5")
        notebook.hand_on()
        assert view.q[0] == pytest.approx(1.5, abs=0.01)
        np.testing.assert_array_equal(told[-1], view.q)
        notebook.frame.evaluate("DETAILS.joints[0].values[0] = 0; poseJoints()")
        notebook.drag("goal.getWorldPosition(new THREE.Vector3())", (40.0, -60.0))
        moved = view.goal.translation - goal.translation
        assert moved[2] > 0.05, "up with the pointer"
        np.testing.assert_allclose(view.goal.rotation, goal.rotation, atol=1e-6)
        np.testing.assert_allclose(view.q[:7], start[:7], atol=1e-6)
        link = len(robot.model.names) - 4
        notebook.drag(
            f"nodeAt(DETAILS.joints[{link}].path).getWorldPosition(new THREE.Vector3())",
            (25.0, 25.0),
        )
        changed = np.flatnonzero(np.abs(view.q - start) > 0.01)
        assert len(changed) == 1, "a joint of the arm alone"
        assert changed[0] >= 7
        np.testing.assert_allclose(_links(notebook.frame, robot), _places(robot, view.q), atol=2e-3)
        np.testing.assert_allclose(
            notebook.frame.evaluate("camera.position.toArray()"), camera, atol=1e-9
        )
        notebook.page.close()


def test_without_the_widgets_a_live_robot_is_shown_all_the_same(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    shells = pytest.importorskip("IPython.display")
    shown = list[Any]()
    monkeypatch.setattr(shells, "display", lambda data, **given: shown.append(data))
    monkeypatch.setattr("uvms_ocp.viz.scene.live.find_spec", lambda name: None)
    with live(robot) as view:
        view._ipython_display_()
    assert [next(iter(data)) for data in shown] == ["text/html", "application/javascript"]
