"""Equation error: linear least squares of the wrench on the regressor of the inverse dynamics.

``tau = Y(q, v, a) phi + rest``: phi holds the rigid body's mass, first and second moments of mass,
and the water's added mass, drag, displaced mass and its first moment, for one link. A start for
output error, and a first look at what recordings determine. Accelerations are derivatives of what
was measured, smoothed over a window; noise in them pulls parameters towards zero, as it does in
every fit of this kind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.identification.model import PAST, PAST_STEP, Vehicle, stage_of
from uvms_ocp.identification.parameters import AXES
from uvms_ocp.identification.resampling import smoothed
from uvms_ocp.identification.segments import PreparedRecording
from uvms_ocp.robot.spatial import skew
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics, WaterCoefficients
from uvms_ocp.robot.symbolic_model import function

# Inverse dynamics as a matrix times what it is linear in, by differentiation of the symbolic
# dynamics.
#
# ``tau = Y(q, v, a) phi + rest``: phi holds the rigid body's mass, first and second moments of
# mass, and the water's added mass, drag, displaced mass and its first moment, for one link; the
# rest is what other links do.

_MOMENTS = ("xx", "yy", "zz", "xy", "xz", "yz")
_PLACES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_LOWER = tuple((i, j) for i in range(6) for j in range(i + 1))
_ALL = tuple((i, j) for i in range(6) for j in range(6))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Regressor:
    """Regressor of the link and the joint body that carries it."""

    names: tuple[str, ...]
    """Names of the entries of phi."""
    phi: np.ndarray
    """(n,) [kg, kg m, kg m2, and the units of drag] of the model itself."""
    matrix: ca.Function
    """``q, v, a, u, Du_Dt -> Y (n_v, n)``, with water as in `SymbolicDynamics`."""


def regressor_of(dynamics: SymbolicDynamics, link: int = 0) -> Regressor:
    """Build the regressor of a link, given by its place in ``links``."""
    n_v = dynamics.model.nv
    n_links = len(dynamics.links)
    shapes = {
        "q": (dynamics.model.nq, 1),
        "v": (n_v, 1),
        "a": (n_v, 1),
        "u": (3, n_links),
        "Du_Dt": (3, n_links),
    }
    given = {name: ca.SX.sym(name, *shape) for name, shape in shapes.items()}
    phi = ca.SX.sym("phi", len(_names()))
    known = _nominal(dynamics, link)
    tau = _with(dynamics, link, phi).inverse_dynamics(*given.values())
    # It does not depend on phi but for a quotient that cancels: it is taken where that is a number.
    Y = ca.substitute(ca.jacobian(tau, phi), phi, ca.DM(known))
    return Regressor(names=_names(), phi=known, matrix=function("regressor", given, {"Y": Y}))


def _names() -> tuple[str, ...]:
    body = (
        "mass",
        *(f"first moment {axis}" for axis in "xyz"),
        *(f"inertia {moment}" for moment in _MOMENTS),
    )
    added = (f"added mass {AXES[i]}-{AXES[j]}" for i, j in _LOWER)
    drag = (f"{kind} drag {AXES[i]}-{AXES[j]}" for kind in ("linear", "quadratic") for i, j in _ALL)
    return (
        *body,
        *added,
        *drag,
        "displaced mass",
        *(f"first moment of displaced mass {axis}" for axis in "xyz"),
    )


def _with(dynamics: SymbolicDynamics, link: int, phi: ca.SX) -> SymbolicDynamics:
    body, added, linear, quadratic, displaced = ca.vertsplit(phi, [0, 10, 31, 67, 103, 107])
    inertia = _symmetric(body[4:], _PLACES, 3)
    first = skew(body[1:4])
    rigid = ca.vertcat(ca.horzcat(body[0] * ca.SX.eye(3), -first), ca.horzcat(first, inertia))
    water = WaterCoefficients(
        added_mass=_symmetric(added, _LOWER, 6),
        linear_drag=ca.reshape(linear, 6, 6).T,
        quadratic_drag=ca.reshape(quadratic, 6, 6).T,
        displaced_mass=displaced[0],
        p_LB=displaced[1:] / displaced[0],
    )
    return dynamics.with_coefficients(rigid={dynamics.joint_of(link): rigid}, links={link: water})


def _nominal(dynamics: SymbolicDynamics, link: int) -> np.ndarray:
    body = dynamics.model.inertias[dynamics.joint_of(link)].matrix()
    wet = dynamics.links[link]
    first = [body[5, 1], body[3, 2], body[4, 0]]
    displaced = max(dynamics.density * wet.volume, np.finfo(float).tiny)
    return np.concatenate(
        [
            [body[0, 0], *first, *(body[3 + i, 3 + j] for i, j in _PLACES)],
            [wet.added_mass[i, j] for i, j in _LOWER],
            wet.linear_drag.ravel(),
            wet.quadratic_drag.ravel(),
            displaced * np.array([1.0, *wet.p_LB]),
        ]
    )


def _symmetric(entries: ca.SX, places: tuple[tuple[int, int], ...], n: int) -> ca.SX:
    matrix = ca.SX(n, n)
    for k, (i, j) in enumerate(places):
        matrix[i, j] = matrix[j, i] = entries[k]
    return matrix


# Equation error: the regressor times the parameters is the wrench of the actuators, in the sense of
# least squares.
#
# A start for output error, and a look at what recordings determine at all. Accelerations are
# derivatives of what was measured, smoothed over a window; noise in them pulls parameters towards
# zero, as it does in every fit of this kind. The wrench is that of the actuators as they are
# declared, gains, lag and delay included.

_EVERY = 2  # of the uniform samples


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LinearFit:
    """Parameters of a regressor; those that were not asked for are as the model has them."""

    names: tuple[str, ...]
    phi: np.ndarray
    """(k,) [as `Regressor.phi`] of those that were asked for."""
    sigma: np.ndarray
    """(k,) [as `Regressor.phi`] standard errors, from residuals taken as white."""
    explained: np.ndarray
    """(6,) share of each row's squares, beyond what the other parameters give, that they
    explain.
    """
    weakest: tuple[tuple[str, float], ...]
    """The combination that is determined least, of parameters in their standard units."""
    condition: float
    """Condition number of the regressor with columns of length 1."""


def fit_equation_error(
    vehicle: Vehicle,
    recordings: Sequence[PreparedRecording],
    names: Sequence[str],
    window: float = 0.6,
) -> LinearFit:
    """Fit the named parameters of the regressor to recordings of a vehicle without joints; window
    [s].

    Raises NameNotFound for a parameter that there is not, and InvalidInput for a vehicle with
    joints.
    """
    if vehicle.dynamics.model.nv != 6:
        raise InvalidInput(
            "a vehicle with joints given; equation error takes one without, output error any"
        )
    regressor = regressor_of(vehicle.dynamics, vehicle.link)
    for name in names:
        if name not in regressor.names:
            raise NameNotFound("parameter", name, regressor.names)
    columns = [regressor.names.index(name) for name in names]
    rows = [_rows(vehicle, regressor, recording, window) for recording in recordings]
    Y, tau = np.concatenate([Y for Y, _ in rows]), np.concatenate([tau for _, tau in rows])
    others = np.setdiff1d(np.arange(len(regressor.phi)), columns)
    return _solved(tuple(names), Y[:, :, columns], tau - Y[:, :, others] @ regressor.phi[others])


def _rows(
    vehicle: Vehicle, regressor: Regressor, one: PreparedRecording, window: float
) -> tuple[np.ndarray, np.ndarray]:
    """Regressors (m, 6, n) and wrenches (m, 6) where everything is known."""
    attitude = one.recording.channel("attitude")
    t, v, a = _motion(one, window)
    turn = np.array([np.interp(t, attitude.undelayed_t, column) for column in attitude.values.T])
    q = np.vstack([np.zeros((3, len(t))), turn / np.linalg.norm(turn, axis=0)])
    still = np.zeros((3, len(vehicle.dynamics.links) * len(t)))
    many = np.asarray(regressor.matrix.map(len(t))(q, v.T, a.T, still, still))
    return many.reshape(6, len(t), -1).transpose(1, 0, 2), _wrench(vehicle, one, t)


def _motion(one: PreparedRecording, window: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (m,), velocities and accelerations (m, 6) in B."""
    channels = one.recording.channel("linear_velocity"), one.rate
    begin, end = one.recording.span
    collected = []
    for channel in channels:
        t, values = smoothed(channel.undelayed_t, channel.values, window)
        collected.append(
            (t, values, smoothed(channel.undelayed_t, channel.values, window, derivative=1)[1])
        )
    times = collected[0][0][::_EVERY]
    times = times[(times > begin + window) & (times < end - window) & (times < collected[1][0][-1])]
    v, a = (
        np.column_stack(
            [np.interp(times, part[0], column) for part in collected for column in part[k].T]
        )
        for k in (1, 2)
    )
    return times, v, a


