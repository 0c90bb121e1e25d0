"""Laws of the state estimator: accurate at rest, quick in motion, honest about its age."""

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.errors import FrameNotFound, InvalidInput
from uvms_ocp.estimation.estimator import Estimator, PassThrough, age_of
from uvms_ocp.estimation.tuning import EstimatorTuning
from uvms_ocp.robot.loading import list_robots, load_robot
from uvms_ocp.robot.signals import (
    CHANNELS,
    IDEAL_SENSORS,
    Command,
    Reading,
    Readings,
    SensorSpec,
    SensorSpecs,
    State,
)
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.sim.sensors import Altimeter, SensorSuite

DT = 1 / 200
FLOOR = FlatSeafloor(z=-40.0)
DEFAULT = SensorSpecs()


@pytest.fixture(scope="module", name="robot")
def _robot():
    return load_robot("girona_maris7")


@pytest.fixture(scope="module", name="start")
def _start(robot):
    return robot.configuration(position=(1.0, 2.0, -36.0), rpy=(0.1, -0.06, 0.5))


class Run:
    """A motion v(t), what sensors and estimator make of it, and the errors of the estimate per
    tick.
    """

    def __init__(
        self,
        robot,
        q,
        motion,
        duration,
        *,
        specs=DEFAULT,
        seed=0,
        commanded=False,
        lag=0.0,
        expected=None,
    ):
        suite = SensorSuite(robot, FLOOR, specs, seed=seed)
        estimator = Estimator(robot, expected or specs)
        altimeter = Altimeter(robot, FLOOR)
        self.t = DT * np.arange(round(duration / DT))
        rows = []
        v = motion(0.0)
        for t in self.t:
            if lag == 0.0:
                v = motion(t)
            else:
                v = v + (motion(t) - v) * DT / lag
            command = Command(v=motion(t)) if commanded else None
            m = estimator(suite.read(State(q=q, v=v), t), t, command)
            turn = pin.log3((pin.Quaternion(q[3:7]).inverse() * pin.Quaternion(m.q[3:7])).matrix())
            error = [
                m.q[:3] - q[:3],
                turn,
                m.q[7:] - q[7:],
                m.v - v,
                [m.altimeter_range - altimeter.measure(q)],
            ]
            rows.append((np.concatenate(error), v, m.v, m.age))
            q = pin.integrate(robot.model, q, (v if lag else motion(t + DT / 2)) * DT)
        errors, self.v, self.v_estimated, self.age = (
            np.array(column) for column in zip(*rows, strict=True)
        )
        n = robot.n_joints
        self.position = errors[:, :3]
        self.attitude = errors[:, 3:6]
        self.joints = errors[:, 6 : 6 + n]
        self.velocity = errors[:, 6 + n : -1]
        self.altimeter = errors[:, -1]

    def lag_of(self, i):
        """Delay [s] of an estimated velocity that fits best."""
        true = self.v[400:, i]
        estimated = self.v_estimated[400:, i]
        shifts = range(-20, 41)
        misfit = [np.mean((estimated[40:-40] - np.roll(true, s)[40:-40]) ** 2) for s in shifts]
        return DT * shifts[int(np.argmin(misfit))]


def at_rest(robot):
    return lambda t: np.zeros(robot.n_v)


def swaying(robot):
    amplitude = np.array([0.4, 0.3, 0.2, 0.15, 0.15, 0.2] + [0.4] * robot.n_joints)
    frequency = np.linspace(0.5, 1.2, robot.n_v)  # [rad/s]
    return lambda t: amplitude * np.sin(frequency * t)


def steps(robot):
    rng = np.random.default_rng(1)
    levels = rng.uniform(-1.0, 1.0, (20, robot.n_v)) * (
        [0.3, 0.2, 0.2, 0.1, 0.1, 0.2] + [0.4] * robot.n_joints
    )
    ramp = 0.5  # [s] from one level to the next

    def motion(t):
        k = int(t / 3.0)
        share = min((t - 3.0 * k) / ramp, 1.0)
        return levels[k] + (levels[k + 1] - levels[k]) * share

    return motion


@pytest.fixture(scope="module", name="resting")
def _rest(robot, start):
    return [Run(robot, start, at_rest(robot), 24.0, seed=seed) for seed in range(6)]


