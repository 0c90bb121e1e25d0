"""A scene is one page without network and server, whose animation is the run."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
import umsgpack
from synthetic_record import QUANTITIES, SURROUNDINGS, synthetic_record, without

from uvms_ocp import scenarios
from uvms_ocp.errors import InvalidInput, OutputError
from uvms_ocp.record.meta_values import (
    FaultMeta,
    FloorRelief,
    FrameMeta,
    MarkerMeta,
    ObstacleMeta,
    SurroundingsMeta,
)
from uvms_ocp.record.record import Record
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.collision_model import CollisionModel
from uvms_ocp.robot.shapes.obstacles import build_obstacle
from uvms_ocp.robot.thrusters import thruster_matrix
from uvms_ocp.viz.scene.page import CommandLog, ScenePage
from uvms_ocp.viz.scene.page_server import served
from uvms_ocp.viz.scene.shapes import draw_shape, tube
from uvms_ocp.viz.scene.show import show, write_scene
from uvms_ocp.viz.series import floor_heights
from uvms_ocp.viz.time_spans import phase_spans

_FPS = 25
_KINDS = ("set_object", "set_transform")


def _commands(page: str) -> list[Any]:
    return [umsgpack.unpackb(base64.b64decode(blob)) for blob in _data(page, "commands")]


def _drawn_paths(page: str) -> set[str]:
    return {command["path"] for command in _commands(page) if command["type"] == "set_object"}


def _data(page: str, name: str) -> Any:
    """Return a block of data as a browser finds it."""
    match = re.search(
        rf'<script type="application/json" id="{name}">(.*?)</script', page, re.DOTALL
    )
    assert match is not None
    return json.loads(match[1])


def _tracks(page: str) -> dict[tuple[str, str], Any]:
    (command,) = [command for command in _commands(page) if command["type"] == "set_animation"]
    return {
        (animation["path"], track["name"]): track["keys"]
        for animation in command["animations"]
        for track in animation["clip"]["tracks"]
    }


def _details(page: str) -> dict[str, Any]:
    details: dict[str, Any] = _data(page, "details")
    return details


def _positions(page: str, end: str) -> Any:
    (keys,) = [
        keys
        for (path, name), keys in _tracks(page).items()
        if name == ".position" and path.endswith(end)
    ]
    return keys


class _References(HTMLParser):
    """Collects what a browser would load."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [
            value or ""
            for name, value in attrs
            if name in ("src", "href", "srcset", "data", "poster")
        ]


@pytest.fixture(scope="module")
def page(record: Record, robot: Robot) -> str:
    return show(record, robot, fps=_FPS).html


def test_the_page_loads_nothing_from_elsewhere(page: str) -> None:
    parser = _References()
    parser.feed(page)
    assert all(reference.startswith("data:") for reference in parser.found)
    assert not re.search(r"@import|url\(\s*['\"]?(https?:)?//", page)
    assert "viewer.connect(" not in page


def test_the_page_is_small(page: str) -> None:
    assert len(page) < 3_000_000


def test_the_animation_covers_the_run(page: str, record: Record) -> None:
    tracks = _tracks(page)
    assert tracks
    for keys in tracks.values():
        assert keys[0]["time"] == 0
        assert keys[-1]["time"] / _FPS == pytest.approx(record["t"][-1] - record["t"][0])


def test_the_vehicle_is_animated_through_the_recorded_poses(page: str, record: Record) -> None:
    (positions,) = [
        keys
        for (path, name), keys in _tracks(page).items()
        if name == ".position" and "root_joint" in path
    ]
    np.testing.assert_allclose(positions[-1]["value"], record["q"][-1, :3], atol=1e-5)
    np.testing.assert_allclose(positions[0]["value"], record["q"][0, :3], atol=1e-5)


