"""A run that is looked at while it goes on: what is seen is what happened, in its order, and the run is the same."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
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
from uvms_ocp.scenario.cases import case1
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.viz import show
from uvms_ocp.viz.scene.live import live
from uvms_ocp.viz.scene.page import browser, missing

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
def test_frames_come_in_order_and_the_last_one_is_the_end_of_the_run(seen: tuple[Record, Listener]) -> None:
    record, listener = seen
    times = [frame["t"] for frame in listener.frames]
    assert listener.kind == "text/event-stream"
    assert len(times) > 3
    assert times == sorted(set(times))
    assert times[-1] == pytest.approx(record["t"][-1])


@long_without_compiler
def test_a_frame_has_the_links_where_pinocchio_has_them_at_that_time(seen: tuple[Record, Listener], scenario: Scenario) -> None:
    record, listener = seen
    model = scenario.robot.model
    data = model.createData()
    for frame in listener.frames:
        row = int(np.argmin(np.abs(record["t"] - frame["t"])))
        pin.forwardKinematics(model, data, record["q"][row])
        expected = np.array([pin.SE3ToXYZQUAT(X) for X in list(data.oMi)[1:]])
        np.testing.assert_allclose(frame["poses"], expected, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(frame["values"], record["quantities"][row], rtol=6e-3, atol=1e-12)
        assert frame["phase"] == record["phase"][row]


@long_without_compiler
def test_the_record_is_the_same_to_the_last_bit(seen: tuple[Record, Listener], scenario: Scenario) -> None:
    runs = [seen[0], scenario.run()]
    watched, alone = (
        Record(
            series={name: series for name, series in run.series.items() if name not in MEASURED},
            meta=run.run_meta.model_copy(update={"wall_s": 0.0}),
        )
        for run in runs
    )
    require_same(watched, alone)


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
    with live(scenario) as view, closing(HTTPConnection(urlsplit(view.address).netloc, timeout=30)) as connection:
        connection.request("GET", "/")
        assert b"connect-src 'self'" in connection.getresponse().read()
    assert "connect-src" not in show(scenario.robot).html.partition("<title>")[0]


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    if missing():
        pytest.skip(missing())
    with browser() as found:
        yield found


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
        page.wait_for_function(f"byId('clock').textContent === '{record['t'][-1]:.1f} s'", timeout=20_000)
        place = page.evaluate("(() => { const {x, y, z} = nodeAt(DETAILS.body).position; return [x, y, z]; })()")
        told = page.locator("#readouts").inner_text()
        page.close()
    np.testing.assert_allclose(place, record["q"][-1, :3], atol=1e-4)
    assert record.meta.phases[0].title in told
    assert wrong == []


@long_without_compiler
def test_a_notebook_shows_it_by_its_own_channel(chromium: Any, scenario: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whose kernel may be where no browser reaches its addresses."""
    shells = pytest.importorskip("IPython.display")
    longer, told, wrong = replace(scenario, duration=2.0), list[str](), list[str]()

    class Output:
        def update(self, data: dict[str, str], *, raw: bool) -> None:
            told.append(data["application/javascript"])

    shown = list[dict[str, str]]()
    monkeypatch.setattr(
        shells, "display", lambda data, **given: shown.append(data) or (Output() if "display_id" in given else None)
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
    frame.wait_for_function("typeof byId === 'function' && byId('clock').textContent === 'not begun'", timeout=20_000)
    for script in told:
        page.evaluate(script)
    last = float(json.loads(told[-1].partition("postMessage(")[2].rpartition(", '*'")[0])["t"])
    frame.wait_for_function(f"byId('clock').textContent === '{last:.1f} s'", timeout=20_000)
    place = frame.evaluate("(() => { const {x, y, z} = nodeAt(DETAILS.body).position; return [x, y, z]; })()")
    row = int(np.argmin(np.abs(record["t"] - last)))
    np.testing.assert_allclose(place, record["q"][row, :3], atol=1e-4)
    assert wrong == []