def deviation(runs, name, after=20.0):
    return np.sqrt(np.mean([getattr(run, name)[run.t >= after] ** 2 for run in runs], axis=(0, 1)))


@pytest.mark.slow
def test_at_rest_the_position_is_known_to_four_millimetres_after_twenty_seconds(resting):
    assert deviation(resting, "position").max() < 4e-3


def test_at_rest_the_attitude_is_known_to_a_third_of_a_milliradian(resting):
    assert deviation(resting, "attitude").max() < 3e-4


def test_at_rest_joints_and_velocities_are_quiet(resting):
    velocity = deviation(resting, "velocity")
    assert velocity[:3].max() < 5e-3
    assert velocity[3:6].max() < 2e-3
    assert velocity[6:].max() < 3e-3
    assert deviation(resting, "joints").max() < 1e-4


def test_at_rest_the_altitude_is_known_to_four_millimetres(resting):
    assert deviation(resting, "altimeter").max() < 4e-3


@pytest.mark.sampled
@pytest.mark.parametrize("commanded", [False, True])
@pytest.mark.parametrize("motion", [swaying, steps])
def test_estimated_velocities_lag_by_less_than_fifty_milliseconds(robot, start, motion, commanded):
    run = Run(robot, start, motion(robot), 30.0, commanded=commanded, lag=0.1)
    assert max(abs(run.lag_of(i)) for i in range(robot.n_v)) <= 0.05


@pytest.mark.slow
def test_a_known_command_halves_the_velocity_error(robot, start):
    blind, told = (
        Run(robot, start, steps(robot), 30.0, commanded=commanded, lag=0.1)
        for commanded in (False, True)
    )
    assert (
        deviation([told], "velocity", 2.0)[:3].max()
        < 0.5 * deviation([blind], "velocity", 2.0)[:3].max()
    )


def test_in_motion_the_pose_stays_known(robot, start):
    run = Run(robot, start, swaying(robot), 30.0)
    assert deviation([run], "position", 5.0).max() < 0.015
    assert deviation([run], "attitude", 5.0).max() < 5e-4
    assert deviation([run], "altimeter", 5.0).max() < 0.015
    assert deviation([run], "joints", 5.0).max() < 5e-4


def test_exact_sensors_give_the_exact_state(robot, start):
    run = Run(robot, start, swaying(robot), 3.0, specs=IDEAL_SENSORS)
    for name in ("position", "attitude", "joints", "velocity", "altimeter"):
        assert np.abs(getattr(run, name)[run.t > 0.5]).max() < 5e-6


def test_late_readings_are_compared_with_the_past(robot, start):
    late = replace(
        DEFAULT,
        position=SensorSpec(rate=5.0, sigma=0.02, delay=0.2),
        linear_velocity=SensorSpec(rate=5.0, sigma=0.002, delay=0.1),
        altimeter_range=SensorSpec(rate=10.0, sigma=0.01, delay=0.1),
    )

    def cruise(t):
        return np.array([0.4, 0.0, 0.1, 0.0, 0.0, 0.1] + [0.2] * robot.n_joints) * min(t / 2.0, 1.0)

    run = Run(
        robot, start, cruise, 15.0, specs=late
    )  # a filter blind to delays would be 80 mm behind
    assert np.abs(run.position[run.t > 10.0].mean(axis=0)).max() < 0.02
    assert deviation([run], "altimeter", 5.0).max() < 0.015