@pytest.mark.slow
def test_ten_minutes_keep_the_page_below_three_megabytes(robot: Robot) -> None:
    deep = SURROUNDINGS.model_copy(update={"floor_z": -600.0})
    long = synthetic_record(robot, duration=600.0, dt=0.05, surroundings=deep)
    assert len(show(long, robot).html) < 5_000_000  # whose vehicle and joints never rest
    q_on_station = long["q"][np.minimum(np.arange(len(long)), 2400)]  # on station after two minutes
    q_on_station[:, :3] += np.random.default_rng(5).normal(0.0, 1e-4, q_on_station[:, :3].shape)
    html = show(Record(series={**long.series, "q": q_on_station}, meta=long.meta), robot).html
    assert len(html) < 3_000_000
    assert _positions(html, "root_joint")[-1]["time"] / _FPS == pytest.approx(600.0)


def test_between_keys_the_vehicle_is_where_the_record_has_it(record: Record, robot: Robot) -> None:
    keys = _positions(show(record, robot, fps=_FPS).html, "root_joint")
    times, places = (np.array([key[name] for key in keys]) for name in ("time", "value"))
    shown = np.column_stack([np.interp(record["t"], times / _FPS, column) for column in places.T])
    np.testing.assert_allclose(shown, record["q"][:, :3], atol=2e-3)


def test_every_visual_shape_is_drawn(page: str, robot: Robot) -> None:
    drawn = {path.rsplit("/", 2)[0] for path in _drawn_paths(page) if "/robot/" in path}
    assert len(drawn) == len(robot.visual_model.geometryObjects)


def test_links_whose_meshes_are_missing_are_drawn_by_their_collision_shapes(robot: Robot) -> None:
    solid = robot.collision_model.geometryObjects
    visual_model = robot.visual_model
    partly = pin.GeometryModel()
    bare = {robot.model.frames[shape.parentFrame].name for shape in list(solid)[1::2]}
    for shape in visual_model.geometryObjects:
        if robot.model.frames[shape.parentFrame].name not in bare:
            partly.addGeometryObject(shape)
    page = show(replace(robot, visual_model=partly)).html
    drawn = {path.rsplit("/", 3)[1][4:] for path in _drawn_paths(page) if "/robot/" in path}
    hidden = {shape.name for shape in solid if robot.model.frames[shape.parentFrame].name in bare}
    assert hidden
    assert drawn == {shape.name for shape in partly.geometryObjects} | hidden


def test_markers_and_trails_are_drawn(page: str) -> None:
    objects = _drawn_paths(page)
    for name in (
        "trails/vehicle",
        "trails/tool",
        "goals/marker 0/ball",
        "goals/marker 1/ball",
        "beam/ray",
    ):
        assert f"/meshcat/scene/{name}" in objects


def test_each_tool_leaves_a_path_of_its_own(record: Record, robot: Robot) -> None:
    two_tools = replace(
        robot, description=robot.description.model_copy(update={"tool": ("tool", "flange")})
    )
    details = _details(show(record, two_tools).html)
    rows = {
        row["label"]: row["colour"]
        for row in details["legend"]
        if row["label"].startswith("path of")
    }
    assert set(rows) == {f"path of the {name}" for name in ("vehicle", "tool", "flange")}
    assert len(set(rows.values())) == len(rows)
    assert {trail["name"] for trail in details["trails"]} == {"vehicle", "tool", "flange"}


def test_frames_of_the_record_become_triads(record: Record, robot: Robot) -> None:
    goal = FrameMeta(name="tool goal", pose=(2.5, 1.0, -39.9, 1.0, 0.0, 0.0, 0.0))
    page = show(_with_surroundings(record, frames=(goal,)), robot).html
    assert "/meshcat/scene/goals/frame 0/x" in {command["path"] for command in _commands(page)}


def _with_surroundings(record: Record, **values: Any) -> Record:
    around = record.meta.surroundings.model_copy(update=values)
    return replace(record, meta=record.meta.model_copy(update={"surroundings": around}))


def test_obstacles_of_the_record_are_drawn_where_they_are(record: Record, robot: Robot) -> None:
    ball = ObstacleMeta(name="ball", shape="sphere", size=(0.5,), position=(1.0, 2.0, -38.0))
    pages = [
        _commands(show(item, robot).html)
        for item in (record, _with_surroundings(record, obstacles=(ball,)))
    ]
    drawn, placed = (
        [c for c in pages[1] if c["type"] == kind and "/obstacles/" in c["path"]] for kind in _KINDS
    )
    assert not any("/obstacles/" in command.get("path", "") for command in pages[0])
    assert drawn[0]["object"]["geometries"][0]["radius"] == 0.5
    moved = next(c for c in placed if c["path"].endswith("/obstacles/000"))
    np.testing.assert_allclose(np.array(moved["matrix"])[12:15], ball.position, atol=1e-6)


