"""Environment of the robot, floor, water and obstacles: sampled for the plant, and the closest
approach to it in a run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Annotated

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.codegen import BufferedFunction, compile_function
from uvms_ocp.robot.robot import Robot, require_normalized
from uvms_ocp.robot.shapes.collision_model import CollisionModel
from uvms_ocp.robot.shapes.obstacles import Obstacle, require_distinct_names
from uvms_ocp.robot.spatial import quaternion_to_matrix
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics
from uvms_ocp.sim.currents import Current, StillWater, water_at
from uvms_ocp.sim.seafloor import FlatSeafloor, HeightField, Seafloor, floor_obstacle, ground_at
from uvms_ocp.types import Positive, Shape

# What surrounds the robot: floor, water and obstacles.


@checked_dataclass(eq=False)
class Environment:
    """Everything that is not the robot. Raises `InvalidInput` for two obstacles of the same
    name.
    """

    seafloor: Seafloor
    """Everywhere below."""
    current: Current = field(default_factory=StillWater)
    """Current of the water."""
    obstacles: tuple[Obstacle, ...] = ()
    """With names of their own."""

    def __post_init__(self) -> None:
        require_distinct_names(self.obstacles)


# What the plant feels of its environment at one configuration: water at its links, the floor below
# its contact points.

_NOWHERE = np.zeros((0, 3))
_NEAR = 1.0  # [m] above its highest part the floor is looked at anyhow
_FASTEST = 10.0  # [m/s] no vehicle sinks faster


class EnvironmentSampler:
    """Writes the environment where the plant's kernel reads it. What never changes is written once,
    by `bind`.
    """

    _given: Mapping[str, np.ndarray]

    def __init__(
        self,
        environment: Environment,
        dynamics: SymbolicDynamics,
        points: np.ndarray,
        *,
        compiled: bool = True,
    ) -> None:
        """Points (n_points, 3) [m]: contact points in B. compiled: unless there is no time for
        that.
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
            self._sites = BufferedFunction(compile_function(function) if compiled else function)

    @property
    def changes(self) -> bool:
        """The environment is to be sampled, as it is another one at other times or places."""
        return not (self._steady and self._flat)

    def bind(self, **given: np.ndarray) -> None:
        """Write from now on into arrays, which the plant reads.

        Those are u (n_links, 3) [m/s], Du_Dt (n_links, 3) [m/s2], floor_z (n_points,) [m] and
        floor_normal (n_points, 3).
        """
        self._given = given
        if self._steady:
            self._sample_water(_NOWHERE, 0.0)
        if self._flat:
            self._sample_floor(np.zeros((len(given["floor_z"]), 3)))

    def sample(self, q: np.ndarray, t: float, dt: float) -> None:
        """Write what there is at configuration q (n_q,) [m, rad] and time t [s], for the next dt
        [s].
        """
        if self._sites is None:
            sites = _NOWHERE
        else:
            sites = self._sites(q)[0].T
        if not self._steady:
            self._sample_water(sites[: self._n_links], t)
        if not self._flat:
            points = sites[self._n_links :]
            if points[:, 2].min() > self._top + _NEAR + _FASTEST * dt:
                self._given["floor_z"][:] = (
                    self._top
                )  # as much out of reach as all that is below it
            else:
                self._sample_floor(points)

    def _sample_water(self, p_W: np.ndarray, t: float) -> None:
        current = self._environment.current
        outputs = self._given
        if self._uniform:
            flow = current.uniform_flow(t)
        else:
            flow = None
        if flow is None:
            water = water_at(current, p_W, t)
            outputs["u"][:] = water.velocity
            outputs["Du_Dt"][:] = water.acceleration
        else:
            outputs["u"][:], outputs["Du_Dt"][:] = flow

    def _sample_floor(self, p_W: np.ndarray) -> None:
        outputs = self._given
        outputs["floor_z"][:], outputs["floor_normal"][:] = ground_at(
            self._environment.seafloor, p_W[:, :2]
        )


def sites_function(dynamics: SymbolicDynamics, points: np.ndarray) -> ca.Function:
    """Function ``q -> p_W (3, n_links + n_points)`` [m]: the links as
    `SymbolicDynamics.link_positions`, then the points.

    points (n_points, 3) [m]: contact points in B.
    """
    q = ca.SX.sym("q", dynamics.model.nq)
    columns = [dynamics.link_positions(q)]
    if len(points):
        columns += [q[:3] + quaternion_to_matrix(q[3:7]) @ ca.DM(point) for point in points]
    return ca.Function(
        "sites", [q], [ca.densify(ca.horzcat(*columns))], ["q"], ["p_W"], {"cse": True}
    )


# How near a robot came to the floor, to obstacles and to itself during a run.

_AROUND = 4.0  # [m] of floor beyond the vehicle's track


@checked_dataclass()
class ClosestApproach:
    """The smallest distance over a run; 0 or less is contact."""

    distance: float
    """[m], infinite where there are no two shapes."""
    row: int
    """Row of the configurations given."""
    pair: str
    """Names of the two shapes; empty where there are none."""


@checked
def closest_approach(
    robot: Robot,
    environment: Environment,
    q: Annotated[np.ndarray, Shape("n", "robot.n_q")],
    *,
    self_collision: bool = False,
    floor: bool = True,
    spacing: Positive = 0.25,
    links: Sequence[str] | None = None,
) -> ClosestApproach:
    """The closest approach of the whole robot to the floor and all obstacles over configurations q
    (n, n_q) [m, rad].

    floor: count it, which a robot that has landed touches. spacing [m] of the mesh for a floor that
    is not flat. links: names of the shapes that count, as of an arm (`Robot.arm_shapes`), all by
    default. Raises `InvalidInput` for others.
    """
    require_normalized(robot.model, q)
    if robot.n_vehicle:
        track = q[:, :2]
    else:
        track = np.zeros((len(q), 2))
    obstacles = list(environment.obstacles)
    if floor:
        low = track.min(axis=0) - _AROUND
        high = track.max(axis=0) + _AROUND
        x, y = (0.5 * (low + high)).tolist()
        extent = float((high - low).max())
        obstacles.append(
            floor_obstacle(environment.seafloor, centre=(x, y), extent=extent, spacing=spacing)
        )
    model = CollisionModel(robot, obstacles, self_collision=self_collision, links=links)
    distances = np.array([model.values(row) for row in q]).reshape(len(q), model.n_pairs)
    if not distances.size:
        return ClosestApproach(distance=np.inf, row=0, pair="")
    row, pair = np.unravel_index(int(np.argmin(distances)), distances.shape)
    return ClosestApproach(
        distance=float(distances[row, pair]), row=int(row), pair=model.pair_names[pair]
    )