class Gliding:
    """Truth with constant acceleration in W, and a spin about z that is constant or grows; exact
    readings, one of them late.
    """

    def __init__(self, robot, spin_up):
        self.robot = robot
        self.spin_up = spin_up
        self.p = np.array([1.0, 2.0, -36.0])
        self.v = np.array([0.1, -0.2, 0.05])
        self.a = np.array([0.06, 0.04, -0.03])
        self.rates = np.linspace(-0.05, 0.05, robot.n_joints)

    def state(self, t):
        R = pin.exp3(np.array([0.0, 0.0, 0.1 * t + self.spin_up * t**2 / 2]))
        twist = [R.T @ (self.v + self.a * t), [0.0, 0.0, 0.1 + self.spin_up * t]]
        p = self.p + self.v * t + self.a * t**2 / 2
        q = np.concatenate(
            [p, pin.Quaternion(R).coeffs(), self.robot.configuration()[7:] + self.rates * t]
        )
        return State(q=q, v=np.concatenate([*twist, self.rates]))

    def readings(self, t, late, delay):
        def taken(name, value):
            then = t - delay if name == late else t
            return Reading(value=value(self.state(then)), t=then)

        values = {
            "position": lambda x: x.q[:3],
            "depth": lambda x: x.q[2],
            "attitude": lambda x: x.q[3:7],
            "angular_velocity": lambda x: x.v[3:6],
            "linear_velocity": lambda x: x.v[:3],
            "joint_positions": lambda x: x.q[7:],
        }
        return Readings(**{name: taken(name, value) for name, value in values.items()})


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("late", "spin_up"),
    [
        ("position", 0.0),
        ("depth", 0.0),
        ("attitude", 0.0),
        ("linear_velocity", 0.0),
        ("joint_positions", 0.0),
        ("angular_velocity", 0.02),
    ],
)
def test_a_late_exact_reading_of_steady_acceleration_tells_nothing_new(robot, late, spin_up):
    sharp = SensorSpecs(**{name: SensorSpec(sigma=1e-3) for name in CHANNELS})
    truth = Gliding(robot, spin_up)
    estimator = Estimator(robot, sharp)
    dt = 0.02
    for t in 1.0 + dt * np.arange(500):
        measurement = estimator(truth.readings(t, late, delay=0.2), t)
    error = pin.difference(robot.model, truth.state(t).q, measurement.q)
    np.testing.assert_allclose(error, 0.0, atol=2e-4)
    np.testing.assert_allclose(measurement.v, truth.state(t).v, atol=2e-4)


def test_a_gyro_bias_is_found_from_the_attitude(robot, start):
    biased = replace(
        DEFAULT, angular_velocity=SensorSpec(rate=100.0, sigma=0.002, bias=(0.002, -0.001, 0.003))
    )
    run = Run(robot, start, at_rest(robot), 40.0, specs=biased)
    assert np.abs(run.velocity[run.t > 35.0, 3:6].mean(axis=0)).max() < 5e-4
    assert deviation([run], "attitude", 35.0).max() < 5e-4


def test_half_of_the_readings_suffice(robot, start):
    lossy = {}
    for name in CHANNELS:
        spec = getattr(DEFAULT, name)
        lossy[name] = spec
        if spec is not None:
            lossy[name] = replace(spec, dropout=0.5)
    specs = SensorSpecs(**lossy)
    run = Run(robot, start, swaying(robot), 20.0, specs=specs)
    assert deviation([run], "position", 5.0).max() < 0.03
    assert deviation([run], "attitude", 5.0).max() < 1e-3


def test_the_estimate_has_no_jumps_between_readings(robot, start):
    run = Run(robot, start, swaying(robot), 10.0)
    settled = run.v_estimated[run.t > 5.0, :3]
    assert np.abs(np.diff(settled, axis=0)).max() < 0.05


def test_the_same_readings_give_the_same_estimate(robot, start):
    a, b = (Run(robot, start, swaying(robot), 1.0, seed=4) for _ in range(2))
    np.testing.assert_array_equal(a.v_estimated, b.v_estimated)


def test_a_reading_counts_once_however_often_it_is_repeated(robot, start):
    suite = SensorSuite(robot, FLOOR)
    estimators = (Estimator(robot), Estimator(robot))
    for k in range(100):
        readings = suite.read(State(q=start, v=np.zeros(robot.n_v)), k * DT)
        names = [name for name in CHANNELS if getattr(readings, name) is not None]
        copies = {
            n: Reading(value=getattr(readings, n).value, t=getattr(readings, n).t) for n in names
        }
        a, b = (
            e(r, k * DT) for e, r in zip(estimators, (readings, Readings(**copies)), strict=True)
        )
        np.testing.assert_array_equal(a.q, b.q)


def test_the_age_is_that_of_the_oldest_reading_that_matters(robot, start):
    assert Run(robot, start, at_rest(robot), 2.0).age.max() == pytest.approx(0.195)
    readings = Readings(position=Reading(value=np.zeros(3), t=1.0), depth=Reading(value=0.0, t=0.2))
    assert age_of(readings, ("position",), 1.5) == 0.5
    assert age_of(readings, ("position", "depth"), 1.5) == 1.3
    assert age_of(readings, ("position", "attitude"), 1.5) == math.inf


