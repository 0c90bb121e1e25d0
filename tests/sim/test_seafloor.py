"""Laws of sea floors."""

import math

import coal
import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.robot.shapes.obstacles import mesh_shape
from uvms_ocp.sim.bathymetry import Bathymetry
from uvms_ocp.sim.rough_seafloor import RELIEFS, HeightField, Relief
from uvms_ocp.sim.seafloor import FlatSeafloor, floor_mesh

FLOORS = {
    "plane": FlatSeafloor(z=-40.0),
    **{name: HeightField.random(name, z=-40.0, seed=4) for name in RELIEFS},
    "bathymetry": Bathymetry(
        x=np.linspace(-50, 30, 17) ** 3 / 2500,
        y=np.arange(-30.0, 41.0, 7.0),
        z=np.random.default_rng(6).uniform(-44.0, -38.5, (11, 17)),
    ),
    "no bumps": HeightField(
        z=-40.0, centres=np.zeros((0, 2)), heights=np.zeros(0), radii=np.zeros(0)
    ),
}


@pytest.fixture(params=FLOORS, name="floor")
def _floor(request):
    return FLOORS[request.param]


def random_rays(n, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(n):
        direction = rng.standard_normal(3)
        direction[2] = -abs(direction[2]) - 0.05
        origin = np.array([*rng.uniform(-60.0, 60.0, 2), rng.uniform(-38.0, -25.0)])
        yield origin, direction / np.linalg.norm(direction)


def test_a_ray_ends_on_the_floor(floor):
    for origin, direction in random_rays(100):
        if origin[2] > floor.height(*origin[:2]):
            x, y, z = origin + floor.range_along(origin, direction) * direction
            assert z == pytest.approx(floor.height(x, y), abs=1e-6)


@pytest.mark.sampled
def test_a_ray_meets_no_floor_before_its_end(floor):
    for origin, direction in random_rays(50, seed=1):
        if origin[2] > floor.height(*origin[:2]):
            for s in np.linspace(0.0, floor.range_along(origin, direction) - 1e-3, 200):
                x, y, z = origin + max(s, 0.0) * direction
                assert z > floor.height(x, y) - 1e-6


def test_a_ray_that_rises_above_everything_has_no_echo(floor):
    assert math.isnan(floor.range_along(np.array([0.0, 0.0, -20.0]), np.array([0.6, 0.0, 0.8])))
    assert math.isnan(floor.range_along(np.array([0.0, 0.0, -20.0]), np.array([1.0, 0.0, 0.0])))


def test_a_level_ray_hits_a_bump_on_its_way():
    floor = HeightField(z=0.0, centres=[[10.0, 0.0]], heights=[2.0], radii=[3.0])
    hit = floor.range_along(np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    assert hit == pytest.approx(10.0 - 3.0 * math.sqrt(1.0 - 0.5 ** (1 / 3)), abs=1e-6)


def test_a_sensor_below_the_floor_reads_no_positive_range(floor):
    x = 3.0
    y = 4.0
    down = np.array([0.0, 0.0, -1.0])
    assert floor.range_along(np.array([x, y, floor.height(x, y) - 0.1]), down) == pytest.approx(
        -0.1
    )


def test_the_normal_is_a_unit_vector_across_the_surface(floor):
    rng = np.random.default_rng(2)
    step = 1e-5
    for x, y in rng.uniform(-40.0, 40.0, (50, 2)):
        slope_x = (floor.height(x + step, y) - floor.height(x - step, y)) / (2 * step)
        slope_y = (floor.height(x, y + step) - floor.height(x, y - step)) / (2 * step)
        upwards = np.array([-slope_x, -slope_y, 1.0])
        np.testing.assert_allclose(floor.normal(x, y), upwards / np.linalg.norm(upwards), atol=1e-8)


@pytest.mark.parametrize("name", RELIEFS)
def test_slopes_are_continuous_across_the_rims_of_bumps(name):
    floor = FLOORS[name]
    rims = floor.centres + np.stack([floor.radii, np.zeros_like(floor.radii)], axis=1)
    for x, y in rims:
        np.testing.assert_allclose(
            floor.gradient(x - 1e-6, y), floor.gradient(x + 1e-6, y), atol=1e-4
        )


@pytest.mark.parametrize("name", RELIEFS)
def test_the_same_seed_gives_the_same_floor_and_another_seed_another(name):
    points = np.random.default_rng(0).uniform(-40.0, 40.0, (100, 2))
    same = HeightField.random(name, z=-40.0, seed=4)
    reseeded = HeightField.random(name, z=-40.0, seed=5)
    np.testing.assert_array_equal(same.ground_at(points)[0], FLOORS[name].ground_at(points)[0])
    assert np.abs(reseeded.ground_at(points)[0] - FLOORS[name].ground_at(points)[0]).max() > 0.01


def test_rougher_reliefs_are_higher():
    points = np.random.default_rng(0).uniform(-40.0, 40.0, (2000, 2))
    tops = [FLOORS[name].ground_at(points)[0].max() + 40.0 for name in ("flat", "small", "large")]
    assert 0.0 < tops[0] < 0.5 < tops[1] < 3.0 < tops[2]


def test_a_height_field_lies_on_its_plane_and_never_below():
    points = np.random.default_rng(0).uniform(-100.0, 100.0, (2000, 2))
    heights = FLOORS["large"].ground_at(points)[0]
    assert heights.min() == -40.0


def test_many_points_at_once_equal_points_one_by_one():
    floor = FLOORS["small"]
    points = np.random.default_rng(0).uniform(-50.0, 50.0, (20, 2))
    np.testing.assert_allclose(
        floor.ground_at(points)[0], [floor.height(*point) for point in points], atol=1e-12
    )


def test_a_mesh_lies_on_the_floor_and_faces_up(floor):
    vertices, triangles = floor_mesh(floor, centre=(5.0, 6.0), extent=10.0, spacing=1.0)
    assert vertices.shape == (121, 3)
    assert triangles.shape == (200, 3)
    for x, y, z in vertices:
        assert z == pytest.approx(floor.height(x, y))
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    areas = np.cross(b - a, c - a)[:, 2] / 2
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(100.0)


def test_the_clearance_to_the_shape_of_a_mesh_is_that_to_the_floor():
    floor = FLOORS["large"]
    shape = mesh_shape(*floor_mesh(floor, centre=(0.0, 0.0), extent=30.0, spacing=0.5))
    drop = np.array([0.0, 0.0, -1.0])
    for x, y in np.random.default_rng(3).uniform(-10.0, 10.0, (20, 2)):
        point = np.array([x, y, floor.height(x, y)]) + 0.5 * floor.normal(x, y)
        pose = coal.Transform3s(np.eye(3), point)
        request = coal.DistanceRequest()
        result = coal.DistanceResult()
        distance = coal.distance(
            coal.Sphere(0.1), pose, shape, coal.Transform3s.Identity(), request, result
        )
        assert distance == pytest.approx(0.4, abs=0.02)
        assert floor.range_along(point, drop) >= distance


def test_a_mesh_of_vertices_that_do_not_exist_is_refused():
    with pytest.raises(InvalidInput, match="3 vertices"):
        mesh_shape(np.eye(3), np.array([[0, 1, 3]]))


def test_wrong_floors_are_refused_in_one_line():
    ok = {"z": 0.0, "centres": np.zeros((1, 2)), "heights": np.ones(1), "radii": np.ones(1)}
    for bad in (
        {"z": math.nan},
        {"centres": np.zeros((2, 2))},
        {"heights": np.array([math.nan])},
        {"heights": -np.ones(1)},
        {"radii": np.zeros(1)},
    ):
        with pytest.raises(InvalidInput) as error:
            HeightField(**(ok | bad))
        assert "\n" not in str(error.value)
    with pytest.raises(InvalidInput, match="finite height"):
        FlatSeafloor(z=math.inf)
    with pytest.raises(NameNotFound, match="flat, small, large"):
        HeightField.random("huge", z=0.0)
    with pytest.raises(InvalidInput, match="extent"):
        HeightField.random("flat", z=0.0, extent=0.0)
    with pytest.raises(InvalidInput, match="lowest <= highest"):
        Relief(height=(1.0, 0.5), radius=(1.0, 2.0), spacing=1.0)
    with pytest.raises(InvalidInput, match="spacing"):
        Relief(height=(0.5, 1.0), radius=(1.0, 2.0), spacing=0.0)
    with pytest.raises(InvalidInput, match="spacing"):
        floor_mesh(FLOORS["flat"], centre=(0.0, 0.0), extent=1.0, spacing=0.0)


@pytest.mark.parametrize("form", ["csv", "titled.csv", "npz"])
def test_a_survey_is_read_from_a_file_and_goes_through_its_points(form, tmp_path):
    """In any order of lines, with the place of W in the coordinates of the chart."""
    x = np.array([500.0, 502.0, 507.0])
    y = np.array([60.0, 61.5])
    z = np.random.default_rng(1).uniform(-30.0, -20.0, (2, 3))
    path = tmp_path / f"bödén 1.{form}"
    if form == "npz":
        np.savez(path, x=x, y=y, z=z)
    else:
        lines = [f"{a},{b},{float(z[j, i])!r}" for i, a in enumerate(x) for j, b in enumerate(y)]
        np.random.default_rng(2).shuffle(lines)
        path.write_text(
            "\n".join([*(["east,north,height"] if "titled" in form else []), *lines]),
            encoding="utf-8",
        )
    floor = Bathymetry.read(path, origin=(501.0, 60.0, -5.0))
    for i, a in enumerate(x):
        for j, b in enumerate(y):
            assert floor.height(a - 501.0, b - 60.0) == pytest.approx(z[j, i] + 5.0)
    assert floor.height(-100.0, -100.0) == pytest.approx(z[0, 0] + 5.0)


def test_a_survey_of_depths_is_not_taken_for_a_floor_above_the_water(tmp_path):
    (tmp_path / "floor.csv").write_text(
        "East;North;Depth [m]\n0;0;9\n1;0;9\n0;1;8\n1;1;8\n", encoding="utf-8"
    )
    with pytest.raises(
        InvalidInput, match=r"'East North Depth \[m\]' are depths, not heights: change their sign"
    ):
        Bathymetry.read(tmp_path / "floor.csv")


DEPTHS = (
    "x,y,depth,",
    "x y water depth",
    "# x y depth m",
    "x,y,depth (m, positive down)",
    "x,y,(depth)",
    "1D x; y; depth_m",
    "x\ty\tDEPTH",
)
HEIGHTS = (
    *(
        "1D easting,northing,height",
        "0-based x,y,z",
        "2D x y z",
        "x,y,elevation (negative depth)",
        "x y elevation [negative depth]",
    ),
    *("depth to heights x,y,z", "depth to heights x y z", "water depth datum LAT; x; z"),
)


@pytest.mark.parametrize("title", DEPTHS + HEIGHTS)
def test_depths_are_what_the_last_column_of_a_title_is_called(title, tmp_path):
    (tmp_path / "floor.csv").write_text(
        f"{title}\n0,0,-9\n1,0,-9\n0,1,-8\n1,1,-8\n", encoding="utf-8"
    )
    if title in DEPTHS:
        with pytest.raises(InvalidInput, match="are depths, not heights"):
            Bathymetry.read(tmp_path / "floor.csv")
    else:
        assert Bathymetry.read(tmp_path / "floor.csv").height(0.5, 0.5) == pytest.approx(-8.5)


@pytest.mark.parametrize("title", ["", "# x y z\n", "x y height\n"])
def test_a_survey_may_have_blanks_between_its_numbers(title, tmp_path):
    (tmp_path / "floor.xyz").write_text(
        title + "0 0 -9\n 1\t0  -9\n0 1 -8\n1 1 -8\n", encoding="utf-8"
    )
    assert Bathymetry.read(tmp_path / "floor.xyz").height(0.5, 0.5) == pytest.approx(-8.5)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "x,y,z",
        ",,",
        "0,0,1\n1,0,1\n0,1,1",
        "0,0,1\n0,0,1\n1,0,1\n1,1,1",
        "0,0\n1,1",
        "0,0,1\n1,0,nan\n0,1,1\n1,1,1",
    ],
)
def test_a_survey_with_holes_is_refused_in_one_line(text, tmp_path):
    (tmp_path / "floor.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput) as error:
        Bathymetry.read(tmp_path / "floor.csv")
    assert "\n" not in str(error.value)
    with pytest.raises(InvalidInput, match=r"nowhere.npz.* no bathymetry"):
        Bathymetry.read(tmp_path / "nowhere.npz")
