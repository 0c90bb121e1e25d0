"""Laws of what goes wrong with the machine: thrusters, jammed joints, payloads."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from fault_registry import MACHINE, WATER

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.assembly import without_arm
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Command
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.faults import FAMILIES, Fault, FaultModel, parse_faults
from uvms_ocp.sim.machine_faults import (
    THRUSTER_EFFECTS,
    ThrusterEffect,
    joined_velocity,
    loaded,
    require_possible,
    thruster_condition,
)
from uvms_ocp.sim.plant import KinematicPlant
from uvms_ocp.sim.seafloor import FlatSeafloor

DEEP = Environment(seafloor=FlatSeafloor(z=-1000.0))
DT = 0.02
ONSET = 0.4
END = 1.0


@pytest.fixture(scope="module", name="robot")
def _robot() -> Robot:
    return load_robot("girona_maris7_full")


dynamics_of = cache(robot_dynamics)


def plant_of(robot: Robot, *texts: str, max_step: float = 5e-3) -> DynamicPlant:
    q = robot.configuration(joints=0.2 + robot.home)
    faults = parse_faults(texts)
    return DynamicPlant(
        robot, q, dynamics=dynamics_of(robot), environment=DEEP, max_step=max_step, faults=faults
    )


def working(robot: Robot, k: int) -> Command:
    """Thrust and torque that change all the time."""
    n = len(robot.description.thrusters)
    t = k * DT
    thrust = 15.0 * np.sin(t + np.arange(n)) + 10.0
    return Command(
        v=np.zeros(robot.n_v),
        thrust=thrust,
        torque=3.0 * np.cos(2.0 * t + np.arange(robot.n_joints)),
    )


def carry_on(
    plant: DynamicPlant, robot: Robot, ticks: range, told: Callable[[int], None] = lambda k: None
) -> None:
    for k in ticks:
        plant.step(working(robot, k), DT)
        told(k + 1)


@cache
def sound_rows() -> list[dict[str, np.ndarray]]:
    """What a plant without faults goes through, tick by tick."""
    robot = load_robot("girona_maris7_full")
    plant = plant_of(robot)
    rows = [row_of(plant)]
    carry_on(plant, robot, range(25), lambda k: rows.append(row_of(plant)))
    return rows


def row_of(plant: DynamicPlant) -> dict[str, np.ndarray]:
    return {"q": plant.state.q, "v": plant.state.v, **plant.telemetry()}


@pytest.mark.sampled
@pytest.mark.parametrize("text", [*MACHINE, *WATER])
def test_nothing_changes_before_the_onset(text: str, robot: Robot) -> None:
    plant = plant_of(robot, f"{text}@{ONSET}")
    rows = [row_of(plant)]
    first = round(ONSET / DT)
    carry_on(plant, robot, range(25), lambda k: rows.append(row_of(plant)))
    for sound, faulty in zip(sound_rows()[: first + 1], rows[: first + 1], strict=True):
        for name, value in sound.items():
            np.testing.assert_array_equal(value, faulty[name], err_msg=name)
    assert not np.array_equal(sound_rows()[-1]["v"], rows[-1]["v"])


@pytest.mark.slow
@pytest.mark.parametrize("text", [*MACHINE, *WATER])
def test_the_machine_is_as_before_after_the_end(text: str, robot: Robot) -> None:
    """From the same state on, it moves as one that never had the fault."""
    sound = plant_of(robot)
    faulty = plant_of(robot, f"{text}@{ONSET}-{END}")
    carry_on(
        faulty, robot, range(180)
    )  # a current takes 2 s to fall, a thruster some of its time constants
    carry_on(sound, robot, range(180))
    np.testing.assert_allclose(sound.telemetry()["thrust"], faulty.telemetry()["thrust"], atol=1e-3)
    sound.state = faulty.state
    carry_on(sound, robot, range(180, 190))
    carry_on(faulty, robot, range(180, 190))
    np.testing.assert_allclose(sound.state.v, faulty.state.v, atol=1e-6)


def thrusts(robot: Robot, *texts: str, ticks: int = 60) -> np.ndarray:
    """(ticks, n) [N]"""
    plant = plant_of(robot, *texts)
    rows = []
    carry_on(plant, robot, range(ticks), lambda k: rows.append(plant.telemetry()["thrust"]))
    return np.array(rows)


def test_a_dead_thruster_gives_no_thrust_and_takes_no_power(robot: Robot) -> None:
    plant = plant_of(robot, f"thruster3:dead@{ONSET}")
    energies = []
    carry_on(
        plant, robot, range(40), lambda k: energies.append(plant.telemetry()["thruster_energy"])
    )
    sound = thrusts(robot)
    faulty = thrusts(robot, f"thruster3:dead@{ONSET}")
    first = round(ONSET / DT)
    assert (faulty[first:, 2] == 0.0).all()
    assert np.ptp([row[2] for row in energies[first - 1 :]]) == 0.0
    is_sound = np.arange(8) != 2
    np.testing.assert_array_equal(sound[:, is_sound], faulty[:, is_sound])


def test_a_stuck_thruster_stays_at_its_thrust(robot: Robot) -> None:
    faulty = thrusts(robot, f"thruster3:stuck@{ONSET}")
    first = round(ONSET / DT)
    np.testing.assert_allclose(faulty[first:, 2], faulty[first - 1, 2], rtol=1e-12)


def test_a_stuck_thruster_goes_to_the_thrust_that_is_given_as_far_as_it_can(robot: Robot) -> None:
    assert thrusts(robot, "thruster3:stuck=-20", ticks=200)[-1, 2] == pytest.approx(-20.0, abs=1e-6)
    assert thrusts(robot, "thruster3:stuck=9e4", ticks=200)[-1, 2] == pytest.approx(
        robot.description.thrusters[2].maximum
    )


@pytest.mark.parametrize(
    ("text", "share"), [("thruster3:weak=0.25", 0.25), ("thruster3:reversed", -1.0)]
)
def test_a_weak_or_reversed_thruster_gives_its_share(text: str, share: float, robot: Robot) -> None:
    sound = thrusts(robot)
    faulty = thrusts(robot, text)
    np.testing.assert_allclose(faulty[:, 2], share * sound[:, 2], atol=1e-9)


def test_each_kind_of_the_table_has_one_effect() -> None:
    assert set(FAMILIES["thruster"]) == set(THRUSTER_EFFECTS)


def test_a_new_kind_is_a_row_and_a_function(monkeypatch: pytest.MonkeyPatch) -> None:
    def sticky(fault: Fault, thrust: float) -> ThrusterEffect:
        return ThrusterEffect(share=0.5, offset=0.5 * thrust)

    monkeypatch.setitem(FAMILIES["thruster"], "sticky", FaultModel(effect="follows by half"))
    monkeypatch.setitem(THRUSTER_EFFECTS, "sticky", sticky)
    condition = thruster_condition(parse_faults(["thruster2:sticky"]), np.full(3, 8.0))
    np.testing.assert_array_equal(condition.share, [1.0, 0.5, 1.0])
    np.testing.assert_array_equal(condition.offset, [0.0, 4.0, 0.0])
    assert not condition.dead.any()


@pytest.mark.parametrize("kind", ["dead", "weak=0.25", "reversed", "stuck"])
def test_only_a_stuck_thruster_goes_on_with_what_it_gave(kind: str) -> None:
    condition = thruster_condition(parse_faults([f"thruster3:{kind}"]), np.full(8, 5.0))
    assert condition.offset.nonzero()[0].tolist() == ([2] if kind == "stuck" else [])


def test_several_faults_of_a_thruster_add_up(robot: Robot) -> None:
    sound = thrusts(robot)
    faulty = thrusts(robot, "thruster3:weak=0.25", "thruster3:reversed", "thruster5:dead")
    np.testing.assert_allclose(faulty[:, 2], -0.25 * sound[:, 2], atol=1e-9)
    assert not faulty[:, 4].any()


def test_a_jammed_joint_stands_still_and_the_others_move(robot: Robot) -> None:
    plant = plant_of(robot, f"joint2:jam@{ONSET}")
    rows = []
    rates = []
    carry_on(plant, robot, range(20))
    position = plant.state.q[robot.joint_q][1]
    carry_on(
        plant,
        robot,
        range(20, 60),
        lambda k: (rows.append(plant.state.q[robot.joint_q]), rates.append(plant.state.v)),
    )
    assert {row[1] for row in rows} == {position}
    assert {rate[7] for rate in rates} == {0.0}
    assert (np.ptp(np.delete(rows, 1, axis=1), axis=0) > 1e-4).all()


def test_a_jam_is_the_motion_of_a_robot_whose_joint_is_held_by_the_force_it_takes(
    robot: Robot,
) -> None:
    """The constraint force, found by another way: the one that makes the acceleration of the joint
    zero.
    """
    plant = plant_of(robot, "joint2:jam", max_step=1e-5)
    dynamics = dynamics_of(robot)
    q = plant.state.q
    v = np.r_[0.1, -0.05, 0.02, 0.05, 0.02, -0.1, 0.3, 0.0, -0.2, 0.1, 0.2, -0.1, 0.3]
    plant.state = dataclasses.replace(plant.state, v=v)
    command = Command(v=v, thrust=np.zeros(8), torque=np.linspace(-2.0, 2.0, 7))
    plant.step(command, 1e-4)
    tau = np.r_[np.zeros(6), command.torque]
    free = dynamics.forward_dynamics(q, v, tau)
    unit = np.eye(robot.n_v)[7]
    pull = dynamics.forward_dynamics(q, v, tau + unit) - free
    expected = free - free[7] / pull[7] * pull
    np.testing.assert_allclose(
        (plant.state.v - v) / 1e-4, expected, atol=2e-2 * np.abs(expected).max()
    )


def test_a_jam_that_stops_a_moving_joint_keeps_all_other_momenta_and_takes_energy(
    robot: Robot,
) -> None:
    plant = plant_of(robot, "joint2:jam", max_step=1e-9)
    dynamics = dynamics_of(robot)
    v = np.linspace(-0.3, 0.4, robot.n_v)
    plant.state = dataclasses.replace(plant.state, v=v)
    q = plant.state.q
    M = dynamics.mass_matrix(plant.state.q)
    plant.step(Command(v=v, thrust=np.zeros(8), torque=np.zeros(7)), 1e-9)
    assert plant.state.v[7] == 0.0
    is_free = np.arange(robot.n_v) != 7
    np.testing.assert_allclose((M @ plant.state.v)[is_free], (M @ v)[is_free], atol=1e-5)
    assert dynamics.kinetic_energy(q, plant.state.v) < dynamics.kinetic_energy(q, v)


@pytest.mark.slow
def test_the_energy_of_an_unforced_robot_with_a_jammed_joint_never_rises(robot: Robot) -> None:
    rises = []
    for step in (4e-3, 1e-3):
        plant = plant_of(robot, "joint2:jam", "joint4:jam@1", max_step=step)
        dynamics = dynamics_of(robot)
        plant.state = dataclasses.replace(
            plant.state, v=0.3 * np.random.default_rng(5).normal(size=robot.n_v)
        )
        energies = []
        for _ in range(300):
            plant.step(Command(v=np.zeros(robot.n_v), thrust=np.zeros(8), torque=np.zeros(7)), DT)
            q = plant.state.q
            v = plant.state.v
            energies.append(dynamics.kinetic_energy(q, v) + dynamics.potential_energy(q))
        rises.append(float((np.array(energies) - np.minimum.accumulate(energies)).max()))
    assert rises[1] <= max(0.5 * rises[0], 1e-6)
    assert rises[1] < 0.05


def test_a_jammed_joint_stands_still_on_the_kinematic_plant_too(robot: Robot) -> None:
    plant = KinematicPlant(robot, robot.configuration(), parse_faults(["joint2:jam@0.1-0.2"]))
    v = np.linspace(0.1, 0.2, robot.n_v)
    moved = []
    for _ in range(15):
        before = plant.state.q
        plant.step(Command(v=v), DT)
        moved.append(pin.difference(robot.model, before, plant.state.q))
        np.testing.assert_array_equal(plant.state.v[np.arange(robot.n_v) != 7], np.delete(v, 7))
    assert [bool(step[7]) for step in moved] == [True] * 5 + [False] * 5 + [True] * 5


def test_picking_up_a_payload_at_rest_keeps_the_momentum(robot: Robot) -> None:
    heavy = robot_dynamics(loaded(robot, parse_faults(["payload:mass=2"])))
    v = np.linspace(-0.3, 0.4, robot.n_v)
    plant = plant_of(robot, "payload:mass=2", max_step=1e-9)
    plant.state = dataclasses.replace(plant.state, v=v)
    q = plant.state.q
    before = dynamics_of(robot).mass_matrix(q) @ v
    plant.step(Command(v=v, thrust=np.zeros(8), torque=np.zeros(7)), 1e-9)
    np.testing.assert_allclose(heavy.mass_matrix(q) @ plant.state.v, before, atol=1e-5)
    assert heavy.kinetic_energy(q, plant.state.v) < dynamics_of(robot).kinetic_energy(q, v)


def test_momentum_in_the_world_is_that_of_robot_and_payload_together() -> None:
    """Without water: the centre of mass of both moves on as before."""
    girona = load_robot("girona_maris7_full")
    model = loaded(girona, parse_faults(["payload:mass=20"])).model
    v = np.linspace(-0.3, 0.4, girona.n_v)
    q = girona.configuration(joints=0.2 + girona.home)
    light, heavy = (pin.crba(m, m.createData(), q) for m in (girona.model, model))
    joined = joined_velocity(light, heavy, v)
    momenta = [
        pin.computeCentroidalMomentum(m, m.createData(), q, w).linear
        for m, w in ((girona.model, v), (model, joined))
    ]
    np.testing.assert_allclose(momenta[0], momenta[1], rtol=1e-9)


def test_a_payload_weighs_what_its_volume_does_not_bear(robot: Robot) -> None:
    still = np.zeros(robot.n_v)
    q = robot.configuration()
    lift = {}
    for text in ("payload:mass=2", "payload:mass=2,0.001"):
        bias = robot_dynamics(loaded(robot, parse_faults([text]))).bias_force(q, still)
        lift[text] = (bias - dynamics_of(robot).bias_force(q, still))[2]
    density = robot.description.water_density
    assert lift["payload:mass=2"] == pytest.approx(2 * 9.81, rel=1e-3)
    assert lift["payload:mass=2,0.001"] == pytest.approx((2 - 0.001 * density) * 9.81, rel=1e-3)


@pytest.mark.parametrize("k", [1, 2])
def test_a_payload_hangs_at_the_tool_of_its_number(k: int) -> None:
    robot = load_robot("bluerov2_two_alpha5")
    model = loaded(robot, parse_faults([f"payload{k}:mass=2"])).model
    q = robot.configuration()
    data = [robot.model.createData(), model.createData()]
    centres = [
        pin.centerOfMass(m, data_of_model, q)
        for m, data_of_model in zip((robot.model, model), data, strict=True)
    ]
    masses = [pin.computeTotalMass(m) for m in (robot.model, model)]
    added = (masses[1] * centres[1] - masses[0] * centres[0]) / (masses[1] - masses[0])
    np.testing.assert_allclose(
        added, Kinematics(robot, q).pose(robot.tools[k - 1]).translation, atol=1e-9
    )


def test_a_payload_that_is_let_go_takes_its_momentum_along(robot: Robot) -> None:
    short = 1e-6
    command = Command(v=np.zeros(robot.n_v), thrust=np.zeros(8), torque=np.zeros(7))
    plant = plant_of(robot, f"payload:mass=2@0-{short}")
    v = np.linspace(-0.3, 0.4, robot.n_v)
    plant.step(command, short)
    plant.state = dataclasses.replace(plant.state, v=v)
    plant.step(command, short)
    np.testing.assert_allclose(plant.state.v, v, atol=1e-4)


@pytest.mark.parametrize(
    ("text", "kinematic", "told"),
    [
        ("thruster9:dead", False, "the robot has 8 thrusters; give one of them, from 1"),
        ("joint9:jam", False, "the robot has 7 joints; give one of them, from 1"),
        ("payload2:mass=2", False, "the robot has 1 tools; give one of them, from 1"),
        ("thruster3:dead", True, "the kinematic plant has no thrusters; use the dynamic plant"),
        ("payload:mass=2", True, "the kinematic plant has no mass; use the dynamic plant"),
        ("current:step=1,0,0", True, "the kinematic plant feels no current; use the dynamic plant"),
    ],
)
def test_what_robot_or_plant_do_not_have_cannot_fail(
    text: str, kinematic: bool, told: str, robot: Robot
) -> None:
    with pytest.raises(InvalidInput) as error:
        require_possible(parse_faults([text]), robot, kinematic=kinematic)
    assert str(error.value) == f"{parse_faults([text])[0]}: {told}"


def test_an_arm_without_a_tool_frame_carries_nothing() -> None:
    with pytest.raises(InvalidInput, match="the robot has no frame 'tool' to carry it"):
        require_possible(
            parse_faults(["payload:mass=2"]),
            without_arm(load_robot("bluerov2_alpha5")),
            kinematic=False,
        )
