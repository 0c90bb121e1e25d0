"""Compute what a set of thrusters can do: the wrench of each, limits, signals, and unactuated
axes.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked
from uvms_ocp.codegen.elementwise import Array
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import symbolic_bodies
from uvms_ocp.robot.description import Thruster
from uvms_ocp.robot.robot import Robot

AXES = ("surge", "sway", "heave", "roll", "pitch", "yaw")
"""Names of the vehicle's axes, in the order of v."""
_ROUNDING = 1e-6  # relative
_RIGHTED = 3.0  # times that axes weigh which right themselves, among those that are out of reach
_REPEATABLE = 0.1  # of the thrust, within which a bench repeats its measurement of one signal
_WEAK = 0.1
"""Share of the best driven direction: what rights itself and is driven by less is left to itself.
"""


@checked
def thruster_matrix(robot: Robot) -> np.ndarray:
    """Return (6, n_thrusters) [-, m]: wrench per newton on the vehicle about the origin of B, in B,
    linear rows first.
    """
    return _columns(robot).copy()


@lru_cache(maxsize=8)
def _columns(robot: Robot) -> np.ndarray:
    columns = [_column(robot.model, thruster) for thruster in robot.description.thrusters]
    if not columns:
        return np.zeros((6, 0))
    return np.column_stack(columns)


def _column(model: pin.Model, thruster: Thruster) -> np.ndarray:
    direction = np.array(thruster.direction) / np.linalg.norm(thruster.direction)
    X_BF = model.frames[model.getFrameId(thruster.link)].placement
    force = X_BF.rotation @ direction
    position = X_BF.act(np.array(thruster.position))  # [m] in B
    return np.concatenate([force, np.cross(position, force)])


