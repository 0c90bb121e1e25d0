"""Joints that mimic another one are one degree of freedom with it: all is that of free joints, held
to ``q_f = G q + o``.
"""

from __future__ import annotations

from functools import partial
from itertools import combinations
from pathlib import Path

import casadi as ca
import coal
import numpy as np
import pytest
from curves.capsules import capsule_robot
from curves.closed_forms import ClosedFormDistances
from kinematic_trees import function_of
from numpy.testing import assert_allclose

from uvms_ocp.errors import RobotDataError
from uvms_ocp.planning import coordinates
from uvms_ocp.planning.distances import CoalDistances
from uvms_ocp.planning.path_cost import link_speeds
from uvms_ocp.planning.request import PlanRequest, PostureGoal, plan_path
from uvms_ocp.planning.scene import collision_scene
from uvms_ocp.report.planned_motion import motion_record
from uvms_ocp.robot import Kinematics, Robot, load_robot
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.kinematics import point_reach
from uvms_ocp.robot.limits import joints_of
from uvms_ocp.robot.shapes.obstacles import obstacle
from uvms_ocp.robot.shapes.pair_distances import CoalPairs, CompiledPairs
from uvms_ocp.robot.shapes.shape_pairs import shapes_among
from uvms_ocp.robot.symbolic_model import SymbolicModel
from uvms_ocp.viz.scene.posed import joint_motion

BODY = (
    "<inertial><origin xyz='.3 .1 0'/><mass value='2'/><inertia ixx='1' ixy='.1' ixz='0' iyy='2'"
    " iyz='0' izz='2.5'/></inertial>"
)
SHAPE = "<collision><geometry><box size='.1 .2 .3'/></geometry></collision>"
LINKS = ("base_link", "l1", "l2", "l3", "l4")
WATER = f"links: {{{', '.join(f'{name}: {{box: {{size: [.1, .2, .3]}}}}' for name in LINKS)}}}\n"
SCALES = {"lead": (1.0, 0.0), "slider": (-2.0, 0.1), "third": (-1.0, 0.05)}
"""``multiplier`` and ``offset`` to the leader, of the third through the slider."""


def machine(folder: Path, lead: str, **options: object) -> Robot:
    """A chain lead, elbow, slider, and beside it a third joint; lead: its name, which tells where
    it is in Pinocchio's order.
    """

    def joint(name: str, kind: str, parent: str, child: str, axis: str, mimic: str = "") -> str:
        limit = (
            f"<limit lower='-1' upper='{0.5 if name == lead else 9}' velocity='0.7'"
            " effort='6'/><dynamics damping='2'/>"
        )
        ends = (
            f"<parent link='{parent}'/><child link='{child}'/><origin xyz='.5 .1 .2' rpy='.1 .2"
            f" .3'/><axis xyz='{axis}'/>"
        )
        return f"<joint name='{name}' type='{kind}'>{ends}{limit}{mimic}</joint>"

    text = "".join(f"<link name='{name}'>{BODY}{SHAPE}</link>" for name in LINKS)
    text += joint(lead, "revolute", "base_link", "l1", "0 1 0") + joint(
        "elbow", "revolute", "l1", "l2", "1 1 0"
    )
    text += joint(
        "slider",
        "prismatic",
        "l2",
        "l3",
        "0 1 1",
        f"<mimic joint='{lead}' multiplier='-2' offset='0.1'/>",
    )
    text += joint(
        "third", "revolute", "base_link", "l4", "0 0 1", "<mimic joint='slider' multiplier='0.5'/>"
    )
    (folder / "robot.urdf").write_text(f"<robot name='r'>{text}</robot>", encoding="utf-8")
    (folder / "water.yaml").write_text(WATER, encoding="utf-8")
    return load_robot(urdf=folder / "robot.urdf", hydrodynamics=folder / "water.yaml", **options)  # type: ignore[arg-type]


