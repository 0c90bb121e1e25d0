"""Show a run in the browser while it goes on: the loop publishes the newest state, browsers fetch
it frame by frame.

A tick costs one assignment, and the wait that keeps the run to the clock. Each browser is served by
a thread that makes frames of the newest state: a slow browser misses some, and the run never waits
for it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from importlib.util import find_spec
from threading import Event
from types import TracebackType
from typing import Any
from uuid import uuid4

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput, short
from uvms_ocp.record.record import Record
from uvms_ocp.robot import Command, Robot, State
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.types import AtLeastOne, Count, Positive
from uvms_ocp.viz.scene import animation, posed, surroundings
from uvms_ocp.viz.scene.details import legend, page_details, readout
from uvms_ocp.viz.scene.page import CommandLog, ScenePage, asset, build_page
from uvms_ocp.viz.scene.page_server import served

_FPS = 1.0  # [Hz] frames of the first two ticks; the page shows the first of them
_FRAME_RATE = 25.0  # [Hz] most frames per second of the wall clock
_NOTEBOOK_RATE = 10.0  # [Hz] most frames per second of a run in a notebook
_DIGITS = 7  # significant digits of poses, more than the 32-bit floats of the page hold

_Moment = tuple[float, State, Command]
"""Time [s], true state and command of a tick."""


def live_page(record: Record, robot: Robot, height: int) -> ScenePage:
    """Return the page of a live view: the scene at the start of the run, and the data with which the
    page's script moves it.

    record: beginning of a run of `robot`. height [px]: of its frame in a notebook. Raises
    `InvalidInput` as `show`.
    """
    animation.require_fit(record, robot)
    frames = animation.frames_of(record, robot, _FPS)
    centre = surroundings.middle(record, frames)
    log = CommandLog()
    root = posed.draw_still(log, robot, list(map(pin.XYZQUATToSE3, frames.placements[0])), centre)
    surroundings.draw_goals(root["goals"], record)
    surroundings.draw_obstacles(root["obstacles"], record)
    log.animate({})
    nodes = []
    for joint in range(1, robot.model.njoints):
        nodes.append(["meshcat", "scene", "robot", animation.joint_node(robot.model, joint)])
    phases = []
    for phase in record.meta.phases:
        tasks = list(phase.tasks)
        phases.append({"name": phase.name, "title": phase.title, "tasks": tasks, "start": 0.0})
    readouts = []
    for name in record.meta.quantities:
        readouts.append(readout(name, np.full(1, np.nan), record.meta))
    details = page_details(record, robot, frames, centre) | {
        "duration": 0.0,
        "speeds": (),
        "annotations": ["goals"],
        "legend": legend(record, [], [], beam=False),
        "readouts": readouts,
        "live": {"nodes": nodes, "phases": phases},
    }
    return build_page(
        log,
        title=f"{record.meta.scenario}: {record.meta.robot}",
        details=details,
        height=height,
        live=True,
    )


class LiveView(AbstractContextManager["LiveView"]):
    """View of a run that goes on: give it to the run as `observer`. Served on the loopback address
    alone, until it is closed.
    """

    def __init__(
        self,
        robot: Robot,
        page: ScenePage,
        q: np.ndarray,
        goal: pin.SE3,
        *,
        speed: float,
        port: int,
    ) -> None:
        """q (n_q,) [m, rad] and goal X_WT: as `page` shows them at first. speed: of the run, in
        multiples of the clock's. port: 0 for any that is free.

        Raises `OutputError` for a port that is taken.
        """
        self.goal = goal
        """X_WT of the tool's goal, as it was dragged in a notebook."""
        self.on_change: Callable[[LiveView], object] = lambda view: None
        """Called after `q` or `goal` was dragged in a notebook."""
        self._robot = robot
        self._page = page
        self._speed = speed
        self._notebook_output: Any = None
        """IPython's handle of the output that sends frames to the page in a notebook; `None` before
        it is shown.
        """
        self._newest: _Moment | np.ndarray = q
        """Newest tick of a run; a configuration (n_q,) [m, rad] where none runs."""
        self._data = robot.model.createData()
        self._name = ""
        """Name of the page's frame in a notebook."""
        self._next_frame_at = 0.0
        """[s] time on the clock before which no other frame is sent to a notebook."""
        self._run_began_at = 0.0
        """[s] time on the clock at which the run was at 0."""
        self._closed = Event()
        self._stack = ExitStack()
        self.address = self._stack.enter_context(served(page, port, self.frames))
        """Address of the page for browsers of this machine."""

    def __call__(self, t: float, state: State, command: Command) -> None:
        """Publish the tick at t [s], and wait until the clock has reached t too."""
        begins = isinstance(self._newest, np.ndarray) or t < self._newest[0]
        if begins:
            self._run_began_at = time.monotonic() - t / self._speed
        self._newest = (t, state, command)
        if time.monotonic() >= self._next_frame_at:
            self._send_to_notebook(1.0 / _NOTEBOOK_RATE)
        lead = self._run_began_at + t / self._speed - time.monotonic()
        if lead > 0.0:
            time.sleep(lead)

    @property
    def q(self) -> np.ndarray:
        """Configuration (n_q,) [m, rad] that is shown: of the newest tick, of `display`, or from
        dragging in a notebook.
        """
        if isinstance(self._newest, np.ndarray):
            return self._newest
        return self._newest[1].q

    def display(self, q: ArrayLike) -> None:
        """Show the robot in q (n_q,) [m, rad], from a loop of one's own; waits so that there are at
        most 25 pictures a second.
        """
        self._newest = self._robot.check_configuration(q)
        time.sleep(max(0.0, self._next_frame_at - time.monotonic()))
        self._send_to_notebook(1.0 / _FRAME_RATE)

    def _send_to_notebook(self, pause: float) -> None:
        """Send a frame to the notebook, if one shows the page, and none before a pause [s] is over."""
        self._next_frame_at = time.monotonic() + pause
        if self._notebook_output is not None:
            frame = json.dumps(_frame(self._robot, self._data, self._newest), allow_nan=False)
            script = (
                f"document.getElementById('{self._name}')?.contentWindow.postMessage({frame}, '*')"
            )
            self._notebook_output.update({"application/javascript": script}, raw=True)

    def frames(self) -> Iterator[str]:
        """Yield frames for one browser as JSON, as they come, the last one too, until the view is
        closed.
        """
        data = self._robot.model.createData()
        sent_moment = self._newest
        closed = False
        while not closed:
            closed = self._closed.wait(1.0 / _FRAME_RATE)
            if self._newest is not sent_moment:
                sent_moment = self._newest
                yield json.dumps(_frame(self._robot, data, sent_moment), allow_nan=False)

    def close(self) -> None:
        """Stop serving; open pages keep their last frame."""
        self._closed.set()
        self._stack.close()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"LiveView({self.address})"

    def _ipython_display_(self) -> None:
        """Show the page, and later ticks, through the notebook's own channel: the kernel may be on
        another machine.
        """
        from IPython.display import display

        self._name = f"live-{uuid4().hex}"
        display({"text/html": self._page.framed(self._name)}, raw=True)
        self._notebook_output = display(
            {"application/javascript": f"{asset('hear.js')}('{self._name}')"},
            raw=True,
            display_id=True,
        )
        if find_spec("ipywidgets"):
            from ipywidgets import Text

            # A script of the notebook's page writes the dragged configuration into this text.
            dragged = Text(layout={"display": "none"})
            dragged.add_class(self._name).observe(
                lambda change: self._apply_drag(json.loads(change["new"])), "value"
            )
            display(dragged)

    def _apply_drag(self, dragged: Mapping[str, Any]) -> None:
        """Set configuration and goal to those that were dragged in a notebook."""
        self._newest = self._robot.configuration(**dragged["q"])
        self.goal = pin.XYZQUATToSE3(np.array(dragged["goal"]))
        self.on_change(self)