def _wrench(vehicle: Vehicle, one: PreparedRecording, t: np.ndarray) -> np.ndarray:
    stage = stage_of(vehicle)
    p = np.concatenate([vehicle.shared.start, vehicle.per_recording.start])
    values = vehicle.values(ca.SX(ca.DM(p)))
    late = float(np.asarray(stage.delays(p)[0])[0, 0])
    edges = np.arange(t[0] - late - PAST * PAST_STEP, t[-1] - late + PAST_STEP, PAST_STEP)
    held = one.commands.mean(edges)
    pasts = np.hstack([held[k : k + PAST].T for k in range(len(held) - PAST + 1)])
    many = stage.begun.map(len(held) - PAST + 1)
    given = np.asarray(many(pasts, np.repeat(p[:, None], len(held) - PAST + 1, axis=1))[0])
    bias = np.asarray(ca.DM(values["bias"] + values["wrench_offset"]))
    wrench = vehicle.actuators.wrench @ given + bias
    return np.column_stack([np.interp(t, edges[PAST:] + late, row) for row in wrench])


def _solved(names: tuple[str, ...], Y: np.ndarray, tau: np.ndarray) -> LinearFit:
    """Weighted by what each row leaves, twice."""
    sigma = tau.std(axis=0) + 1e-12
    for _ in range(3):
        A = (Y / sigma[:, None]).reshape(-1, len(names))
        b = (tau / sigma).ravel()
        length = np.linalg.norm(A, axis=0) + 1e-300
        U, s, Vt = np.linalg.svd(A / length, full_matrices=False)
        phi = (Vt.T @ ((U.T @ b) / np.maximum(s, 1e-9 * s[0]))) / length
        left = tau - Y @ phi
        sigma = left.std(axis=0) + 1e-12
    errors = np.sqrt((Vt.T**2 / np.maximum(s, 1e-9 * s[0]) ** 2).sum(axis=1)) / length
    order = np.argsort(-np.abs(Vt[-1]))
    return LinearFit(
        names=names,
        phi=phi,
        sigma=errors,
        explained=1.0 - (left**2).sum(axis=0) / (tau**2).sum(axis=0),
        weakest=tuple((names[i], float(Vt[-1, i])) for i in order if abs(Vt[-1, i]) > 0.1),
        condition=float(s[0] / max(s[-1], 1e-300)),
    )
