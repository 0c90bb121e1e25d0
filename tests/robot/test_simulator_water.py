"""Water that a URDF states for simulators is the robot's water, in its conventions; what is not used
is named.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics
from uvms_ocp.robot.proposal import RobotProposal, propose
from uvms_ocp.robot.static_balance import static_residual

ADDED = np.diag([12.0, 18.0, 25.0, 0.6, 1.1, 0.9])
COUPLED = ADDED.copy()
COUPLED[0, 4] = COUPLED[4, 0] = 0.5
COUPLED[1, 3] = COUPLED[3, 1] = -0.3
LINEAR = "-14 -16 -20 -1.5 -2 -1.8"
QUADRATIC = "-55 -80 -120 -2 -3 -2.5"
TO_STARBOARD_DOWN = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])


def words(matrix: np.ndarray) -> str:
    return "\n".join(" ".join(map(str, row)) for row in matrix.tolist())


def uuv(
    added: str = words(ADDED),
    linear: str = LINEAR,
    volume: str = "<volume>0.0335</volume><center_of_buoyancy>0.02 0 0.08</center_of_buoyancy>",
    more: str = "",
    link: str = "hull",
    kind: str = "fossen",
) -> str:
    model = f"<type>{kind}</type><added_mass>{added}</added_mass>"
    model += f"<linear_damping>{linear}</linear_damping>" if linear else ""
    model += f"<quadratic_damping>{QUADRATIC}</quadratic_damping>{more}"
    return (
        "<gazebo><plugin name='uuv_plugin' filename='libuuv_underwater_object_ros_plugin.so'>"
        f"<fluid_density>1028</fluid_density><link name='{link}'>{volume}"
        f"<hydrodynamic_model>{model}</hydrodynamic_model></link></plugin></gazebo>"
    )


def gazebo(sign: float = -1.0, more: str = "") -> str:
    names = ("xDotU", "yDotV", "zDotW", "kDotP", "mDotQ", "nDotR")
    added = ""
    for name, mass in zip(names, np.diag(ADDED), strict=True):
        added += f"<{name}>{sign * mass}</{name}>"
    return (
        "<gazebo><plugin filename='gz-sim-hydrodynamics-system'"
        " name='gz::sim::systems::Hydrodynamics'><link_name>hull</link_name>"
        f"<water_density>1000</water_density>{added}<xU>-14</xU><xUabsU>-55</xUabsU><yVV>-80</yVV>"
        f"{more}</plugin></gazebo>"
    )


def proposed(folder: Path, blocks: str) -> RobotProposal:
    inertia = "<inertia ixx='0.6' iyy='1.1' izz='1.3' ixy='0' ixz='0' iyz='0'/>"
    (folder / "robot.urdf").write_text(
        "<robot name='r'><link name='hull'><inertial><mass value='30'/>"
        f"{inertia}</inertial><collision><geometry><box size='0.6 0.4 0.3'/></geometry></collision>"
        "</link><link name='skid'/><joint name='s' type='fixed'><parent link='hull'/>"
        f"<child link='skid'/><origin xyz='0 0 -0.2'/></joint>{blocks}</robot>",
        encoding="utf-8",
    )
    return propose(folder / "robot.urdf", base="free_flyer")


def hull_water(proposal: RobotProposal) -> LinkHydrodynamics:
    (water,) = [link for link in proposal.robot.hydrodynamics if link.frame == "hull"]
    return water


def test_all_that_uuv_simulator_states_is_taken(tmp_path: Path) -> None:
    proposal = proposed(tmp_path, uuv())
    water = hull_water(proposal)
    np.testing.assert_allclose(water.added_mass, ADDED)
    np.testing.assert_allclose(np.diag(water.linear_drag), [14, 16, 20, 1.5, 2, 1.8])
    np.testing.assert_allclose(np.diag(water.quadratic_drag), [55, 80, 120, 2, 3, 2.5])
    assert water.volume == 0.0335
    np.testing.assert_allclose(water.centre_of_buoyancy, [0.02, 0.0, 0.08])
    assert proposal.robot.description.water_density == 1028.0
    assert any(
        line.startswith("water of hull: added mass, linear drag") for line in proposal.reasons
    )
    assert "as the file states for a simulator" in proposal.text


def test_how_far_proposed_water_may_be_off_is_told_unless_it_is_stated(tmp_path: Path) -> None:
    interval = "added mass may be 0.3 to 2.5 times as large, quadratic drag 0.25 to 6 times"
    proposal = proposed(tmp_path, "")
    assert interval in proposal.text
    assert any(line.startswith("water of hull") and interval in line for line in proposal.reasons)
    assert not any("proposed by shapes" in line for line in proposed(tmp_path, uuv()).reasons)
    told = " ".join(proposed(tmp_path, gazebo().replace("xU>", "no>")).reasons)
    assert "water of hull: proposed by shapes: linear drag is assumed" in told


def test_coupled_terms_are_turned_from_starboard_and_down(tmp_path: Path) -> None:
    water = hull_water(proposed(tmp_path, uuv(words(COUPLED))))
    v = np.random.default_rng(3).normal(size=6)
    turned_v = TO_STARBOARD_DOWN * v
    assert v @ water.added_mass @ v == pytest.approx(turned_v @ COUPLED @ turned_v)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_numbers_of_gazebo_resist_whatever_their_sign(sign: float, tmp_path: Path) -> None:
    proposal = proposed(tmp_path, gazebo(sign))
    water = hull_water(proposal)
    np.testing.assert_allclose(water.added_mass, ADDED)
    np.testing.assert_allclose(np.diag(water.linear_drag), [14, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(np.diag(water.quadratic_drag), [55, 80, 0, 0, 0, 0])
    force, moment = static_residual(proposal.robot, proposal.robot.configuration())
    assert abs(force) < 0.05  # the plugin has no volume: it is proposed
    assert np.abs(moment).max() < 0.05


@pytest.mark.parametrize(
    ("blocks", "said"),
    [
        (uuv(link="keel"), "no such link"),
        (uuv(volume="<volume>0.03</volume><scaling_volume>2</scaling_volume>"), "<scaling_volume>"),
        (uuv(volume="<center_of_buoyancy>0 0 1</center_of_buoyancy>"), "without a volume"),
        (
            "<gazebo><plugin name='w' filename='libmake.so'><drag_coeff>3</drag_coeff></plugin></gazebo>",
            "plugin 'w', which speaks of water",
        ),
        (
            "<gazebo><plugin name='gz::sim::systems::LiftDrag' filename='x.so'/></gazebo>",
            "LiftDrag', which speaks of water",
        ),
        (uuv(kind="spheroid"), "type 'spheroid' are not read; allowed: fossen, sphere"),
        (uuv(kind="cylinder"), "type 'cylinder' without <radius>, <length>, <axis>"),
        (uuv(kind="sphere", more="<radius>-1</radius>"), "type 'sphere' without <radius>"),
        (
            uuv(kind="cylinder", more="<radius>1</radius><length>2</length><axis>i</axis>"),
            "added mass along the cylinder, which uuv_simulator has in kg/m",
        ),
        (
            uuv(more="<linear_damping_forward_speed>1</linear_damping_forward_speed>"),
            "not modelled",
        ),
        (uuv(linear="14 16 20 1 2 1"), "linear drag is not used"),
        (uuv(added="1 2 3"), "added mass is not used"),
        (gazebo(more="<xUabsV>3</xUabsV>"), "<xUabsV> is not modelled"),
        (
            "<gazebo><plugin name='t' filename='libuuv_thruster_ros_plugin.so'/></gazebo>",
            "no such joint",
        ),
    ],
)
def test_what_is_not_used_is_named(blocks: str, said: str, tmp_path: Path) -> None:
    reasons = proposed(tmp_path, blocks).reasons
    assert any(line.startswith("not read: ") and said in line for line in reasons)


def test_volumes_of_gazebos_buoyancy_are_taken_beside_other_water(tmp_path: Path) -> None:
    buoyancy = (
        "<gazebo><plugin name='b' filename='libBuoyancyPlugin.so'><fluid_density>998</fluid_density>"
        "<link name='hull'><center_of_volume>0.01 0 0.07</center_of_volume><volume>0.0304</volume>"
        "</link></plugin></gazebo>"
    )
    proposal = proposed(tmp_path, gazebo() + buoyancy)
    water = hull_water(proposal)
    np.testing.assert_allclose(water.added_mass, ADDED)
    assert water.volume == 0.0304
    np.testing.assert_allclose(water.centre_of_buoyancy, [0.01, 0.0, 0.07])
    assert proposal.robot.description.water_density == 998.0


def test_numbers_of_gazebo_are_read_in_plugins_of_other_names(tmp_path: Path) -> None:
    plugin = (
        "<gazebo><plugin name='dynamics' filename='libusv_gazebo_dynamics_plugin.so'>"
        "<bodyName>boat::hull</bodyName><waterDensity>997</waterDensity><xDotU>5</xDotU><xU>51</xU>"
        "<yV>40</yV><xUU>72</xUU></plugin></gazebo>"
    )
    proposal = proposed(tmp_path, plugin)
    water = hull_water(proposal)
    np.testing.assert_allclose(np.diag(water.added_mass), [5, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(np.diag(water.linear_drag), [51, 40, 0, 0, 0, 0])
    np.testing.assert_allclose(np.diag(water.quadratic_drag), [72, 0, 0, 0, 0, 0])
    assert proposal.robot.description.water_density == 997.0


def test_a_link_that_is_neutrally_buoyant_keeps_its_centre_of_buoyancy(tmp_path: Path) -> None:
    volume = (
        "<neutrally_buoyant>1</neutrally_buoyant><center_of_buoyancy>0 0 0.06</center_of_buoyancy>"
    )
    water = hull_water(proposed(tmp_path, uuv(volume=volume)))
    assert water.volume == pytest.approx(30.0 / 1028.0)
    np.testing.assert_allclose(water.centre_of_buoyancy, [0.0, 0.0, 0.06])


def test_a_volume_is_taken_beside_a_model_that_is_not_read(tmp_path: Path) -> None:
    proposal = proposed(tmp_path, uuv(kind="cylinder"))
    by_shape = hull_water(proposed(tmp_path, ""))
    proposal_water = hull_water(proposal)
    assert proposal_water.volume == 0.0335
    np.testing.assert_allclose(proposal_water.added_mass, by_shape.added_mass)


def test_each_number_that_is_proposed_has_an_interval_or_is_called_assumed(tmp_path: Path) -> None:
    told = " ".join(proposed(tmp_path, thruster_joints("thruster_a", "thruster_b")).reasons)
    assert "buoyancy 0.12 of the hull's height above the mass; may be 0.83 to 1.7 times" in told
    assert "linear drag is assumed: as large as quadratic drag at 0.15 m/s" in told
    assert "limits of thrust, time constants of thrusters" in told
    assert "speeds and accelerations of the vehicle" in told
    limits = "<thrustMin>-7</thrustMin><thrustMax>9</thrustMax>"
    blocks = thruster_joints("a") + UUV_THRUSTER.format("a", limits, BASIC) + uuv()
    told = " ".join(proposed(tmp_path, blocks).reasons)
    assert "buoyancy 0.12" not in told
    assert "limits of thrust" not in told


RHO = 1028.0
SPHERE_ADDED = 2 / 3 * np.pi * RHO * 0.3**3
CYLINDER_WATER = np.pi * RHO * 0.1**2 * 0.6


@pytest.mark.parametrize(
    ("kind", "sizes", "added", "drag"),
    [
        (
            "sphere",
            "<radius>0.3</radius>",
            [SPHERE_ADDED, SPHERE_ADDED, SPHERE_ADDED, 0.6, 1.1, 0.9],
            [0.25 * RHO * np.pi * 0.3**2] * 3,
        ),
        (
            "cylinder",
            "<radius>0.1</radius><length>0.6</length><axis>j</axis>",
            [
                CYLINDER_WATER,
                0.1 * CYLINDER_WATER,
                CYLINDER_WATER,
                CYLINDER_WATER * 0.03,
                1.1,
                CYLINDER_WATER * 0.03,
            ],
            [
                0.5 * RHO * 0.74 * 0.06,
                0.5 * RHO * 0.87 * np.pi * 0.1**2,
                0.5 * RHO * 0.74 * 0.06,
            ],
        ),
        (
            "box",
            "<cd>1.2</cd><length>0.6</length><width>0.4</width><height>0.3</height>",
            [12, 18, 25, 0.6, 1.1, 0.9],
            [0.5 * RHO * 1.2 * 0.12, 0.5 * RHO * 1.2 * 0.18, 0.5 * RHO * 1.2 * 0.24],
        ),
    ],
)
def test_shapes_of_uuv_simulator_have_its_water(
    kind: str, sizes: str, added: list[float], drag: list[float], tmp_path: Path
) -> None:
    proposal = proposed(tmp_path, uuv(kind=kind, more=sizes))
    water = hull_water(proposal)
    np.testing.assert_allclose(np.diag(water.added_mass), added)
    np.testing.assert_allclose(np.diag(water.quadratic_drag), [*drag, 2, 3, 2.5])
    np.testing.assert_allclose(np.diag(water.linear_drag), [14, 16, 20, 1.5, 2, 1.8])
    assert water.volume == 0.0335


def test_the_water_of_a_world_is_the_models(tmp_path: Path) -> None:
    (tmp_path / "m.sdf").write_text(
        "<sdf version='1.10'><world name='w'><plugin filename='gz-sim-buoyancy-system'"
        " name='gz::sim::systems::Buoyancy'><uniform_fluid_density>1003</uniform_fluid_density>"
        "</plugin><model name='m'><link name='hull'><inertial><mass>30</mass></inertial></link>"
        "</model></world></sdf>",
        encoding="utf-8",
    )
    proposal = propose(tmp_path / "m.sdf", base="free_flyer")
    assert proposal.robot.description.water_density == 1003.0
    assert not any("not read" in line for line in proposal.reasons)


def test_what_is_not_stated_is_proposed(tmp_path: Path) -> None:
    by_shape = proposed(tmp_path, "").robot.hydrodynamics[0]
    proposal = proposed(tmp_path, uuv(linear=""))
    water = hull_water(proposal)
    np.testing.assert_allclose(water.linear_drag, by_shape.linear_drag)
    assert "; the rest: box around its shapes" in proposal.text


def test_water_of_a_link_without_mass_is_the_hulls(tmp_path: Path) -> None:
    robot = proposed(tmp_path, uuv(link="skid")).robot
    water = {link.frame: link for link in robot.hydrodynamics}
    np.testing.assert_allclose(water["skid"].added_mass, ADDED)
    assert not np.any(water["hull"].added_mass)
    assert water["hull"].volume == 0.0


def sdf_added(entries: dict[str, float]) -> str:
    numbers = "".join(f"<{key}>{value}</{key}>" for key, value in entries.items())
    return f"<fluid_added_mass>{numbers}</fluid_added_mass>"


def test_added_mass_of_sdf_is_taken_in_the_axes_of_the_link(tmp_path: Path) -> None:
    entries = {"xx": 12.0, "yy": 18.0, "zz": 25.0, "pp": 0.6, "qq": 1.1, "rr": 0.9, "xq": 0.5}
    expected = ADDED.copy()
    expected[0, 4] = expected[4, 0] = 0.5
    block = f"<gazebo reference='hull'>{sdf_added(entries)}</gazebo>"
    water = hull_water(proposed(tmp_path, block))
    np.testing.assert_allclose(water.added_mass, expected)
    text = (
        "<sdf version='1.10'><model name='m'><link name='hull'><inertial><mass>30</mass><inertia>"
        f"<ixx>0.6</ixx><iyy>1.1</iyy><izz>1.3</izz></inertia>{sdf_added(entries)}</inertial>"
        f"</link>{gazebo().removeprefix('<gazebo>').removesuffix('</gazebo>')}</model></sdf>"
    )
    (tmp_path / "m.sdf").write_text(text, encoding="utf-8")
    proposal = propose(tmp_path / "m.sdf", base="free_flyer")
    (water,) = proposal.robot.hydrodynamics
    np.testing.assert_allclose(water.added_mass, expected + ADDED)  # both push in Gazebo
    np.testing.assert_allclose(np.diag(water.linear_drag), [14, 0, 0, 0, 0, 0])
    assert any("of its Gazebo plugin and SDF" in line for line in proposal.reasons)


def thruster_joints(*names: str) -> str:
    text = ""
    for k, name in enumerate(names):
        text += (
            f"<link name='{name}_link'/><joint name='{name}' type='continuous'><parent link='hull'/>"
            f"<child link='{name}_link'/><origin xyz='0 0.{k} 0' rpy='0 0 0.5'/><axis xyz='0 0 1'/>"
            "</joint>"
        )
    return text


UUV_THRUSTER = (
    "<gazebo><plugin name='a' filename='libuuv_thruster_ros_plugin.so'><linkName>{0}_link</linkName>"
    "<jointName>{0}</jointName><thrusterID>0</thrusterID>{1}<dynamics><type>FirstOrder</type>"
    "<timeConstant>0.05</timeConstant></dynamics><conversion>{2}</conversion></plugin></gazebo>"
)
BASIC = "<type>Basic</type><rotorConstant>0.002</rotorConstant>"
BESSA = (
    "<type>Bessa</type><rotorConstantL>0.001</rotorConstantL><rotorConstantR>0.002</rotorConstantR>"
    "<deltaL>-100</deltaL><deltaR>50</deltaR>"
)
TABLE = (
    "<type>LinearInterp</type><inputValues>-2 0 2</inputValues><outputValues>-8 0 12</outputValues>"
)
CLAMPS = "<clampMin>-100</clampMin><clampMax>100</clampMax>"


@pytest.mark.parametrize(
    ("words", "conversion", "limits"),
    [
        (CLAMPS, BASIC, (-20.0, 20.0)),
        (CLAMPS + "<thrustMin>-15</thrustMin><thrustMax>40</thrustMax>", BASIC, (-15.0, 20.0)),
        ("<thrustMin>-7</thrustMin><thrustMax>9</thrustMax>", BASIC, (-7.0, 9.0)),
        (CLAMPS + "<thrust_efficiency>0.5</thrust_efficiency>", BASIC, (-10.0, 10.0)),
        (CLAMPS + "<gain>-0.5</gain>", BASIC, (-5.0, 5.0)),
        (CLAMPS, BESSA, (-9.9, 19.9)),
        ("<clampMin>-1</clampMin><clampMax>5</clampMax>", TABLE, (-4.0, 12.0)),
    ],
)
def test_thrusters_of_uuv_simulator_have_its_limits(
    words: str, conversion: str, limits: tuple[float, float], tmp_path: Path
) -> None:
    blocks = thruster_joints("port", "stirrer") + UUV_THRUSTER.format("port", words, conversion)
    proposal = proposed(tmp_path, blocks)
    (thruster,) = proposal.robot.description.thrusters  # the plugin names one of two alike
    assert thruster.name == "port"
    assert (thruster.minimum, thruster.maximum) == pytest.approx(limits)
    assert thruster.time_constant == 0.05
    np.testing.assert_allclose(thruster.direction, [0.0, 0.0, 1.0], atol=1e-9)


def test_thrusters_of_gazebo_push_along_their_joint(tmp_path: Path) -> None:
    plugin = (
        "<gazebo><plugin filename='gz-sim-thruster-system' name='gz::sim::systems::Thruster'>"
        "<joint_name>{}</joint_name><thrust_coefficient>-0.02</thrust_coefficient>{}</plugin></gazebo>"
    )
    limits = "<max_thrust_cmd>30</max_thrust_cmd><min_thrust_cmd>-25</min_thrust_cmd>"
    blocks = thruster_joints("a", "b") + plugin.format("a", limits) + plugin.format("b", "")
    blocks += plugin.format("lost", "")
    proposal = proposed(tmp_path, blocks)
    first, second = proposal.robot.description.thrusters
    assert (first.minimum, first.maximum) == (-25.0, 30.0)
    assert -second.minimum == second.maximum > 0.0  # of its mass, as none is stated
    assert any("'lost': no such joint or link" in line for line in proposal.reasons)


def test_forces_at_sites_of_mujoco_are_thrusters(tmp_path: Path) -> None:
    (tmp_path / "m.xml").write_text(
        "<mujoco model='m'><worldbody><body name='hull'><freejoint/><geom type='box' size='.3 .2 .15'/>"
        "<site name='t1' pos='0.1 0.2 0' euler='0 0 90'/></body></worldbody><actuator>"
        "<general site='t1' gear='2 0 0 0 0 0' ctrlrange='-10 15'/></actuator></mujoco>",
        encoding="utf-8",
    )
    (thruster,) = propose(tmp_path / "m.xml").robot.description.thrusters
    np.testing.assert_allclose(thruster.position, [0.1, 0.2, 0.0])
    np.testing.assert_allclose(thruster.direction, [0.0, 1.0, 0.0], atol=1e-9)
    assert (thruster.minimum, thruster.maximum) == (-20.0, 30.0)
