"""What runs of one process leave behind does not grow with their number."""

from __future__ import annotations

import ctypes
import json
import subprocess
import sys

import pytest
from compiler import long_without_compiler, needs_compiler

from uvms_ocp.codegen import loading
from uvms_ocp.scenario.cases import case1


def _pointers() -> int:
    return len(getattr(ctypes, "_pointer_type_cache", ()))


def _run() -> None:
    case1(plant="kinematic", duration=0.1, dt=0.02).run()


@needs_compiler
def test_machine_code_is_taken_up_once() -> None:
    """Before, 19 functions and 0.7 MB a run were kept for ever."""
    _run()
    before = len(loading.ADDRESSES), _pointers()
    for _ in range(3):
        _run()
    assert (len(loading.ADDRESSES), _pointers()) == before


CHANGED = """
import gc, json, sys
from pathlib import Path

import numpy as np
import pinocchio as pin

import uvms_ocp as uo
from uvms_ocp.campaign import vary
from uvms_ocp.ocp import AtRest, Effort, OcpLevel, Planner, Smoothness, TaskTerm, single_phase
from uvms_ocp.robot import State
from uvms_ocp.solvers import NlpOptions
from uvms_ocp.tasks import ToolPosition

draw, known = np.random.default_rng(9), uo.scenario.case1(noise=True, duration=0.05)
robot = uo.load_robot("bluerov2_alpha5")
q = robot.configuration(position=(0, 0, -5))
start, tool = State(q=q, v=np.zeros(robot.n_v)), uo.Kinematics(robot, q).pose(robot.tools[0])

def memory():
    gc.collect()
    text = Path("/proc/self/status").read_text()
    return int(text.partition("VmRSS:")[2].split()[0]) / 1e3

def run(k):
    numbers = {"tasks.T.gain_linear": draw.uniform(0.2, 0.9), "tasks.MAC.threshold": draw.uniform(0.8, 1.2)}
    vary(known, {**numbers, "goals.T.x": draw.normal(0, 0.02), "current.x": draw.normal(0, 0.05)}, seed=k).run()

def plan(k):
    goal = pin.SE3(tool.rotation, tool.translation + draw.uniform(-0.3, 0.3, 3))
    level = OcpLevel(name="tool", terms=(TaskTerm(task=ToolPosition(goal=goal, frame=robot.tools[0])),))
    weights = (Effort(weight=draw.uniform(0.5, 2)), Smoothness(weight=draw.uniform(0.01, 1)))
    levels = (level, OcpLevel(name="effort", terms=weights))
    problem = single_phase(
        robot=robot, start=start, duration=draw.uniform(6, 9), n_steps=12, levels=levels, constraints=(AtRest(),)
    )
    Planner(problem, NlpOptions(time_limit=60.0), wait_for_compiler=True).plan()

for work, number in ((run, 300), (plan, 100)):
    for k in range(number):
        work(k)
        tenth = memory() if k == 9 else tenth if k > 9 else 0
    print(json.dumps([tenth, memory()]))
"""


@pytest.mark.slow
@long_without_compiler
@pytest.mark.skipif(
    sys.platform != "linux", reason="reads the memory of a process where Linux tells it"
)
def test_hundreds_of_changed_runs_and_planners_take_no_more_than_ten() -> None:
    """Within 30 MB: what is kept of each is bounded, such as the machine code that has its
    numbers.
    """
    done = subprocess.run(
        [sys.executable, "-c", CHANGED], capture_output=True, text=True, timeout=1800, check=True
    )
    for tenth, last in map(json.loads, done.stdout.splitlines()):
        assert last - tenth < 30.0, done.stdout