def test_the_age_grows_while_a_sensor_is_silent(robot, start):
    suite = SensorSuite(robot, FLOOR)
    estimator = Estimator(robot)
    readings = suite.read(State(q=start, v=np.zeros(robot.n_v)), 0.0)
    ages = [estimator(readings, t).age for t in (0.0, 0.5, 3.0)]
    assert ages == [0.0, 0.5, 3.0]


def test_before_the_first_reading_the_age_is_infinite(robot):
    measurement = Estimator(robot)(Readings(), 0.0)
    assert measurement.age == math.inf
    assert math.isnan(measurement.altimeter_range)
    assert np.isfinite(measurement.q).all()


def test_the_altitude_is_forgotten_a_second_after_the_last_echo(robot, start):
    suite = SensorSuite(robot, FLOOR)
    estimator = Estimator(robot)
    readings = suite.read(State(q=start, v=np.zeros(robot.n_v)), 0.0)
    ranges = [estimator(readings, t).altimeter_range for t in (0.0, 0.9, 1.1)]
    assert [math.isfinite(r) for r in ranges] == [True, True, False]


def test_a_step_of_the_floor_is_believed_at_once(robot, start):
    state = State(q=start, v=np.zeros(robot.n_v))
    estimator = Estimator(robot)
    for z, end in ((-40.0, 5.0), (-38.0, 5.0 + DT)):
        suite = SensorSuite(robot, FlatSeafloor(z=z), seed=1)
        times = np.arange(0.0, 5.0, DT) if z == -40.0 else [end]
        for t in times:
            measured = estimator(suite.read(state, t), t).altimeter_range
        assert measured == pytest.approx(
            Altimeter(robot, FlatSeafloor(z=z)).measure(start), abs=0.05
        )


@pytest.mark.parametrize("name", list_robots())
def test_every_robot_can_be_estimated(name):
    robot = load_robot(name)
    state = State(q=robot.configuration(), v=np.zeros(robot.n_v))
    suite = SensorSuite(robot, FLOOR)
    estimator = Estimator(robot)
    for k in range(400):
        measurement = estimator(suite.read(state, k * DT), k * DT)
    assert np.linalg.norm(pin.difference(robot.model, state.q, measurement.q)) < 0.05
    assert np.linalg.norm(measurement.v) < 0.05
    assert measurement.age < 0.21


def test_the_pass_through_repeats_ideal_sensors_exactly(robot, start):
    suite = SensorSuite(robot, FLOOR, IDEAL_SENSORS)
    through = PassThrough(robot)
    state = State(q=start, v=swaying(robot)(2.0))
    measurement = through(suite.read(state, 0.4), 0.4)
    np.testing.assert_array_equal(measurement.q, state.q)
    np.testing.assert_array_equal(measurement.v, state.v)
    assert measurement.altimeter_range == Altimeter(robot, FLOOR).measure(start)
    assert measurement.age == 0.0


def test_the_pass_through_of_a_fixed_base_needs_joints_only():
    robot = load_robot("planar5")
    specs = SensorSpecs(joint_velocities=SensorSpec())
    state = State(q=robot.configuration(), v=np.ones(robot.n_v))
    np.testing.assert_array_equal(
        PassThrough(robot, specs)(SensorSuite(robot, FLOOR, specs).read(state, 0.0), 0.0).v, state.v
    )


def test_the_pass_through_says_what_it_lacks(robot):
    with pytest.raises(InvalidInput, match="joint_velocities is missing"):
        PassThrough(robot, DEFAULT)
    with pytest.raises(InvalidInput, match="no reading"):
        PassThrough(robot)(Readings(), 0.0)


def test_time_must_not_run_backwards(robot):
    estimator = Estimator(robot)
    estimator(Readings(), 1.0)
    with pytest.raises(InvalidInput, match="increasing"):
        estimator(Readings(), 0.5)


def test_an_unknown_altimeter_frame_is_refused(robot):
    with pytest.raises(FrameNotFound):
        Estimator(robot, altimeter_frame="sonar")


@pytest.mark.parametrize("name", EstimatorTuning.__slots__)
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_wrong_tunings_are_refused_in_one_line(name, value):
    with pytest.raises(InvalidInput, match=name) as error:
        EstimatorTuning(**{name: value})
    assert "\n" not in str(error.value)