def thrust_limits(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Return lower and upper (n_thrusters,) [N], the thrust limits inside the range of the
    curve.
    """
    ranges = [_range(thruster) for thruster in robot.description.thrusters]
    lower, upper = np.array(ranges).reshape(-1, 2).T
    return lower, upper


def _range(thruster: Thruster) -> tuple[float, float]:
    if not thruster.curve:
        return thruster.minimum, thruster.maximum
    _, first_thrust = thruster.curve[0]
    _, last_thrust = thruster.curve[-1]
    return max(thruster.minimum, first_thrust), min(thruster.maximum, last_thrust)


def largest_wrench(robot: Robot) -> np.ndarray:
    """Return (6,) [N, N m], what all thrusters can give at most axis by axis, ahead and up; 0 where
    that is rounding.
    """
    _, ahead = _wrench_range(robot)
    return ahead


def largest_force(robot: Robot) -> np.ndarray:
    """Return (n_v,) [N, N m], what thrusters and motors can give at most on every axis, in the
    direction in which they give more.
    """
    astern, ahead = _wrench_range(robot)
    wrench = np.maximum(ahead, -astern)
    return np.concatenate([wrench[: robot.n_vehicle], robot.limits.effort])


def _wrench_range(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and the highest component (6,) [N, N m] of the wrench of all thrusters,
    axis by axis; 0 where that is rounding.

    A thruster that is described from its other side, with direction and limits reversed, counts the
    same: what it gives along an axis lies between its matrix column times either limit.
    """
    lower, upper = thrust_limits(robot)
    columns = thruster_matrix(robot)
    at_lower = columns * lower
    at_upper = columns * upper
    astern = np.minimum(at_lower, at_upper).sum(axis=1)
    ahead = np.maximum(at_lower, at_upper).sum(axis=1)
    rounding = _ROUNDING * np.abs([astern, ahead]).max(initial=0.0)
    return (
        np.where(astern < -rounding, astern, 0.0),
        np.where(ahead > rounding, ahead, 0.0),
    )


def thrust_of_signals(robot: Robot, signals: np.ndarray) -> np.ndarray:
    """Return steady thrust (..., n_thrusters) [N] for command signals (..., n_thrusters), by each
    thruster's curve.

    Without a curve: linear, -1 and 1 are the limits. Signals beyond the curve give its ends.
    """
    thrust = list[np.ndarray]()
    signals_first = np.moveaxis(signals, -1, 0)
    for thruster, signal in zip(robot.description.thrusters, signals_first, strict=True):
        curve_signals, curve_thrust = np.transpose(_curve(thruster))
        thrust.append(np.interp(signal, curve_signals, curve_thrust))
    return np.stack(thrust, axis=-1)


def curve_of_table(
    signals: np.ndarray, thrust: np.ndarray, voltage: np.ndarray | None = None, at: float = 0.0
) -> tuple[tuple[tuple[float, float], ...], float]:
    """Fit the thrust curve of a table, never falling, and how far [N] measurements lie off it at
    most.

    signals: (n,) as they are sent, in any order, each as often as it was measured. thrust: (n,)
    [N]. voltage: (n,) [V] of each measurement; the curve is that at `at` [V], between those that
    were measured. Raises InvalidInput for less than two signals, a voltage outside the table, or,
    without voltages, thrust that no one curve has.
    """
    from scipy.optimize import isotonic_regression

    if voltage is None:
        _require_one_curve(signals, thrust)
        curve_signals, mean = _mean_thrust(signals, thrust)
    else:
        curve_signals, mean = _mean_thrust_at(signals, thrust, voltage, at)
    if len(curve_signals) < 2 or np.ptp(mean) == 0.0:
        raise InvalidInput(
            f"{len(curve_signals)} different signals given; allowed: two or more, of different"
            " thrust"
        )
    fitted = isotonic_regression(mean.copy(), increasing=bool(mean[-1] > mean[0])).x
    if fitted[-1] < fitted[0]:
        raise InvalidInput(
            "thrust falls from the lowest to the highest signal; give the opposite of its column,"
            " or of its sign"
        )
    curve = tuple(zip(curve_signals.tolist(), fitted.tolist(), strict=True))
    return curve, float(np.abs(fitted - mean).max())


def _require_one_curve(signals: np.ndarray, thrust: np.ndarray) -> None:
    """Check that strong thrust at one signal is measured alike: a table of several voltages has no
    one curve. Raises InvalidInput.
    """
    half = 0.5 * np.abs(thrust).max(initial=0.0)
    strong_signals = []
    spreads = []
    for signal in np.unique(signals):
        repeated = thrust[signals == signal]
        size = float(np.abs(repeated).mean())
        if len(repeated) > 1 and size > half:
            strong_signals.append(signal)
            spreads.append(float(np.ptp(repeated)) / size)
    if not spreads or np.median(spreads) < _REPEATABLE:
        return
    widest = strong_signals[int(np.argmax(spreads))]
    lowest = thrust[signals == widest].min()
    highest = thrust[signals == widest].max()
    raise InvalidInput(
        f"{lowest:.4g} to {highest:.4g} N measured at the same signal {widest:g}, and so for half of"
        " the strong ones: at several voltages? give --voltage COLUMN and --at V, or the rows of one"
    )


def _mean_thrust(signals: np.ndarray, thrust: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the different signals, ascending, and the mean thrust [N] at each."""
    different_signals, index = np.unique(signals, return_inverse=True)
    return different_signals, np.bincount(index, weights=thrust) / np.bincount(index)


def _mean_thrust_at(
    signals: np.ndarray, thrust: np.ndarray, voltage: np.ndarray, at: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the different signals, ascending, and the mean thrust [N] at each, interpolated to a
    voltage `at` [V] between the nearest two of the table.
    """
    voltages = np.unique(voltage)
    if not voltages[0] <= at <= voltages[-1]:
        raise InvalidInput(
            f"{at:g} V given; allowed: {voltages[0]:g} to {voltages[-1]:g} V, which the table has"
        )
    below = voltages[voltages <= at][-1]
    above = voltages[voltages >= at][0]
    share = 0.0
    if above > below:
        share = (at - below) / (above - below)
    is_below = voltage == below
    is_above = voltage == above
    signals_below, mean_below = _mean_thrust(signals[is_below], thrust[is_below])
    signals_above, mean_above = _mean_thrust(signals[is_above], thrust[is_above])
    all_signals = np.unique(np.concatenate([signals_below, signals_above]))
    thrust_below = np.interp(all_signals, signals_below, mean_below)
    thrust_above = np.interp(all_signals, signals_above, mean_above)
    return all_signals, thrust_below + share * (thrust_above - thrust_below)


def _curve(thruster: Thruster) -> tuple[tuple[float, float], ...]:
    return thruster.curve or ((-1.0, thruster.minimum), (0.0, 0.0), (1.0, thruster.maximum))


@lru_cache(maxsize=8)
def unactuated_axes(robot: Robot) -> tuple[int, ...]:
    """Return the vehicle axes 0-5 (surge, sway, heave, roll, pitch, yaw) that thrust cannot drive
    on their own.

    As many axes as the thruster matrix lacks in rank, those that weigh most in its left null space:
    where sway brings a little roll along, roll is the one out of reach. Roll and pitch right
    themselves: of a lift that comes with a pitch, weight bears the pitch, and the vehicle is where its
    thrusters want it. They weigh three times as much, and count where they are hardly driven, as by
    lift thrusters a centimetre from where they are meant to be. Empty for a fixed base.
    """
    if robot.n_vehicle:
        return unreachable_axes(thruster_matrix(robot))
    return ()


def undriven_axes(robot: Robot) -> tuple[int, ...]:
    """Return `unactuated_axes` for tasks: none of a vehicle without thrusters, which follows
    velocities.
    """
    if robot.description.thrusters:
        return unactuated_axes(robot)
    return ()


def unreachable_axes(B: np.ndarray) -> tuple[int, ...]:
    """Return `unactuated_axes` of a thruster matrix B (6, n_thrusters) [-, m]."""
    return _heaviest_axes(left_null_space(B), righted=_RIGHTED)


def _heaviest_axes(null_space: np.ndarray, *, righted: float = 1.0) -> tuple[int, ...]:
    """Choose as many axes as there are columns, those with the largest entries, `righted` times as large
    of roll and pitch; of axes equal but for rounding the last.
    """
    factors = np.array([1.0, 1.0, 1.0, righted, righted, 1.0])
    remaining = null_space
    axes = []
    for _ in range(null_space.shape[1]):
        weights = factors * np.linalg.norm(remaining, axis=1)
        heaviest = np.flatnonzero(weights > (1.0 - _ROUNDING) * weights.max())
        axis = int(heaviest[-1])
        axes.append(axis)
        direction = remaining[axis] / np.linalg.norm(remaining[axis])
        remaining = remaining - np.outer(remaining @ direction, direction)
    return tuple(sorted(axes))


def left_null_space(B: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis (6, n) of the wrenches no thrust contributes to, of B (6,
    n_thrusters) [-, m].

    Of moments of roll and pitch those, too, that thrust hardly contributes to, see
    `unactuated_axes`. Moments are divided by the typical lever arm of the layout, so that newtons
    and newton metres compare.
    """
    U, s, _ = np.linalg.svd(B / _units(B)[:, None])
    share = np.append(s, np.zeros(len(U) - len(s))) / s.max(initial=1e-300)
    null_space = U[:, share <= _ROUNDING]
    weakly_driven = U[:, share <= _WEAK]
    righting = (AXES.index("roll"), AXES.index("pitch"))
    undriven_or_righting = {*_heaviest_axes(null_space), *righting}
    if undriven_or_righting.issuperset(_heaviest_axes(weakly_driven)):
        return weakly_driven
    return null_space


def _units(B: np.ndarray) -> np.ndarray:
    """Return (6,) [-, m] by which wrenches are divided: the typical lever arm of B for moments."""
    forces = float(np.linalg.norm(B[:3]))
    moments = float(np.linalg.norm(B[3:]))
    lever = moments / max(forces, np.finfo(float).tiny)
    return np.repeat([1.0, lever or 1.0], 3)


def free_motions(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Return the motions (n_v, n) that no thruster works on, and the rows (n, n_v) that measure how
    much of each there is.

    One for each of `undriven_axes`, with 1 of it and what it takes along: pitch turns about the
    line on which thrusters push ahead. Thrust cannot feed such a motion, whatever it does, as it
    feeds an axis that it cannot drive on its own.
    """
    axes = list(undriven_axes(robot))
    n = robot.n_v
    motions = np.zeros((n, len(axes)))
    measured = np.zeros((len(axes), n))
    if axes:
        B = thruster_matrix(robot)
        units = _units(B)
        null_space = left_null_space(B) / units[:, None]
        null_space = null_space @ np.linalg.inv(null_space[axes])
        null_space[np.abs(null_space) < _ROUNDING] = 0.0
        weighted = null_space.T * units**2
        motions[:6] = null_space
        measured[:, :6] = np.linalg.solve(weighted @ null_space, weighted)
    return motions, measured


def without_free_motions(robot: Robot, M: Array, tau: Array) -> Array:
    """Return the generalized force (n_v, 1) [N, N m] that does no work along `free_motions`, for a
    force tau (n_v, 1) and the mass matrix M (n_v, n_v).

    Free motions go on as all other forces have it, and what that takes of driven axes is fed
    forward. M, tau: CasADi's, symbols or numbers.
    """
    motions = symbolic_bodies.sparse(free_motions(robot)[0])
    if not motions.shape[1]:
        return tau
    moved = M @ motions
    return tau - moved @ ca.solve(motions.T @ moved, motions.T @ tau)


def driven_turns(robot: Robot, frame: str) -> tuple[int, ...] | None:
    """Return axes of B (0-2) about which thrusters turn a frame that is fixed to the vehicle;
    `None` where nothing is missing.

    That is where they drive every axis, and for a frame on an arm, whose joints turn it. Raises
    `FrameNotFound`.
    """
    index = robot.frame_id(frame)
    undriven = undriven_axes(robot)
    if not undriven or robot.model.frames[index].parentJoint != 1:
        return None
    return tuple(axis for axis in range(3) if 3 + axis not in undriven)
