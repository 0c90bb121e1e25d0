"""Laws of actuator health: what is faulty is named, what is sound is left alone."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from actuators.hovering import Hover, run
from compiler import needs_compiler
from scipy.optimize import linprog

from uvms_ocp.codegen.kernel_layout import assign, structure_of
from uvms_ocp.codegen.kernels import bind_kernels, make_memory
from uvms_ocp.control.faults.authority import (
    Authority,
    AuthorityMemory,
    authority_in,
    authority_program,
    judge_authority,
)
from uvms_ocp.control.faults.detection import (
    FaultDetection,
    WrenchBalance,
    begin_wrench_balance,
    detect_faults,
    update_wrench_balance,
)
from uvms_ocp.control.faults.fault_classification import FaultFit, classify_fault
from uvms_ocp.control.faults.joint_faults import JointFaultMemory, detect_joint_faults
from uvms_ocp.control.faults.monitor import (
    detection_parts,
    joint_verdicts,
    thruster_verdicts,
    window_capacity,
    write_detection,
    write_joint_watch,
    write_thruster_watch,
)
from uvms_ocp.control.faults.residual_filter import FilteredCommands, residual_filter_for
from uvms_ocp.control.faults.thruster_faults import ThrusterFaultMemory, detect_thruster_faults
from uvms_ocp.control.faults.tuning import ActuatorHealthTuning
from uvms_ocp.control.faults.verdicts import (
    FaultKind,
    ThrusterEffectiveness,
    ThrusterVerdict,
    thruster_alarm,
)
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.dimensions import dimensions_of
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import thrust_limits, thruster_matrix

ROBOTS = Path(__file__).parents[2] / "robots"
FULL = "girona_maris7_full"
RIGHTING = np.array([0.0, 0.0, 0.0, 30.0, 30.0, 0.0])


def without(*thrusters: int) -> ThrusterEffectiveness:
    share = np.ones(8)
    share[list(thrusters)] = 0.0
    return ThrusterEffectiveness(share=share, constant=np.zeros(8))


def nothing_asked(n_thrusters: int, n_v: int) -> FilteredCommands:
    return FilteredCommands(thrust=np.zeros(n_thrusters), way=np.zeros(n_v), ticks=0.0)


def authority_of(
    matrix: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    effectiveness: ThrusterEffectiveness,
    trim: np.ndarray,
    righting: np.ndarray,
    compiled: bool = True,
) -> Authority:
    """The control authority left with this effectiveness, for a robot that `trim` holds still."""
    n = len(lower)
    kinds: list[Any] = [
        structure_of(AuthorityMemory, n_thrusters=n, program=authority_program(n)),
        structure_of(ThrusterEffectiveness, n_thrusters=n),
    ]
    (judge,) = bind_kernels((judge_authority,), kinds, compiled=compiled)
    memory = kinds[0]()
    assign(memory, matrix=matrix, lower=lower, upper=upper, trim=trim, righting=righting)
    judge(memory, kinds[1](tuple(effectiveness.share), tuple(effectiveness.constant)))
    return authority_in(memory)


class Watched:
    """Eight thrusters, watched by the kernel."""

    def __init__(
        self,
        matrix: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        tuning: ActuatorHealthTuning,
        period: float,
        compiled: bool,
    ) -> None:
        sizes = {"n_thrusters": 8, "n_looks": window_capacity(tuning, period)}
        structures = (
            structure_of(ThrusterFaultMemory, **sizes),
            structure_of(ThrusterEffectiveness, **sizes),
        )
        self.watch, self.effectiveness = (structure() for structure in structures)
        write_thruster_watch(
            self.watch, matrix, lower, upper, tuning=tuning, bandwidth=3.0, period=period
        )
        self.effectiveness.share[:] = [1.0] * 8
        (self._look,) = bind_kernels((detect_thruster_faults,), structures, compiled=compiled)

    def look(self, residual: np.ndarray, requested: np.ndarray, t: float) -> int:
        return int(
            self._look(self.watch, self.effectiveness, vector(residual), vector(requested), t)
        )

    @property
    def verdicts(self) -> list[ThrusterVerdict]:
        return thruster_verdicts(self.watch, self.effectiveness, 8)


def vector(values: np.ndarray) -> Any:
    return (ctypes.c_double * len(values))(*values)


def watched(
    robot: str,
    thruster: int,
    share: float,
    constant: float,
    push: np.ndarray,
    busy: float = 0.02,
    compiled: bool = True,
) -> list[ThrusterVerdict]:
    """Verdicts after 12 s in which one thruster gives ``share * asked + constant`` of its limit
    from 4 s on.

    All are asked smooth noise, which grows with `busy`; push (k, 6), shares of the reach, acts as
    the observer sees it, and what is asked makes up for it half a second later.
    """
    machine = load_robot(robot)
    matrix = thruster_matrix(machine)
    lower, upper = thrust_limits(machine)
    tuning = ActuatorHealthTuning()
    residual_filter = residual_filter_for(tuning, bandwidth=3.0, dt=0.02)
    filtered = nothing_asked(8, 6)
    watch = Watched(matrix, lower, upper, tuning, 0.02 * residual_filter.every, compiled=compiled)
    rng = np.random.default_rng(thruster)
    noise = np.zeros(8)
    observed = np.zeros(6)
    reach = np.abs(matrix) @ upper
    back = np.linalg.pinv(matrix)
    for k in range(600):
        noise += busy * rng.normal(size=8) * upper - 0.02 * noise
        requested = noise - back @ (reach * push[max(k - 25, 0)])
        lost = np.zeros(8)
        if k >= 200:
            lost[thruster] = (share - 1.0) * requested[thruster] + constant * upper[thruster]
        observed += (1.0 - np.exp(-3.0 * 0.02)) * (matrix @ lost + reach * push[k] - observed)
        filtered = residual_filter.after(filtered, requested, np.zeros(6))
        if filtered.ticks == 0.0 and watch.look(observed, filtered.thrust, 0.02 * k) >= 0:
            break
    return watch.verdicts


STILL = np.zeros((600, 6))
MANNERS = {
    FaultKind.DEAD: (0.0, 0.0),
    FaultKind.WEAK: (0.4, 0.0),
    FaultKind.REVERSED: (-1.0, 0.0),
    FaultKind.STUCK: (0.0, 0.4),
}


@pytest.mark.parametrize("kind", MANNERS)
@pytest.mark.parametrize("thruster", [0, 2, 5, 7])
@pytest.mark.parametrize("robot", [FULL, "bluerov2_alpha5"])
def test_the_thruster_that_fails_is_named_alone_and_how(
    robot: str, thruster: int, kind: FaultKind
) -> None:
    verdicts = watched(robot, thruster, *MANNERS[kind], STILL)
    assert {i: verdict.kind for i, verdict in enumerate(verdicts) if verdict.kind} == {
        thruster: kind
    }


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("robot", [FULL, "bluerov2_alpha5"])
def test_a_push_along_an_axis_and_what_makes_up_for_it_is_no_fault(robot: str, axis: int) -> None:
    push = STILL.copy()
    push[200:, axis] = 0.3 * (1.0 - np.exp(-0.02 * np.arange(400)))
    push[400:] *= 0.3
    assert not any(verdict.kind for verdict in watched(robot, 0, 1.0, 0.0, push))


@pytest.mark.parametrize("thruster", range(8))
def test_a_push_just_where_a_thruster_pushes_is_no_fault_if_what_is_asked_follows_it(
    thruster: int,
) -> None:
    machine = load_robot(FULL)
    matrix = thruster_matrix(machine)
    _, upper = thrust_limits(machine)
    push = np.outer(
        np.repeat([0.0, 1.0], 300),
        0.3 * upper[thruster] * matrix[:, thruster] / (np.abs(matrix) @ upper),
    )
    assert not any(verdict.kind for verdict in watched(FULL, thruster, 1.0, 0.0, push, busy=0.005))


@pytest.mark.parametrize("dead", [(0,), (5,), (0, 4), (4, 7)])
def test_a_mission_goes_on_without_one_thruster_or_two(dead: tuple[int, ...]) -> None:
    robot = load_robot(FULL)
    remaining = authority_of(
        thruster_matrix(robot), *thrust_limits(robot), without(*dead), np.zeros(6), RIGHTING
    )
    assert remaining.can_go_on
    assert (remaining.reach <= remaining.sound + 1e-6).all()


def test_a_mission_ends_where_no_thruster_drives_an_axis() -> None:
    robot = load_robot(FULL)
    remaining = authority_of(
        thruster_matrix(robot), *thrust_limits(robot), without(0, 1, 2), np.zeros(6), RIGHTING
    )
    assert not remaining.can_go_on
    assert "yaw" in (*remaining.lost, *remaining.one_sided)
    assert "yaw" in str(remaining)


def test_what_sound_thrusters_reach_is_all_there() -> None:
    robot = load_robot(FULL)
    remaining = authority_of(
        thruster_matrix(robot), *thrust_limits(robot), without(), np.zeros(6), RIGHTING
    )
    assert str(remaining) == "nothing is out of reach"


def pushed(effort: float, moves: float, way: float = 1.0, compiled: bool = True) -> list[FaultKind]:
    """After 3 s in which two joints are asked for 0.2 rad/s: one stands, one goes at `moves`
    [rad/s], against `effort` [N m].

    way: the sign of what is asked.
    """
    structure = structure_of(JointFaultMemory, n_joints=2)
    watch = structure()
    (look,) = bind_kernels((detect_joint_faults,), (structure,), compiled=compiled)
    write_joint_watch(watch, np.array([10.0, 10.0]), np.array([0.05, 0.05]))
    for k in range(30):
        q = np.array([0.0, 0.1 * k * moves])
        look(
            watch,
            vector(way * np.array([0.02, 0.02])),
            vector(way * q),
            vector(-way * np.array([effort, effort])),
            0.1 * k,
        )
    return [verdict.kind for verdict in joint_verdicts(watch)]


def test_a_joint_that_is_asked_pushed_and_stands_is_jammed_and_one_that_follows_is_not() -> None:
    assert pushed(5.0, 0.2) == [FaultKind.JAMMED, FaultKind.NONE]


def test_a_joint_that_stands_because_nothing_pushes_it_is_not_jammed() -> None:
    assert not any(pushed(0.0, 0.0))


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_joint_jams_whichever_way_it_is_asked_and_not_where_it_is_drawn_along(way: float) -> None:
    assert pushed(5.0, 0.2, way, compiled=False) == [FaultKind.JAMMED, FaultKind.NONE]
    assert not any(pushed(-5.0, 0.2, way, compiled=False))


def test_the_wrench_that_holds_the_robot_is_the_mean_over_the_second_half_of_the_wait() -> None:
    balance = structure_of(WrenchBalance)()
    rng = np.random.default_rng(0)
    began = 2.0
    for _ in range(2):  # what the wait before has summed up counts for nothing
        begin_wrench_balance(balance, began)
        balance.runs = True
        waits = []
        wrenches = []
        due = False
        while not due:
            waits.append(0.1 * len(waits))
            wrenches.append(rng.normal(size=6))
            due = update_wrench_balance(balance, vector(wrenches[-1]), began + waits[-1])
        second = np.array(waits) > 0.5 * waits[-1] + 1e-6
        np.testing.assert_allclose(
            balance.mean, np.array(wrenches)[second].mean(axis=0), rtol=0, atol=1e-12
        )
        assert not balance.runs


FAILS = {  # share and constant [N] of a thruster that fails
    FaultKind.DEAD: (0.0, 0.0),
    FaultKind.WEAK: (0.4, 0.0),
    FaultKind.REVERSED: (-1.0, 0.0),
    FaultKind.STUCK: (0.0, -6.0),
}


@pytest.mark.parametrize("first", [-9.0, 0.0, 12.0])
@pytest.mark.parametrize("kind", [FaultKind.DEAD, FaultKind.WEAK, FaultKind.REVERSED])
def test_a_fault_from_before_the_window_is_no_thruster_that_sticks_at_what_it_was_asked(
    kind: FaultKind, first: float
) -> None:
    """A dead thruster that was found after 12 s "gives 39 N whatever it is asked"."""
    share, _ = FAILS[kind]
    rng = np.random.default_rng(4)
    n = 70
    fit = structure_of(FaultFit, n_looks=n)()
    fit.count = n
    fit.bandwidth = 3.0
    time = 0.1 * np.arange(n)
    requested = first + 8.0 * np.sin(1.3 * time) + 5.0 * np.sin(3.1 * time)
    along = (share - 1.0) * requested + 4.0 + 0.01 * rng.normal(size=n)
    assign(fit, time=time, asked=requested, along=along)
    classify_fault(fit)
    assert fit.share == pytest.approx(share, abs=0.01)
    assert fit.constant == 0.0


@pytest.mark.parametrize("kind", FAILS)
def test_share_constant_and_onset_are_those_that_the_residual_was_made_with(
    kind: FaultKind,
) -> None:
    share, constant = FAILS[kind]
    onset = 25
    rng = np.random.default_rng(4)
    n = 70
    bandwidth = 3.0
    fit = structure_of(FaultFit, n_looks=n)()
    fit.count = n
    fit.bandwidth = bandwidth
    time = 0.1 * np.arange(n)
    requested = 8.0 * np.sin(1.3 * time) + 5.0 * np.sin(3.1 * time)
    faded = np.exp(
        -bandwidth * np.maximum(time - time[onset], 0.0)
    )  # of what was before, in a filter of first order
    lost = (share - 1.0) * (requested - requested[onset] * faded) + constant * (1.0 - faded)
    along = np.where(time > time[onset], lost, 0.0) + 0.01 * rng.normal(size=n)
    assign(fit, time=time, asked=requested, along=along)
    classify_fault(fit)
    assert (fit.share, fit.constant) == pytest.approx((share, constant), abs=0.02)
    assert (fit.constant == 0.0) == (constant == 0.0)
    assert fit.onset == pytest.approx(time[onset], abs=0.1 + 1e-9)


@pytest.mark.parametrize(
    ("verdict", "told"),
    [
        (
            ThrusterVerdict(kind=FaultKind.WEAK, share=0.4),
            "thruster3 weak (aft): gives 40 % of what it is asked; asked for more",
        ),
        (
            ThrusterVerdict(kind=FaultKind.DEAD, share=0.0),
            "thruster3 dead (aft): gives 0 % of what it is asked; taken out",
        ),
    ],
)
def test_an_alarm_tells_the_share_in_percent(verdict: ThrusterVerdict, told: str) -> None:
    assert thruster_alarm(3, "aft", verdict) == told


def test_impossible_tunings_are_refused() -> None:
    with pytest.raises(InvalidInput, match="explained"):
        ActuatorHealthTuning(explained=1.0)
    with pytest.raises(InvalidInput, match="window"):
        ActuatorHealthTuning(window=0.0)


@pytest.mark.slow
def test_commands_are_the_same_to_the_last_bit_while_nothing_is_faulty() -> None:
    watched = run(Hover(duration=4.0, seed=2))
    alone = run(Hover(duration=4.0, seed=2, watched=False))
    np.testing.assert_array_equal(watched.commands, alone.commands)
    assert watched.alarms == []


def test_the_way_of_a_joint_that_turns_without_end_is_known(tmp_path: Path) -> None:
    source = ROBOTS / "bluerov2_alpha5"
    text = (source / "robot.urdf").read_text(encoding="utf-8")
    (tmp_path / "robot.urdf").write_text(
        text.replace('type="revolute"', 'type="continuous"', 1), encoding="utf-8"
    )
    machine = load_robot(urdf=tmp_path / "robot.urdf", hydrodynamics=source / "hydrodynamics.yaml")
    assert machine.n_q == machine.n_v + 2
    memory, look, every = looks_of(machine)
    q = machine.configuration()
    v = np.zeros(machine.n_v)
    v[machine.joint_v] = 0.3
    memory.encoders_trusted = True
    memory.way[:] = (every * v).tolist()
    memory.residual[:] = (-10.0 * v).tolist()
    for k in range(1, 100):
        q = pin.integrate(machine.model, q, 0.1 * v)
        memory.q[:] = q.tolist()
        assert not look(memory, 0.1 * k)
    assert not any(memory.joints.jammed)


def test_thrust_is_taken_in_as_late_as_the_residual_tells_of_it() -> None:
    residual_filter = residual_filter_for(ActuatorHealthTuning(), bandwidth=3.0, dt=0.02)
    filtered = nothing_asked(2, 0)
    for k in range(1, 101):
        filtered = residual_filter.after(filtered, np.array([5.0, -40.0]), np.zeros(0))
        np.testing.assert_allclose(
            filtered.thrust, (1.0 - np.exp(-3.0 * 0.02 * k)) * np.array([5.0, -40.0])
        )


@pytest.mark.parametrize("dt", [1 / 200, 1 / 50, 1.0])
def test_a_look_is_due_at_its_period_and_hears_of_every_velocity_once(dt: float) -> None:
    tuning = ActuatorHealthTuning()
    residual_filter = residual_filter_for(tuning, bandwidth=0.5, dt=dt)
    filtered = nothing_asked(0, 1)
    looks = []
    for k in range(1, 201):
        filtered = residual_filter.after(filtered, np.zeros(0), np.array([float(k)]))
        if filtered.ticks == 0.0:
            looks.append((k, filtered.way[0]))
    ticks = np.array([k for k, _ in looks])
    assert (np.diff(ticks, prepend=0) == max(1, round(tuning.sample_time / dt))).all()
    assert sum(way for _, way in looks) == pytest.approx(ticks[-1] * (ticks[-1] + 1) / 2)


def looks_of(machine: Robot) -> tuple[Any, Callable[..., int], int]:
    """The memory of looks at a robot, the kernel, and the ticks from look to look."""
    tuning = ActuatorHealthTuning()
    dt = 0.02
    residual_filter = residual_filter_for(tuning, bandwidth=3.0, dt=dt)
    parts = detection_parts(
        machine, robot_dynamics(machine).symbolic, tuning, residual_filter.every * dt
    )
    structure = structure_of(FaultDetection, dimensions_of(machine), **parts)
    memory, (look,) = make_memory(structure, (detect_faults,))
    write_detection(memory, machine, tuning, residual_filter, bandwidth=3.0, dt=dt)
    return memory, look, residual_filter.every


@pytest.mark.sampled
@needs_compiler
@pytest.mark.parametrize("kind", MANNERS)
def test_in_c_and_in_python_a_fault_is_judged_by_the_same_bits(kind: FaultKind) -> None:
    told, same = (
        watched(FULL, 2, *MANNERS[kind], STILL, compiled=compiled)[2] for compiled in (True, False)
    )
    assert told.kind == kind
    assert told == same


@pytest.mark.parametrize("seed", range(30))
def test_authority_is_that_of_linear_programs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = (4, 6, 8)[seed % 3]
    righting = np.r_[np.zeros(3), rng.uniform(0.0, 40.0, 2), 0.0]
    upper = rng.uniform(10.0, 100.0, n)
    matrix = rng.normal(size=(6, n))
    lower = -rng.uniform(0.0, 1.0, n) * upper
    share = rng.choice([0.0, 1.0, 0.5, -1.0], n, p=[0.2, 0.6, 0.1, 0.1])
    trim = rng.choice([0.0, 20.0]) * rng.normal(size=6)
    effectiveness = ThrusterEffectiveness(
        share=share, constant=np.where(share == 0.0, rng.choice([0.0, 0.3], n) * upper, 0.0)
    )
    # Some in Python, where no array can be read beyond its end.
    remaining = authority_of(
        matrix, lower, upper, effectiveness, trim, righting, compiled=seed % 10 > 0
    )
    ends = np.sort([effectiveness.given(lower), effectiveness.given(upper)], axis=0)
    for computed, limits, balance in (
        (remaining.reach, ends, trim),
        (remaining.sound, (lower, upper), np.zeros(6)),
    ):
        oracle = [
            [largest(matrix, limits, balance, righting, axis, way) for way in (-1, 1)]
            for axis in range(6)
        ]
        np.testing.assert_allclose(computed, oracle, rtol=1e-7, atol=1e-7)


def largest(
    matrix: np.ndarray,
    limits: Sequence[np.ndarray],
    trim: np.ndarray,
    righting: np.ndarray,
    axis: int,
    way: int,
) -> float:
    """Largest x with ``matrix T + s = trim + way x e``, T within its limits, s within what the
    water balances, by SciPy.
    """
    direction = -way * np.eye(6)[:, [axis]]
    own_axis = np.arange(6) == axis if axis in (3, 4) else np.zeros(6, dtype=bool)
    trim = np.where(own_axis, 0.0, trim)
    righting = np.where(own_axis, 0.0, righting)
    result = linprog(
        c=np.r_[np.zeros(matrix.shape[1] + 6), -1.0],
        A_eq=np.hstack([matrix, np.eye(6), direction]),
        b_eq=trim,
        bounds=[*zip(*limits, strict=True), *((-r, r) for r in righting), (0.0, None)],
    )
    return float(-result.fun) if result.success else np.nan
