"""What the plant feels of its environment at one configuration: water at its links, the floor below its contact points."""

from __future__ import annotations

import math
from collections.abc import Mapping

import casadi as ca
import numpy as np

from uvms_ocp.functions.buffered import BufferedFunction
from uvms_ocp.functions.compile import compile_function
from uvms_ocp.model.spatial import quaternion_to_matrix
from uvms_ocp.model.symbolic.dynamics import SymbolicDynamics
from uvms_ocp.sim.currents import Current, GustyCurrent, OnsetCurrent, StillWater, UniformCurrent, water_at
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.height_field import HeightField
from uvms_ocp.sim.seafloor import FlatSeafloor, ground_at

_NOWHERE = np.zeros((0, 3))
_NEAR = 1.0  # [m] above its highest part the floor is looked at anyhow
_FASTEST = 10.0  # [m/s] no vehicle sinks faster


class Surroundings:
    """Writes the environment where a `StepSequence` reads it. What never changes is written once, by `bind`."""

    def __init__(
        self, environment: Environment, dynamics: SymbolicDynamics, points: np.ndarray, *, compiled: bool = True
    ) -> None:
        """points (n_points, 3) [m]: contact points in B. compiled: unless there is no time for that."""
        self._environment = environment
        self._n_links = len(dynamics.links)
        self._steady = is_steady(environment.current)
        self._uniform = everywhere(environment.current, 0.0) is not None
        floor = environment.seafloor
        self._flat = type(floor) is FlatSeafloor or not len(points)
        self._top = floor.top if type(floor) is HeightField else math.inf
        self._given: Mapping[str, np.ndarray] = {}
        self._sites: BufferedFunction | None = None
        if not (self._uniform and self._flat):
            function = sites_function(dynamics, points)
            self._sites = BufferedFunction(compile_function(function) if compiled else function)

    def bind(self, given: Mapping[str, np.ndarray]) -> None:
        """From now on write into the arrays of `given` (...) [units below]: what `StepSequence` reads.

        Those are u (n_links, 3) [m/s], Du_Dt (n_links, 3) [m/s2], floor_z (n_points,) [m] and floor_normal (n_points, 3) [-];
        the period dt (1,) [s] is read.
        """
        self._given = given
        if self._steady:
            self._feel_water(_NOWHERE, 0.0)
        if self._flat:
            self._feel_floor(np.zeros((len(given["floor_z"]), 3)))

    def sample(self, q: np.ndarray, t: float) -> None:
        """Write what there is at configuration q (n_q,) [m, rad] and time t [s]."""
        sites = _NOWHERE if self._sites is None else self._sites(q)[0].T
        if not self._steady:
            self._feel_water(sites[: self._n_links], t)
        if not self._flat:
            points = sites[self._n_links :]
            if points[:, 2].min() > self._top + _NEAR + _FASTEST * self._given["dt"][0]:
                self._given["floor_z"][:] = self._top  # as much out of reach as all that is below it
            else:
                self._feel_floor(points)

    def _feel_water(self, p_W: np.ndarray, t: float) -> None:
        current, given = self._environment.current, self._given
        flow = everywhere(current, t) if self._uniform else None
        if flow is None:
            water = water_at(current, p_W, t)
            given["u"][:], given["Du_Dt"][:] = water.velocity, water.acceleration
        else:
            given["u"][:], given["Du_Dt"][:] = flow

    def _feel_floor(self, p_W: np.ndarray) -> None:
        given = self._given
        given["floor_z"][:], given["floor_normal"][:] = ground_at(self._environment.seafloor, p_W[:, :2])


def sites_function(dynamics: SymbolicDynamics, points: np.ndarray) -> ca.Function:
    """Function ``q -> p_W (3, n_links + n_points)`` [m]: the links as `SymbolicDynamics.link_positions`, then the points.

    points (n_points, 3) [m]: contact points in B.
    """
    q = ca.SX.sym("q", dynamics.model.nq)
    columns = [dynamics.link_positions(q)]
    if len(points):
        columns += [q[:3] + quaternion_to_matrix(q[3:7]) @ ca.DM(point) for point in points]
    return ca.Function("sites", [q], [ca.densify(ca.horzcat(*columns))], ["q"], ["p_W"], {"cse": True})


def is_steady(current: Current) -> bool:
    """Whether it is known to be the same everywhere and always."""
    return type(current) in (StillWater, UniformCurrent)


def everywhere(current: Current, t: float) -> np.ndarray | None:
    """Velocity [m/s] and its rate [m/s2] (2, 3) at time t [s], where they are known to be the same at all points.

    Raises `InvalidInput` where the current does.
    """
    # Of these very classes: another one that is made of them may differ from place to place.
    if type(current) is GustyCurrent:
        base = everywhere(current.base, t)
        return None if base is None else base + current.gust(t)
    if type(current) is OnsetCurrent:
        return np.multiply.outer(current.growth(t), current.value)
    if type(current) is UniformCurrent:
        return np.array([current.value, np.zeros(3)])
    return np.zeros((2, 3)) if type(current) is StillWater else None