def test_a_floor_with_protuberances_is_part_of_the_page(record: Record, robot: Robot) -> None:
    z = ((-40.0, -39.0, -40.0), (-40.0, -38.5, -40.0))
    floor = FloorRelief(x=(-5.0, 0.0, 5.0), y=(-5.0, 5.0), z=z)
    details = _details(show(_with_surroundings(record, floor=floor), robot).html)
    heights = np.array(details["relief"]["z"])
    assert heights.shape == (2, 3)
    np.testing.assert_allclose(heights - heights.min(), np.array(z) + 40.0, atol=2e-3)
    assert details["floor"] == pytest.approx(heights.min(), abs=2e-3)
    assert _details(show(record, robot).html)["relief"] is None


def test_markers_stand_on_the_floor_below_them(record: Record) -> None:
    floor = FloorRelief(x=(0.0, 2.0), y=(0.0, 2.0), z=((-40.0, -40.0), (-39.0, -39.0)))
    heights = floor_heights(
        _with_surroundings(record, floor=floor), np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 9.0]])
    )
    np.testing.assert_allclose(heights, [-40.0, -39.5, -39.0])
    np.testing.assert_allclose(floor_heights(record, np.zeros((2, 2))), -40.0)


def test_no_server_and_no_browser_are_started(
    record: Record, robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*args: Any, **kwargs: Any) -> None:
        raise RuntimeError("a process was started")

    monkeypatch.setattr("subprocess.Popen.__init__", refuse)
    monkeypatch.setattr("webbrowser.open", refuse)
    assert write_scene(record, robot, tmp_path / "scene.html").stat().st_size > 500_000


def test_text_of_a_user_cannot_break_out_of_the_page(robot: Robot) -> None:
    evil = "</script><img src=http://example.org>"
    marker = MarkerMeta(name=evil.replace("/", ""), position=(0, 0, -39))
    record = synthetic_record(
        robot, scenario=evil, surroundings=SurroundingsMeta(markers=(marker,))
    )
    parser = _References()
    parser.feed(show(record, robot).html)
    assert all(reference.startswith("data:") for reference in parser.found)


def test_quantities_of_own_tasks_are_read_out_too(robot: Robot) -> None:
    names = ("OWN.swing", *QUANTITIES[1:])
    rows = _details(show(synthetic_record(robot, quantities=names), robot).html)["readouts"]
    assert [(row["task"], row["label"], row["unit"]) for row in rows][:2] == [
        ("OWN", "OWN swing", ""),
        ("LA", "LA altitude", "m"),
    ]


def test_health_and_alarms_stand_on_the_time_line(page: str, record: Record) -> None:
    details = _details(page)
    assert [spell["state"] for spell in details["health"]] == ["suspect", "lost", "suspect"]
    assert {spell["channel"] for spell in details["health"]} == {"altimeter_range"}
    assert details["health"][0]["end"] == details["health"][1]["start"]
    assert [alarm["t"] for alarm in details["alarms"]] == [1.2, 1.5, 2.4]


def test_arrows_are_in_the_frame_of_the_vehicle(record: Record, robot: Robot) -> None:
    current = np.tile([0.3, -0.1, 0.0], (len(record), 1))
    groups = _details(
        show(replace(record, series={**record.series, "current": current}), robot).html
    )["arrows"]
    by_label = {group["label"]: group for group in groups}
    assert list(by_label) == ["thrust", "current", "disturbance, force", "disturbance, moment"]
    assert len(by_label["thrust"]["arrows"]) == len(robot.description.thrusters)
    R_WB = pin.XYZQUATToSE3(record["q"][-1, :7]).rotation
    np.testing.assert_allclose(
        R_WB @ by_label["current"]["arrows"][0]["vectors"][-1], current[-1], atol=2e-3
    )
    wrench = np.zeros(6)
    for arrow in by_label["thrust"]["arrows"]:
        force = np.array(arrow["vectors"][-1])
        wrench += np.concatenate([force, np.cross(arrow["at"], force)])
    np.testing.assert_allclose(
        wrench,
        thruster_matrix(robot) @ record["thrust"][-1][: len(robot.description.thrusters)],
        atol=1.0,
    )


