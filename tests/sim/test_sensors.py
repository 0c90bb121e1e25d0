"""Laws of the simulated sensors."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.errors import FrameNotFound, InvalidInput, RobotDataError
from uvms_ocp.robot.kinematics import AltimeterBeam
from uvms_ocp.robot.loading import list_robots, load_robot, robot_folder
from uvms_ocp.robot.signals import CHANNELS, IDEAL_SENSORS, SensorSpec, SensorSpecs, State
from uvms_ocp.sim.faults import parse_faults
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.sim.sensors import Altimeter, SensorSuite

DT = 1 / 200
FLOOR = FlatSeafloor(z=-40.0)
DEFAULT = SensorSpecs()
VECTORS = ("attitude", "position", "angular_velocity", "linear_velocity", "specific_force")
UNITS = dict.fromkeys(VECTORS, 3) | {"depth": 1, "altimeter_range": 1}


@pytest.fixture(scope="module", name="robot")
def _robot():
    return load_robot("girona_maris7")


def state_of(robot, seed=0):
    rng = np.random.default_rng(seed)
    free = {"position": (1.0, 2.0, -36.0), "rpy": (0.1, -0.06, 0.5)} if robot.n_vehicle else {}
    return State(
        q=robot.configuration(**free),
        v=rng.uniform(-0.2, 0.2, robot.n_v),
        a=rng.uniform(-0.2, 0.2, robot.n_v),
    )


def one(name, spec, robot, seed=0):
    """A suite in which `name` is as given and everything else ideal."""
    return SensorSuite(robot, FLOOR, replace(IDEAL_SENSORS, **{name: spec}), seed=seed)


def series(suite, state, duration, dt=DT):
    times = dt * np.arange(round(duration / dt))
    return times, [suite.read(state, t) for t in times]


def error_of(name, reading, truth, robot):
    """Tangent-space error of one reading against that of an ideal sensor."""
    if name == "attitude":
        return pin.log3(
            (pin.Quaternion(truth.value).inverse() * pin.Quaternion(reading.value)).matrix()
        )
    return np.atleast_1d(reading.value - truth.value)


@pytest.mark.parametrize("name", list_robots())
def test_ideal_sensors_repeat_the_true_state_exactly(name):
    robot = load_robot(name)
    state = state_of(robot)
    readings = SensorSuite(robot, FLOOR, IDEAL_SENSORS).read(state, 0.3)
    np.testing.assert_array_equal(readings.joint_positions.value, state.q[robot.joint_q])
    np.testing.assert_array_equal(readings.joint_velocities.value, state.v[robot.joint_v])
    if robot.n_vehicle:
        np.testing.assert_array_equal(readings.position.value, state.q[:3])
        np.testing.assert_array_equal(readings.attitude.value, state.q[3:7])
        np.testing.assert_array_equal(readings.linear_velocity.value, state.v[:3])
        np.testing.assert_array_equal(readings.angular_velocity.value, state.v[3:6])
        assert readings.depth.value == state.q[2]
        assert readings.altimeter_range.t == 0.3


def test_a_fixed_base_has_no_vehicle_channels():
    readings = SensorSuite(robot := load_robot("planar5"), FLOOR).read(state_of(robot), 0.0)
    assert [name for name in CHANNELS if getattr(readings, name) is not None] == ["joint_positions"]


def test_readings_do_not_change_with_the_state_that_they_were_taken_from(robot):
    state = State(q=robot.configuration().copy(), v=np.zeros(robot.n_v))
    readings = SensorSuite(robot, FLOOR, IDEAL_SENSORS).read(state, 0.0)
    state.q.setflags(write=True)
    state.q[:3] += 1.0
    assert not readings.position.value.any()


@pytest.mark.parametrize("seed", [0, 1])
def test_the_same_seed_gives_the_same_readings(robot, seed):
    first, second = (
        series(SensorSuite(robot, FLOOR, seed=seed), state_of(robot), 2.0)[1] for _ in range(2)
    )
    for a, b in zip(first, second, strict=True):
        for name in CHANNELS:
            if getattr(a, name) is not None:
                np.testing.assert_array_equal(getattr(a, name).value, getattr(b, name).value)


def test_another_seed_gives_other_readings(robot):
    a, b = (SensorSuite(robot, FLOOR, seed=seed).read(state_of(robot), 0.0) for seed in (0, 1))
    assert (a.position.value != b.position.value).all()


@pytest.mark.parametrize("spec", [SensorSpec(), SensorSpec(rate=5.0), SensorSpec(delay=0.01)])
def test_who_writes_to_a_reading_leaves_the_truth_and_the_other_readings_alone(spec, robot):
    state = state_of(robot)
    names = [name for name in CHANNELS if name not in ("depth", "altimeter_range")]
    suite = SensorSuite(robot, FLOOR, replace(IDEAL_SENSORS, **dict.fromkeys(CHANNELS, spec)))
    q = state.q.copy()
    v = state.v.copy()
    suite.read(state, 0.0)
    readings = suite.read(state, 1.0)
    for name in names:
        values = {o: getattr(readings, o).value.copy() for o in names if o != name}
        getattr(readings, name).value[:] = 7.0
        for channel, value in values.items():
            np.testing.assert_array_equal(getattr(readings, channel).value, value)
    np.testing.assert_array_equal(state.q, q)
    np.testing.assert_array_equal(state.v, v)


def test_the_same_time_has_the_same_readings(robot):
    suite = SensorSuite(robot, FLOOR, IDEAL_SENSORS)
    first = suite.read(state_of(robot), 0.5)
    again = suite.read(State(q=robot.configuration(), v=np.ones(robot.n_v)), 0.5)
    assert all(getattr(first, name) is getattr(again, name) for name in CHANNELS)


def test_the_altimeter_looks_along_its_frame_from_where_it_is(robot):
    rng = np.random.default_rng(4)
    altimeter = Altimeter(robot, FLOOR)
    for _ in range(20):
        q = robot.configuration(
            position=rng.normal(size=3), rpy=0.4 * rng.normal(size=3), joints=robot.home
        )
        beam = AltimeterBeam(robot, "altimeter").at(q)
        assert altimeter.measure(q) == pytest.approx(
            FLOOR.range_along(beam.origin, beam.direction), rel=1e-13
        )


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 2.0, 3.1])
def test_an_error_turns_the_attitude_about_the_axes_of_the_vehicle(angle, robot):
    state = state_of(robot)
    bias = tuple(angle * np.array([0.6, 0.0, -0.8]))
    value = one("attitude", SensorSpec(bias=bias), robot).read(state, 0.0).attitude.value
    turned = pin.Quaternion(state.q[3:7]).matrix() @ pin.exp3(np.array(bias))
    np.testing.assert_allclose(pin.Quaternion(value).matrix(), turned, atol=1e-14)


def test_the_noise_of_a_channel_does_not_depend_on_the_other_channels(robot):
    specs = replace(DEFAULT, position=None, depth=SensorSpec(rate=3.0, sigma=0.5, dropout=0.5))
    a, b = (
        series(SensorSuite(robot, FLOOR, s, seed=3), state_of(robot), 1.0)[1][-1]
        for s in (DEFAULT, specs)
    )
    np.testing.assert_array_equal(a.linear_velocity.value, b.linear_velocity.value)
    assert a.altimeter_range.value == b.altimeter_range.value


@pytest.mark.parametrize("dt", [1 / 200, 1 / 1000, 1 / 30])
@pytest.mark.parametrize("rate", [1.0, 5.0, 7.0, 10.0, 100.0, 200.0])
def test_readings_come_at_the_rate_of_the_sensor_or_of_the_ticks(robot, rate, dt):
    duration = 6.0
    suite = one("position", SensorSpec(rate=rate), robot)
    times, readings = series(suite, state_of(robot), duration, dt)
    stamps = sorted({r.position.t for r in readings})
    assert len(stamps) == pytest.approx(duration * min(rate, 1 / dt), abs=1)
    assert np.diff(stamps).min() > 1 / rate - dt - 1e-9
    ages = times - np.array([r.position.t for r in readings])
    assert ages.max() < max(1 / rate, dt) + 1e-9


@pytest.mark.parametrize("delay", [0.02, 0.13, 0.5])
def test_a_reading_arrives_after_its_delay_and_not_before(robot, delay):
    times, readings = series(
        one("position", SensorSpec(rate=10.0, delay=delay), robot), state_of(robot), 3.0
    )
    for t, r in zip(times, readings, strict=True):
        if t < delay - 1e-9:
            assert r.position is None
        else:
            assert delay - 1e-8 <= t - r.position.t <= delay + 0.1 + DT


def test_a_delayed_reading_holds_the_value_of_the_time_at_which_it_was_taken(robot):
    suite = one("depth", SensorSpec(delay=0.1), robot)
    for k in range(200):
        q = robot.configuration(position=(0.0, 0.0, -k * DT))
        depth = suite.read(State(q=q, v=np.zeros(robot.n_v)), k * DT).depth
        assert depth is None or depth.value == pytest.approx(-depth.t, abs=1e-12)


def test_a_drop_out_leaves_the_old_reading_with_its_old_time(robot):
    times, readings = series(
        one("position", SensorSpec(rate=10.0, sigma=1.0, dropout=0.5), robot), state_of(robot), 60
    )
    expected = np.floor(times * 10.0 + 1e-9) / 10.0
    fresh = [r.position for r in readings if r.position is not None]
    changes = sum(a is not b for a, b in pairwise(fresh)) + 1
    assert 0.4 < changes / 600 < 0.6
    assert any(
        r.position.t < e - 0.05
        for r, e in zip(readings, expected, strict=True)
        if r.position is not None
    )
    for a, b in pairwise(fresh):
        assert (a.t == b.t) == (a.value is b.value)


def test_drop_outs_leave_the_other_readings_as_they_were(robot):
    spec = SensorSpec(rate=10.0, sigma=1.0)
    whole, holey = (
        {
            r.position.t: r.position.value
            for r in series(one("position", s, robot), state_of(robot), 5)[1]
            if r.position
        }
        for s in (spec, replace(spec, dropout=0.5))
    )
    assert len(holey) < len(whole)
    for t, value in holey.items():
        np.testing.assert_array_equal(value, whole[t])


def test_a_sensor_that_loses_everything_never_reads(robot):
    assert (
        series(one("depth", SensorSpec(dropout=1.0), robot), state_of(robot), 1.0)[1][-1].depth
        is None
    )


@pytest.mark.parametrize("name", CHANNELS)
def test_noise_is_unbiased_and_of_the_given_deviation(robot, name):
    state = state_of(robot)
    truth = getattr(one(name, SensorSpec(), robot).read(state, 0.0), name)
    suite = one(name, SensorSpec(sigma=0.03), robot)
    errors = np.array(
        [
            error_of(name, getattr(suite.read(state, k * DT), name), truth, robot)
            for k in range(4000)
        ]
    )
    assert np.abs(errors.mean(axis=0)).max() < 4 * 0.03 / math.sqrt(4000)
    np.testing.assert_allclose(errors.std(axis=0), 0.03, rtol=0.06)


@pytest.mark.parametrize("name", CHANNELS)
def test_a_bias_shifts_every_reading(robot, name):
    state = state_of(robot)
    truth = getattr(one(name, SensorSpec(), robot).read(state, 0.0), name)
    n = UNITS.get(name, robot.n_joints)
    for bias in (0.02, tuple(np.linspace(0.01, 0.03, n))):
        reading = getattr(one(name, SensorSpec(bias=bias), robot).read(state, 0.0), name)
        np.testing.assert_allclose(
            error_of(name, reading, truth, robot), np.broadcast_to(bias, (n,)), atol=1e-12
        )


def test_an_accelerometer_shows_how_the_velocity_in_the_world_changes_less_gravity(robot):
    state = state_of(robot)
    h = 1e-4
    R_WB = pin.Quaternion(state.q[3:7]).matrix()
    v, w = (state.v[:3], state.v[3:6])
    a = state.a[:3]
    before, after = (R_WB @ pin.exp3(s * h * w) @ (v + s * h * a) for s in (-1.0, 1.0))
    shown = one("specific_force", SensorSpec(), robot).read(state, 0.0).specific_force.value
    np.testing.assert_allclose(
        R_WB @ shown + robot.model.gravity.linear, (after - before) / (2 * h), atol=1e-7
    )


def test_the_noise_of_the_attitude_keeps_quaternions_at_unit_length(robot):
    suite = one("attitude", SensorSpec(sigma=0.5), robot)
    for k in range(100):
        assert np.linalg.norm(suite.read(state_of(robot), k * DT).attitude.value) == pytest.approx(
            1.0, abs=1e-12
        )


def test_a_robot_upside_down_has_no_echo(robot):
    q = robot.configuration(position=(0.0, 0.0, -36.0), rpy=(math.pi, 0.0, 0.0))
    readings = SensorSuite(robot, FLOOR).read(State(q=q, v=np.zeros(robot.n_v)), 0.0)
    assert math.isnan(readings.altimeter_range.value)


@pytest.mark.parametrize(
    "bad",
    [
        {"rate": 0.0},
        {"rate": -1.0},
        {"rate": math.nan},
        {"sigma": -0.1},
        {"sigma": math.nan},
        {"sigma": math.inf},
        {"delay": -0.1},
        {"delay": math.inf},
        {"dropout": 1.1},
        {"dropout": math.nan},
        {"bias": math.nan},
        {"bias": (0.0, math.inf)},
    ],
)
def test_wrong_numbers_are_refused_in_one_line_that_names_them(bad):
    with pytest.raises(InvalidInput, match=next(iter(bad))) as error:
        SensorSpec(**bad)
    assert "\n" not in str(error.value)


def test_a_bias_of_the_wrong_length_is_refused(robot):
    with pytest.raises(
        InvalidInput, match="bias of position has 2 entries; give a number or 3 numbers"
    ):
        one("position", SensorSpec(bias=(0.1, 0.2)), robot)


def test_an_unknown_altimeter_frame_is_refused(robot):
    with pytest.raises(FrameNotFound, match="altimeter"):
        SensorSuite(robot, FLOOR, altimeter_frame="altimeterr")


@pytest.fixture(scope="module", name="mounted")
def _mounted():
    """A vehicle whose DVL is 0.6 m from the origin and turned."""
    urdf = robot_folder("bluerov2") / "robot.urdf"
    robot = load_robot(
        urdf=urdf, hydrodynamics=urdf.with_name("hydrodynamics.yaml"), dvl="altimeter"
    )
    return robot.with_frame_pose(
        "altimeter", pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.3, 2.0), np.array([0.5, -0.3, 0.2]))
    )


@pytest.mark.parametrize("bias", [0.0, 0.03])
def test_a_dvl_errs_along_its_axes_and_by_what_the_gyroscope_says_of_its_place(mounted, bias):
    state = state_of(mounted)
    specs = replace(
        IDEAL_SENSORS,
        linear_velocity=SensorSpec(bias=(0.01, 0.02, -0.03)),
        angular_velocity=SensorSpec(bias=bias),
    )
    suite = SensorSuite(mounted, FLOOR, specs)
    suite.read(state, 0.0)
    reading = suite.read(state, 0.1)
    data = mounted.model.createData()
    pin.forwardKinematics(mounted.model, data, state.q, state.v)
    frame = mounted.frame_id("dvl")
    X = mounted.model.frames[frame].placement
    at_sensor = (
        pin.getFrameVelocity(mounted.model, data, frame, pin.LOCAL).linear
        + specs.linear_velocity.biases
    )
    carried = X.rotation @ at_sensor - np.cross(reading.angular_velocity.value, X.translation)
    np.testing.assert_allclose(reading.linear_velocity.value, carried, atol=1e-14)


def test_an_ideal_dvl_tells_of_the_vehicle_wherever_it_is_and_a_fault_errs_along_its_axes(mounted):
    state = state_of(mounted)
    faults = parse_faults(["linear_velocity:bias=0.01,0.02,-0.03"])
    sound, faulty = (
        SensorSuite(mounted, FLOOR, IDEAL_SENSORS, faults=plant_faults).read(state, 0.0)
        for plant_faults in ((), faults)
    )
    np.testing.assert_array_equal(sound.linear_velocity.value, state.v[:3])
    error = mounted.model.frames[mounted.frame_id("dvl")].placement.rotation @ [0.01, 0.02, -0.03]
    np.testing.assert_allclose(faulty.linear_velocity.value, state.v[:3] + error, atol=1e-14)


def test_a_dvl_on_a_link_that_moves_is_refused():
    urdf = robot_folder("bluerov2_alpha5") / "robot.urdf"
    with pytest.raises(
        RobotDataError, match="dvl: given 'tool'; allowed: links fixed to the vehicle"
    ):
        load_robot(urdf=urdf, hydrodynamics=urdf.with_name("hydrodynamics.yaml"), dvl="tool")