def _frame(robot: Robot, data: pin.Data, moment: _Moment | np.ndarray) -> dict[str, Any]:
    """Return a frame as JSON values: of a tick its time, a pose for each joint of the model, phase
    and quantities; of a configuration (n_q,) [m, rad] the values of the sliders.
    """
    if isinstance(moment, np.ndarray):
        values = []
        for joint in range(1, robot.model.njoints):
            values.append(posed.joint_motion(robot, joint, moment)["values"])
        return {"joints": values}
    t, state, command = moment
    pin.forwardKinematics(robot.model, data, state.q)
    telemetry = command.telemetry
    return {
        "t": round(t, 4),
        "poses": [animation.rounded(pin.SE3ToXYZQUAT(X), _DIGITS) for X in list(data.oMi)[1:]],
        "phase": int(telemetry["phase"]) if "phase" in telemetry else None,
        "values": animation.rounded(telemetry["quantities"]) if "quantities" in telemetry else [],
    }


@checked
def live(
    what: Scenario | Robot,
    *,
    q: ArrayLike | None = None,
    speed: Positive = 1.0,
    port: Count = 0,
    height: AtLeastOne = 520,
) -> LiveView:
    """Serve a page that shows a run while it goes on, ``scenario.run(observer=live(scenario))``, or
    a robot that Python moves; return the view that moves it.

    ``view = live(scenario)``, ``display(view)`` shows it in a notebook, `height` [px] high,
    wherever the kernel is, and a run with ``observer=view`` moves it. ``view = live(robot)`` is
    moved by ``view.display(q)``; in a notebook with ``ipywidgets`` its links and a goal can be
    dragged, which ``view.q`` and ``view.goal`` tell, and ``view.on_change = f`` calls ``f(view)``
    each time. Other browsers of this machine find it at its ``address``; nobody else is served.

    q (n_q,) [m, rad]: configuration of a robot that is shown first, with the goal at its tool, and
    that the camera is placed for; by default at home. speed: largest speed of the run, in multiples
    of the clock's. port: 0 for any that is free. The view does not change the record of the run.
    Two ticks are run beforehand, to find the surroundings.

    Raises `OutputError` for a port that is taken, `InvalidInput` for a q of a scenario, which has
    its own start, and as `Scenario.run`.
    """
    if isinstance(what, Robot):
        robot = what
        if q is None:
            q = what.configuration()
        else:
            q = what.check_configuration(q)
    elif q is not None:
        raise InvalidInput(f"q = {short(q)} of a scenario; give it as its start")
    else:
        robot = what.robot
        q = what.start
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    if robot.tools:
        goal = data.oMf[robot.frame_id(robot.tools[0])]
    else:
        goal = data.oMi[-1]
    if isinstance(what, Robot):
        page = posed.posed_page(robot, q, height, live={"goal": pin.SE3ToXYZQUAT(goal).tolist()})
    else:
        page = live_page(replace(what, duration=what.dt).run(), robot, height)
    return LiveView(robot, page, q, goal.copy(), speed=speed, port=port)