def test_a_line_leads_to_the_nearest_point_of_an_obstacle_and_is_left_out_afar(
    record: Record, robot: Robot
) -> None:
    near_lines, far = (
        ObstacleMeta(name=name, shape="sphere", size=(0.4,), position=(2.0, y, -37.0))
        for name, y in (("near", 1.5), ("far", 30.0))
    )
    details = _details(show(_with_surroundings(record, obstacles=(near_lines, far)), robot).html)
    witness = details["witness"]
    centre = np.array(near_lines.position) - _position_of(details, "near")
    distance = CollisionModel(robot, [build_obstacle(near_lines)], self_collision=False)
    told_of, lines = (witness["obstacles"][0][key][::20] for key in ("distance", "line"))
    for t, told, line in zip(witness["t"][::20], told_of, lines, strict=True):
        smallest_distance = distance.values(record["q"][np.argmin(np.abs(record["t"] - t))]).min()
        assert told == pytest.approx(smallest_distance, rel=5e-3, abs=1e-5)
        if told < witness["near"]:
            ends = np.array(line).reshape(2, 3)
            assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(
                abs(smallest_distance), abs=1e-3
            )
            assert np.linalg.norm(ends[1] + centre - near_lines.position) == pytest.approx(
                0.4, abs=1e-3
            )
    assert min(witness["obstacles"][0]["distance"]) < witness["near"]
    assert not np.any(witness["obstacles"][1]["line"])


def _position_of(details: dict[str, Any], name: str) -> Any:
    (label,) = [label for label in details["labels"] if label["text"] == name]
    return label["position"]


def test_a_name_stands_once_at_each_place(record: Record, robot: Robot) -> None:
    marker = record.meta.surroundings.markers[0]
    goal = FrameMeta(name="goal of T", pose=(*marker.position, 1.0, 0.0, 0.0, 0.0))
    labels = _details(show(_with_surroundings(record, frames=(goal,)), robot).html)["labels"]
    assert [label["text"] for label in labels] == ["target", "way point"]


def test_ghosts_move_beside_the_run_and_the_page_lasts_as_long_as_the_longest(
    record: Record, robot: Robot
) -> None:
    longer = synthetic_record(robot, duration=9.0)
    html = show(record, robot, ghosts={"slower": longer}).html
    keys = next(
        keys
        for (path, name), keys in _tracks(html).items()
        if "/ghost 0/" in path and name == ".position"
    )
    assert keys[-1]["time"] / _FPS == pytest.approx(9.0)
    details = _details(html)
    assert details["duration"] == pytest.approx(9.0)
    assert "slower" in [row["label"] for row in details["legend"]]


def test_a_ghost_of_another_robot_and_more_than_can_be_told_apart_are_refused(
    record: Record, robot: Robot
) -> None:
    with pytest.raises(InvalidInput, match="its own robot"):
        show(record, robot, ghosts={"arm": synthetic_record(load_robot("planar5"))})
    with pytest.raises(InvalidInput, match="4 at most"):
        show(record, robot, ghosts={f"run {k}": record for k in range(5)})


def test_a_robot_of_the_library_need_not_be_given(record: Record, robot: Robot) -> None:
    assert len(show(record).html) == len(show(record, robot).html)
    stranger = replace(record, meta=record.meta.model_copy(update={"robot": "my_own"}))
    with pytest.raises(InvalidInput, match="my_own, which does not hold its robot; give it"):
        show(stranger)


def test_a_robot_alone_is_shown_at_its_configuration(robot: Robot) -> None:
    q = robot.configuration(position=(1.0, -2.0, -5.0), rpy=(0.1, -0.2, 0.3))
    joints = _details(show(robot, q).html)["joints"]
    np.testing.assert_allclose(joints[0]["values"], [1.0, -2.0, -5.0, 0.1, -0.2, 0.3], atol=1e-9)
    np.testing.assert_allclose([joint["values"][0] for joint in joints[1:]], robot.home)
    with pytest.raises(InvalidInput, match=r"show\(robot, q\)"):
        show(robot, robot)