@pytest.fixture(params=["alpha", "zeta"])
def pair(
    request: pytest.FixtureRequest, tmp_path: Path
) -> tuple[Robot, Robot, np.ndarray, np.ndarray, np.ndarray]:
    """Coupled and free, a configuration of each, and the map G (n_v of the free one, n_v)."""
    coupled = machine(tmp_path, request.param)
    free = machine(tmp_path, request.param, mimic="free")
    scales = {request.param if name == "lead" else name: entry for name, entry in SCALES.items()}
    (leading,) = coupled.leading_joints
    scale, offset = scales[leading]
    values = {leading: scale * 0.3 + offset, "elbow": -0.4}
    free_values = {
        name: scale_of_joint * 0.3 + shift for name, (scale_of_joint, shift) in scales.items()
    } | {"elbow": -0.4}
    G = np.zeros((free.n_v, coupled.n_v))
    G[:6, :6] = np.eye(6)
    for row, name in enumerate(free.joint_names, start=6):
        G[row, coupled.joint(name if name == "elbow" else leading).idx_v] = (
            1.0 if name == "elbow" else scales[name][0] / scale
        )
    rng = np.random.default_rng(1)
    position = rng.normal(size=3)
    rpy = rng.normal(size=3)
    q = coupled.configuration(position, rpy, joints=values)
    q_free = free.configuration(position, rpy, joints=free_values)
    return coupled, free, q, q_free, G


Pair = tuple[Robot, Robot, np.ndarray, np.ndarray, np.ndarray]


@pytest.mark.sampled
def test_dynamics_in_water_are_those_of_free_joints_along_the_coupling(pair: Pair) -> None:
    coupled, free, q, q_free, G = pair
    rng = np.random.default_rng(2)
    v, a = rng.normal(size=(2, coupled.n_v))
    dynamics = robot_dynamics(coupled)
    free_dynamics = robot_dynamics(free)
    tau = dynamics.inverse_dynamics(q, v, a)
    tau_free = free_dynamics.inverse_dynamics(q_free, G @ v, G @ a)
    assert_allclose(tau, G.T @ tau_free, atol=1e-9)
    assert_allclose(
        dynamics.inverse_dynamics(q, v, dynamics.forward_dynamics(q, v, tau)), tau, atol=1e-9
    )
    assert_allclose(
        dynamics.mass_matrix(q), G.T @ free_dynamics.mass_matrix(q_free) @ G, atol=1e-10
    )
    assert_allclose(
        dynamics.damping_matrix(q, v),
        G.T @ free_dynamics.damping_matrix(q_free, G @ v) @ G,
        atol=1e-10,
    )


def test_kinematics_and_distances_are_those_of_free_joints_along_the_coupling(pair: Pair) -> None:
    coupled, free, q, q_free, G = pair
    for link in ("l3", "l4"):
        kinematics = Kinematics(coupled, q)
        free_kinematics = Kinematics(free, q_free)
        assert_allclose(
            kinematics.pose(link).homogeneous, free_kinematics.pose(link).homogeneous, atol=1e-12
        )
        assert_allclose(kinematics.jacobian(link), free_kinematics.jacobian(link) @ G, atol=1e-12)
        jacobian = function_of(partial(_jacobian, SymbolicModel(coupled.model), link), coupled.n_q)
        assert_allclose(jacobian(q), free_kinematics.jacobian(link) @ G, atol=1e-12)
        assert (
            np.linalg.norm(kinematics.jacobian(link)[:3], axis=0)
            <= point_reach(coupled, link) + 1e-12
        ).all()


def _jacobian(symbolic: SymbolicModel, link: str, q: ca.SX) -> ca.SX:
    return symbolic.forward_kinematics(q).jacobian(link)


@pytest.mark.parametrize("engine", [CompiledPairs, CoalPairs])
def test_distances_change_as_those_of_free_joints_along_the_coupling(
    engine: type[CoalPairs], pair: Pair
) -> None:
    coupled, free, q, q_free, G = pair
    ball = obstacle("ball", coal.Sphere(0.5), (3.0, 2.0, 1.0))
    results = []
    for robot, q_robot in ((coupled, q), (free, q_free)):
        geometry = shapes_among(robot, [ball])
        pairs = list(combinations(range(geometry.ngeoms), 2))
        measured = engine(robot.model, geometry, pairs)
        all_pairs = np.arange(len(pairs))
        results.append(
            (measured.values(q_robot, all_pairs), measured.gradients(q_robot, all_pairs))
        )
    (distances, gradients), (free_distances, free_gradients) = results
    apart = free_distances > 0.0
    assert_allclose(distances[apart], free_distances[apart], atol=1e-9)
    assert_allclose(gradients[apart], free_gradients[apart] @ G, atol=1e-5)
    assert apart.sum() > 6


