"""Laws of the worker of receding-horizon control: the same plans beside as in line, and no tick
that fails or waits with it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from time import sleep

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.control.nmpc import Nmpc
from uvms_ocp.control.replanning import HOLD, ReplanningRequest, ReplanningResult
from uvms_ocp.control.solve_workers import (
    ProcessWorker,
    ReplanningJob,
    RunningWorker,
    SynchronousWorker,
    WorkerStatus,
    start_worker,
)
from uvms_ocp.errors import InvalidInput, UvmsError
from uvms_ocp.ocp.problem import HessianKind, OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.terms import At, Effort, TaskTerm
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Command, State, StateEstimate
from uvms_ocp.tasks.goals import PoseGoal
from uvms_ocp.tasks.pose import ToolPosition

PERIOD = 0.05
PATIENCE = 6000
"""[10 ms] before a test gives up on an answer."""


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("planar5")


def start(robot: Robot) -> State:
    return State(q=robot.configuration(joints=[0.3] * robot.n_joints), v=np.zeros(robot.n_v))


def reach(robot: Robot, goal: PoseGoal | None = None) -> OcpProblem:
    place = pin.SE3(np.eye(3), np.array([0.5, 0.5, 0.0])) if goal is None else goal
    tool = TaskTerm(task=ToolPosition(goal=place), at=At.PATH, weight=10.0)
    levels = (OcpLevel(name="tool", terms=(tool, Effort())),)
    problem = single_phase(robot=robot, start=start(robot), duration=1.0, n_steps=5, levels=levels)
    return replace(problem, hessian=HessianKind.GAUSS_NEWTON)


def job(robot: Robot, goal: PoseGoal | None = None) -> ReplanningJob:
    return ReplanningJob(
        problem=reach(robot, goal), period=PERIOD, options=None, gains=None, clock=lambda: 0.0
    )


def answered(worker: RunningWorker, request: ReplanningRequest) -> ReplanningResult:
    worker.ask(request)
    for _ in range(PATIENCE):
        answer = worker.answer()
        if answer is not None:
            return answer
        sleep(0.01)
    raise AssertionError("no answer")


@pytest.fixture
def beside(robot: Robot) -> Iterator[RunningWorker]:
    worker = start_worker(ProcessWorker(timeout=60.0), job(robot))
    yield worker
    worker.close()


def ticks(nmpc: Nmpc, robot: Robot, begin: float, n: int) -> list[Command]:
    state = start(robot)
    measurement = StateEstimate(q=state.q, v=state.v, altimeter_range=np.nan)
    return [nmpc(measurement, begin + i / 200) for i in range(n)]


@pytest.mark.slow
def test_plans_made_beside_are_those_made_in_line(robot: Robot, beside: RunningWorker) -> None:
    within = start_worker(SynchronousWorker(), job(robot))
    number = HOLD
    began = 0.0
    for t in (0.0, 0.0, 0.05, 0.1):
        request = ReplanningRequest(
            state=start(robot), t=t, in_use=number, begin=began, delay=PERIOD
        )
        plan_within = answered(within, request)
        plan_beside = answered(beside, request)
        assert plan_within.first is plan_beside.first is (number == HOLD)
        assert plan_within.planned is not None
        assert plan_beside.planned is not None
        for name in ("t", "q", "v", "a", "torque"):
            by_process, expected = (
                getattr(answer.planned.trajectory, name) for answer in (plan_beside, plan_within)
            )
            np.testing.assert_allclose(
                by_process, expected, rtol=1e-6, atol=1e-6
            )  # accuracy of a step's QP
        number = plan_within.planned.number
        began = plan_within.planned.begin
        assert (plan_beside.planned.number, plan_beside.planned.begin) == (number, began)


@pytest.mark.slow
def test_the_robot_stays_until_the_first_plan_beside_and_follows_it_then(robot: Robot) -> None:
    with Nmpc(reach(robot), worker=ProcessWorker(timeout=60.0, lead=0.01)) as nmpc:
        first_command = ticks(nmpc, robot, 0.0, 1)[0]
        assert np.abs(first_command.v).max() == 0.0
        moved = False
        t = 0.005
        for _ in range(PATIENCE):
            moved = bool(np.abs(ticks(nmpc, robot, t, 1)[0].v).max() > 1e-3)
            t += 0.005
            if moved and nmpc.statistics.solve_times:
                break
            sleep(0.01)
        assert moved
        assert nmpc.worker_status is WorkerStatus.WORKING
    assert nmpc.worker_status is WorkerStatus.CLOSED


@pytest.mark.slow
def test_a_process_that_was_killed_is_a_status_and_ticks_go_on(robot: Robot) -> None:
    with Nmpc(reach(robot), worker=ProcessWorker()) as nmpc:
        ticks(nmpc, robot, 0.0, 1)
        process = nmpc._worker._process  # type: ignore[attr-defined]
        process.kill()
        process.join()
        commands = ticks(nmpc, robot, 0.005, 400)
        assert nmpc.worker_status is WorkerStatus.CRASHED
        assert all(np.isfinite(command.torque).all() for command in commands)
    assert nmpc.worker_status is WorkerStatus.CRASHED


@pytest.mark.slow
def test_a_solve_that_takes_too_long_is_stopped(robot: Robot) -> None:
    worker = start_worker(ProcessWorker(timeout=1e-9), job(robot))
    process = worker._process  # type: ignore[attr-defined]
    worker.ask(ReplanningRequest(state=start(robot), t=0.0, in_use=HOLD, begin=0.0, delay=PERIOD))
    assert worker.answer() is None
    assert worker.status is WorkerStatus.SILENT
    worker.close()
    assert worker.status is WorkerStatus.SILENT
    assert not process.is_alive()


@pytest.mark.slow
def test_closing_ends_the_process_and_may_be_done_twice(
    robot: Robot, beside: RunningWorker
) -> None:
    """It ends by itself: killed, it left semaphores behind, of which Python warned at the end."""
    process = beside._process  # type: ignore[attr-defined]
    assert process.is_alive()
    beside.close()
    beside.close()
    assert process.exitcode == 0
    assert beside.status is WorkerStatus.CLOSED
    beside.ask(ReplanningRequest(state=start(robot), t=0.0, in_use=HOLD, begin=0.0, delay=PERIOD))
    assert beside.answer() is None


def test_a_controller_that_is_closed_holds_the_end_of_its_last_plan(robot: Robot) -> None:
    nmpc = Nmpc(reach(robot), clock=lambda: 0.0)
    assert np.abs(ticks(nmpc, robot, 0.0, 20)[-1].v).max() > 1e-3
    nmpc.close()
    solves = len(nmpc.statistics.solve_times)
    assert np.abs(ticks(nmpc, robot, 2.0, 20)[-1].v).max() == 0.0
    assert len(nmpc.statistics.solve_times) == solves
    assert nmpc.worker_status is WorkerStatus.CLOSED


def test_what_cannot_be_sent_is_refused(robot: Robot) -> None:
    def nearby(t: float) -> tuple[pin.SE3, np.ndarray]:
        return pin.SE3.Identity(), np.zeros(6)

    with pytest.raises(InvalidInput, match="top level of a module"):
        start_worker(ProcessWorker(), job(robot, nearby))


def test_a_process_that_does_not_get_ready_is_an_error(robot: Robot) -> None:
    with pytest.raises(UvmsError, match="raise start_timeout"):
        start_worker(ProcessWorker(start_timeout=1e-3), job(robot))