def test_the_page_is_served_to_this_machine_alone() -> None:
    with served(ScenePage(html="<p>a page</p>")) as address:
        host, port = address.removeprefix("http://").rstrip("/").split(":")
        assert host == "127.0.0.1"
        assert [
            _asked(port, *request)
            for request in (("/", host), ("/other", host), ("/", "elsewhere.example"))
        ] == [
            (200, b"<p>a page</p>"),
            (404, b""),
            (403, b""),
        ]
        with (
            pytest.raises(OutputError, match="give another"),
            served(ScenePage(html=""), int(port)),
        ):
            pass


def _asked(port: str, path: str, host: str) -> tuple[int, bytes]:
    connection = HTTPConnection("127.0.0.1", int(port), timeout=10)
    connection.request("GET", path, headers={"Host": f"{host}:{port}"})
    answer = connection.getresponse()
    reply = answer.status, answer.read()
    connection.close()
    return reply


def test_what_is_not_known_is_no_number_in_the_readouts(record: Record, robot: Robot) -> None:
    html = show(without(record, "LA.altitude", rows=slice(0, 40)), robot).html
    details = _details(html)
    readouts = {item["label"]: item["values"] for item in details["readouts"]}
    altitude = readouts["LA altitude"]
    times = np.array(details["times"])
    assert [value is None for value in altitude] == (times < record["t"][40] - 1e-9).tolist()
    assert None not in readouts["T position error"]
    assert 'value === null ? "-"' in html


def test_a_notebook_gets_the_page_in_a_frame(record: Record, robot: Robot) -> None:
    frame = show(record, robot, height=333)._repr_html_()
    assert frame.startswith("<iframe ")
    assert 'sandbox="allow-scripts"' in frame
    assert "height:333px" in frame


def test_a_fixed_base_robot_has_a_scene_too() -> None:
    planar = load_robot("planar5")
    assert _tracks(show(synthetic_record(planar), planar).html)


def test_a_robot_that_does_not_fit_the_record_is_refused(record: Record) -> None:
    with pytest.raises(InvalidInput, match="planar5"):
        show(record, load_robot("planar5"))


@pytest.mark.parametrize("fps", [0, -1, float("nan")])
def test_an_impossible_frame_rate_is_refused(record: Record, robot: Robot, fps: float) -> None:
    with pytest.raises(InvalidInput, match="fps"):
        show(record, robot, fps=fps)


def test_a_place_that_cannot_be_written_is_an_output_error(
    record: Record, robot: Robot, tmp_path: Path
) -> None:
    with pytest.raises(OutputError):
        write_scene(record, robot, tmp_path)


def _triangle_mesh() -> coal.BVHModelOBBRSS:
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(1, 3)
    mesh.addTriangle(np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]))
    mesh.endModel()
    return mesh


def _tetrahedron() -> coal.ConvexBase:
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(4, 4)
    corners = np.vstack([np.zeros(3), np.eye(3)])
    for i, j, k in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)):
        mesh.addTriangle(corners[i], corners[j], corners[k])
    mesh.endModel()
    mesh.buildConvexHull(False, "Qt")
    return mesh.convex


@pytest.mark.parametrize(
    ("shape", "parts"),
    [
        (coal.Box(1, 2, 3), 1),
        (coal.Sphere(1), 1),
        (coal.Ellipsoid(1, 2, 3), 1),
        (coal.Cylinder(1, 2), 1),
        (coal.Cone(1, 2), 1),
        (coal.Capsule(1, 2), 3),
        (_triangle_mesh(), 1),
        (_tetrahedron(), 1),
    ],
)
def test_every_shape_of_a_urdf_can_be_drawn(shape: coal.CollisionGeometry, parts: int) -> None:
    log = CommandLog()
    assert draw_shape(log.visualizer(), shape, np.ones(4))
    assert sum(umsgpack.unpackb(blob)["type"] == "set_object" for blob in log.blobs) == parts