def test_the_first_joint_has_the_limits_of_the_leader_and_the_friction_of_all(pair: Pair) -> None:
    coupled, free, _, _, G = pair
    (leading,) = coupled.leading_joints
    k = coupled.joint(leading).idx_v
    lead = next(name for name in free.joint_names if name in ("alpha", "zeta"))
    scale = 1.0 / G[free.joint(lead).idx_v, k]
    bounds = sorted(
        scale * bound + (0.0 if leading == lead else SCALES[leading][1]) for bound in (-1.0, 0.5)
    )
    limits = coupled.limits
    assert_allclose([limits.position_lower[k - 6], limits.position_upper[k - 6]], bounds)
    assert_allclose(
        [limits.velocity[k], limits.effort[k - 6]], [0.7 * abs(scale), 6.0 / abs(scale)]
    )
    assert_allclose(coupled.model.damping[k], 2.0 * (G[6:, k] ** 2).sum())


@pytest.mark.sampled
@pytest.mark.parametrize("lead", ["alpha", "zeta"])
def test_numbers_by_joint_name_are_those_of_free_joints_along_the_coupling(
    lead: str, tmp_path: Path
) -> None:
    scales = {lead: (1.0, 0.0), "slider": (-2.0, 0.1), "third": (-1.0, 0.05)}
    rotors = {lead: 0.5, "elbow": 0.2, "slider": 0.03, "third": 0.7}
    bare = machine(tmp_path, lead)
    lines = [f"{name}: {{rotor_inertia: {rotor}}}" for name, rotor in rotors.items()]
    lines[0] = f"{lead}: {{rotor_inertia: {rotors[lead]}, home: 0.4, acceleration: 3.0}}"
    lines[3] = f"third: {{rotor_inertia: {rotors['third']}, home: 0.1, acceleration: 2.0}}"
    (tmp_path / "water.yaml").write_text(
        WATER + f"joints: {{{', '.join(lines)}}}\n", encoding="utf-8"
    )
    files = {"urdf": tmp_path / "robot.urdf", "hydrodynamics": tmp_path / "water.yaml"}
    robot = load_robot(**files)
    (leading,) = robot.leading_joints
    scale, offset = scales[leading]
    k = robot.joint(leading).idx_v
    added = np.diag(robot_dynamics(robot).mass_matrix(robot.configuration())) - np.diag(
        robot_dynamics(bare).mass_matrix(robot.configuration())
    )
    own = sum((scales[name][0] / scale) ** 2 * rotors[name] for name in scales)
    assert_allclose(added[[k, robot.joint("elbow").idx_v]], [own, 0.2], atol=1e-12)
    assert_allclose(robot.home[k - 6], scale * 0.4 + offset)
    assert_allclose(robot.limits.acceleration[k], 2.0 * abs(scale))
    again = load_robot(urdf=files["urdf"], hydrodynamics=robot.description)
    np.testing.assert_array_equal(again.model.armature, robot.model.armature)
    np.testing.assert_array_equal(again.home, robot.home)
    held = load_robot(**files, lock={lead: 0.2})
    assert held.joint_names == ("elbow",)
    np.testing.assert_array_equal(held.model.armature[held.joint_v], [0.2])


def test_costs_of_curves_are_those_of_free_joints_along_the_coupling(pair: Pair) -> None:
    coupled, free, q, q_free, G = pair
    ball = obstacle("ball", coal.Sphere(0.5), (1.5, 0.5, 0.5))
    rows_by_pair = []
    for robot, q_robot, v in ((coupled, q, np.eye(coupled.n_v)), (free, q_free, G)):
        scene = collision_scene(coordinates(robot, reference=q_robot), [ball])
        close_pairs = CoalDistances(scene).near(
            scene.coordinates.x(q_robot)[None], np.full(scene.n_pairs, 20.0)
        )
        rates = np.tile(v @ np.linspace(0.2, -0.3, coupled.n_v), (close_pairs.pair.size, 1))
        speeds = link_speeds(scene, close_pairs, rates, 0.02)
        rows = (
            close_pairs.gradient @ v,
            speeds.speed[:, None],
            speeds.by_position @ v,
            speeds.by_rate @ v,
        )
        rows_by_pair.append(
            {
                scene.pairs[k].name: np.concatenate([row[i] for row in rows])
                for i, k in enumerate(close_pairs.pair)
            }
        )
    shared = rows_by_pair[0].keys() & rows_by_pair[1].keys()
    assert len(shared) > 6
    for name in shared:
        assert_allclose(rows_by_pair[0][name], rows_by_pair[1][name], atol=1e-5)
    fixed_together = rows_by_pair[1].keys() - shared
    assert all(np.abs(rows_by_pair[1][name][: coupled.n_v]).max() < 1e-9 for name in fixed_together)


