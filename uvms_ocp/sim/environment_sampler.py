"""Sample the environment of a plant at one configuration: water at its links, the floor below its
contact points.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import casadi as ca
import numpy as np

from uvms_ocp.codegen import BufferedFunction, compile_function
from uvms_ocp.robot.spatial import quaternion_to_matrix
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics
from uvms_ocp.sim.currents import water_at
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.rough_seafloor import HeightField
from uvms_ocp.sim.seafloor import FlatSeafloor, ground_at

_NOWHERE = np.zeros((0, 3))
_MARGIN = 1.0  # [m] height over the top of the floor below which the floor is sampled
_FASTEST = 10.0  # [m/s] no vehicle sinks faster


class EnvironmentSampler:
    """Writes water and floor at a configuration into the arrays that the plant's kernel reads.

    A steady current and a flat floor are written once, by `bind`.
    """

    _outputs: Mapping[str, np.ndarray]

    def __init__(
        self,
        environment: Environment,
        dynamics: SymbolicDynamics,
        points: np.ndarray,
        *,
        compiled: bool = True,
    ) -> None:
        """points (n_points, 3) [m]: contact points in B. compiled: compile the positions of links
        and points to machine code.
        """
        self._environment = environment
        self._n_links = len(dynamics.links)
        self._steady = environment.current.is_steady
        self._uniform = environment.current.uniform_flow(0.0) is not None
        floor = environment.seafloor
        self._flat = type(floor) is FlatSeafloor or not len(points)
        self._top = floor.top if type(floor) is HeightField else math.inf
        self._sites: BufferedFunction | None = None
        if not (self._uniform and self._flat):
            function = sites_function(dynamics, points)
            if compiled:
                function = compile_function(function)
            self._sites = BufferedFunction(function)

    @property
    def changes(self) -> bool:
        """True where water or floor differ from time to time or place to place, so that `sample` is
        needed.
        """
        return not (self._steady and self._flat)

    def bind(self, **outputs: np.ndarray) -> None:
        """Write from now on into the arrays u (n_links, 3) [m/s], Du_Dt (n_links, 3) [m/s2],
        floor_z (n_points,) [m] and floor_normal (n_points, 3), which the plant reads.
        """
        self._outputs = outputs
        if self._steady:
            self._sample_water(_NOWHERE, 0.0)
        if self._flat:
            self._sample_floor(np.zeros((len(outputs["floor_z"]), 3)))

    def sample(self, q: np.ndarray, t: float, dt: float) -> None:
        """Write the water and the floor at configuration q (n_q,) [m, rad] and time t [s], for the
        next dt [s].
        """
        sites = _NOWHERE
        if self._sites is not None:
            (p_W,) = self._sites(q)
            sites = p_W.reshape(3, -1).T  # a single site comes as (3,)
        if not self._steady:
            self._sample_water(sites[: self._n_links], t)
        if self._flat:
            return
        points = sites[self._n_links :]
        if points[:, 2].min() > self._top + _MARGIN + _FASTEST * dt:
            # No point reaches the floor within dt: its top stands for all heights.
            self._outputs["floor_z"][:] = self._top
        else:
            self._sample_floor(points)

    def _sample_water(self, p_W: np.ndarray, t: float) -> None:
        """Write the water at positions p_W (n_links, 3) [m] and time t [s]."""
        current = self._environment.current
        outputs = self._outputs
        flow = current.uniform_flow(t) if self._uniform else None
        if flow is None:
            water = water_at(current, p_W, t)
            outputs["u"][:] = water.velocity
            outputs["Du_Dt"][:] = water.acceleration
        else:
            outputs["u"][:], outputs["Du_Dt"][:] = flow

    def _sample_floor(self, p_W: np.ndarray) -> None:
        """Write heights and normals of the floor below points p_W (n_points, 3) [m]."""
        heights, normals = ground_at(self._environment.seafloor, p_W[:, :2])
        self._outputs["floor_z"][:] = heights
        self._outputs["floor_normal"][:] = normals


def sites_function(dynamics: SymbolicDynamics, points: np.ndarray) -> ca.Function:
    """Build the function ``q -> p_W (3, n_links + n_points)`` [m]: positions of the links, where
    the water acts on them, then of the points.

    points (n_points, 3) [m]: contact points in B.
    """
    q = ca.SX.sym("q", dynamics.model.nq)
    columns = [dynamics.link_positions(q)]
    for point in points:
        columns.append(q[:3] + quaternion_to_matrix(q[3:7]) @ ca.DM(point))
    p_W = ca.densify(ca.horzcat(*columns))
    return ca.Function("sites", [q], [p_W], ["q"], ["p_W"], {"cse": True})