def test_a_shape_without_end_is_not_drawn() -> None:
    assert not draw_shape(
        CommandLog().visualizer(), coal.Halfspace(np.array([0, 0, 1.0]), 0.0), np.ones(4)
    )


def test_a_tube_keeps_its_radius_around_a_bent_path() -> None:
    path = np.column_stack([np.linspace(0, 1, 30), np.sin(np.linspace(0, 1, 30)), np.zeros(30)])
    rings = tube(path, 0.1).vertices.reshape(30, 6, 3)
    np.testing.assert_allclose(np.linalg.norm(rings - path[:, None], axis=-1), 0.1, atol=1e-6)


def test_poses_in_the_page_agree_with_pinocchio(page: str, record: Record, robot: Robot) -> None:
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, record["q"][-1])
    last = f"{robot.model.njoints - 1:02d} {robot.model.names[robot.model.njoints - 1]}"
    keys = _positions(page, last)
    np.testing.assert_allclose(
        keys[-1]["value"], data.oMi[robot.model.njoints - 1].translation, atol=1e-5
    )


def test_the_page_tells_what_went_wrong_and_when(tmp_path: Path) -> None:
    robot = load_robot("girona_maris7")
    faults = (
        FaultMeta(text="altimeter_range:frozen@2", target="altimeter_range", kind="frozen", t=2.0),
        FaultMeta(text="thruster3:dead@3-4", target="thruster3", kind="dead", t=3.0, end=4.0),
        FaultMeta(text="joint2:jam@60", target="joint2", kind="jam", t=60.0),
    )
    page = write_scene(
        synthetic_record(robot, faults=faults), robot, tmp_path / "scene.html"
    ).read_text()
    frozen, dead = _details(page)["faults"]
    assert (frozen["name"], frozen["start"], frozen["end"], frozen["ended"]) == (
        "altimeter_range:frozen",
        2.0,
        6.0,
        False,
    )
    assert (dead["name"], dead["start"], dead["end"], dead["ended"]) == (
        "thruster3:dead",
        3.0,
        4.0,
        True,
    )


def test_a_goal_that_moves_is_drawn_where_it_is() -> None:
    X_WG = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.4, 3.0), np.array([12.2, 37.4, -39.5]))

    def goal(t: float) -> tuple[pin.SE3, np.ndarray]:
        return X_WG * pin.SE3(
            pin.rpy.rpyToMatrix(0.0, 0.0, 0.5 * t), np.array([0.3 * np.sin(t), 0.0, 0.1 * t])
        ), np.zeros(6)

    scenario = scenarios.case1(tool_goal=goal, duration=6.0, dt=0.02, plant="kinematic")
    keys = _tracks(show(scenario.run(), scenario.robot, fps=_FPS).html)
    for name, number in ((".position", slice(3)), (".quaternion", slice(3, 7))):
        (track,) = [
            found
            for (path, kind), found in keys.items()
            if kind == name and path.endswith("/goals/frame 1")
        ]
        times, values = (np.array([key[kind] for key in track]) for kind in ("time", "value"))
        for t in np.linspace(0.0, 5.98, 60):
            expected = pin.SE3ToXYZQUAT(goal(t)[0])[number]
            shown = np.array([np.interp(t, times / _FPS, column) for column in values.T])
            sign = np.sign(expected @ shown) if name == ".quaternion" else 1.0
            np.testing.assert_allclose(sign * shown, expected, atol=3e-3)


def test_a_goal_of_a_phase_moves_from_the_beginning_of_each_visit(
    record: Record, robot: Robot
) -> None:
    span = phase_spans(record)[1]
    still = (0.0, 0.0, 0.0, 1.0)
    way = ((0.0, 1.0, 0.0, 0.0, *still), (100.0, 11.0, 0.0, 0.0, *still))
    goal = FrameMeta(name="goal", pose=(1.0, 0.0, 0.0, *still), phase=span.name, way=way)
    page = show(_with_surroundings(record, frames=(goal,)), robot, fps=_FPS).html
    for key in _positions(page, "/goals/frame 0"):
        t = key["time"] / _FPS
        assert key["value"][0] == pytest.approx(
            1.0 + 0.1 * np.clip(t - span.start, 0.0, span.end - span.start), abs=0.01
        )