def test_distances_in_closed_form_are_those_of_coal(pair: Pair) -> None:
    coupled, _, q, _, _ = pair
    ball = obstacle("ball", coal.Sphere(0.5), (1.5, 0.5, 0.5))
    scene = collision_scene(coordinates(capsule_robot(coupled), reference=q), [ball])
    x = scene.coordinates.x(q)[None]
    far = np.full(scene.n_pairs, 20.0)
    closed = ClosedFormDistances(scene).near(x, far)
    exact = CoalDistances(scene).near(x, far)
    assert closed.pair.size == scene.n_pairs > 6
    assert_allclose(closed.gradient, exact.gradient, atol=1e-6)
    assert_allclose(closed.screws, exact.screws, atol=1e-9)


def test_a_curve_moves_joints_that_are_one(tmp_path: Path) -> None:
    robot = machine(tmp_path, "alpha")
    ball = obstacle("ball", coal.Sphere(0.2), (1.0, -1.5, 0.3))
    goal = PostureGoal(joints={"alpha": 0.3, "elbow": -0.3})
    result = plan_path(
        PlanRequest(robot=robot, start=robot.configuration(), goal=goal, obstacles=(ball,))
    )
    assert result.collision_free
    assert result.plan is not None
    record = motion_record(result, result.plan)
    ends = [
        robot.joint_values(row)[robot.joint_names.index("alpha")] for row in record["q"][[0, -1]]
    ]
    assert_allclose(ends, [0.0, 0.3], atol=1e-9)
    assert (
        np.abs(record["v"][:, robot.joint("alpha").idx_v])
        <= robot.limits.velocity[robot.joint("alpha").idx_v] + 1e-6
    ).all()


def test_a_slider_of_the_page_moves_all_that_follow(tmp_path: Path) -> None:
    robot = machine(tmp_path, "alpha")
    q = robot.configuration(joints={"alpha": 0.2, "elbow": 0.0})
    told = {
        entry["name"]: entry
        for entry in (joint_motion(robot, k, q) for k in range(1, robot.model.njoints))
    }
    assert told["alpha"]["values"] == [0.2]
    for name in ("slider", "third"):
        leader, scale, offset = told[name]["follows"]
        assert list(told)[leader] == "alpha"
        assert (scale, offset) == pytest.approx(SCALES[name])


@pytest.mark.parametrize(
    ("change", "still"),
    [
        (("'third' type='revolute'", "'third' type='continuous'"), {"third"}),
        (("multiplier='-2'", "multiplier='0'"), {"slider", "third"}),
        (("mimic joint='alpha'", "mimic joint='nobody'"), {"slider", "third"}),
    ],
)
def test_what_cannot_move_as_one_stays_where_it_is_put(
    change: tuple[str, str], still: set[str], tmp_path: Path
) -> None:
    machine(tmp_path, "alpha")
    text = (tmp_path / "robot.urdf").read_text(encoding="utf-8")
    assert change[0] in text
    (tmp_path / "robot.urdf").write_text(text.replace(*change), encoding="utf-8")
    robot = load_robot(urdf=tmp_path / "robot.urdf")
    assert not still & {*robot.model.names}
    assert robot.joint_names == tuple(
        joint.name for joint in joints_of(robot.model, free_flyer=True)
    )


def test_what_is_said_of_joints_and_links_that_are_left_out_counts_for_nothing(
    tmp_path: Path,
) -> None:
    machine(tmp_path, "alpha")
    more = "tool: l3\naltimeter: l4\njoints: {elbow: {home: 0.1}, third: {home: 0.2}}\n"
    more += "trim: [{name: lead, link: l4, position: [0, 0, 0], mass: 1, volume: 0}]\n"
    (tmp_path / "water.yaml").write_text(WATER + more, encoding="utf-8")
    files = {"urdf": tmp_path / "robot.urdf", "hydrodynamics": tmp_path / "water.yaml"}
    assert {"tool", "altimeter"} <= {*load_robot(**files).frame_names}
    locked = load_robot(**files, lock={"elbow": 0.3})
    assert locked.joint_names == ("alpha",)
    dropped = load_robot(**files, drop=["l2", "l4"])
    assert (dropped.joint_names, dropped.description.trim, dropped.description.altimeter) == (
        ("alpha",),
        (),
        None,
    )
    assert set(dropped.description.links) == {"base_link", "l1"}
    with pytest.raises(
        RobotDataError,
        match="joints: 'elbo' is no joint of the URDF that moves; allowed: alpha, elbow",
    ):
        (tmp_path / "water.yaml").write_text("joints: {elbo: {home: 0.1}}\n", encoding="utf-8")
        load_robot(**files)
