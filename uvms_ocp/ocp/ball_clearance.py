"""Clearance between balls, for robots and obstacles that a few of them describe, as rows of an
optimal control problem.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import ClassVar

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.node_margins import NodeMargins, Side
from uvms_ocp.ocp.terms import At, StageSymbols, Term
from uvms_ocp.record.meta_values import ObstacleMeta
from uvms_ocp.robot.robot import Robot
from uvms_ocp.tasks.goals import VectorReference, evaluate_vector
from uvms_ocp.tasks.task import Residual, TickSymbols, bounded_residual
from uvms_ocp.types import Finite, Magnitude

_ROUNDING = 1e-12  # [m^2] so that a distance has a slope where centres meet
_MEET = 1e-6  # [m] distance below which centres meet
_UP = np.array([0.0, 0.0, 1.0])
_ASIDE = np.array([0.0, 1.0, 0.0])  # side on which a ball passes that goes straight up


@checked_dataclass(eq=False)
class BallClearance(Term):
    """Every ball of the robot stays `margin` away from every obstacle: one row per pair, signed
    distance [m] >= 0.

    Raises `InvalidInput` for a ball of the robot whose centre moves by itself.
    """

    has_sides: ClassVar[bool] = True
    name = "clearance"
    at: At = At.PATH
    robot_balls: tuple[Ball, ...]
    """Balls of the robot."""
    obstacles: tuple[Ball, ...]
    """Balls that it keeps away from, fixed to the world, to the robot or moving."""
    margin: Finite = 0.05
    """[m] distance to be kept."""

    def __post_init__(self) -> None:
        Term.__post_init__(self)
        if any(callable(ball.centre) for ball in self.robot_balls):
            raise InvalidInput(
                "a ball of the robot has a centre that moves; move its frame, only obstacles move"
                " on their own"
            )

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        places = ca.reshape(parameters[: self._n_places], 4, len(self.obstacles))
        sides = ca.reshape(parameters[self._n_places :], 3, len(self._pairs))
        gaps = []
        for k, (ball, i) in enumerate(self._pairs):
            obstacle = self.obstacles[i]
            gaps.append(self._gap(ball, obstacle, places[:, i], sides[:, k], stage.tick))
        return bounded_residual(ca.vertcat(ca.SX(0, 1), *gaps), lower=0.0)

    def _gap(
        self, ball: Ball, obstacle: Ball, place: ca.SX, side: ca.SX, symbols: TickSymbols
    ) -> ca.SX:
        """Compute the distance [m] of two balls, less the margin.

        With a side (3,), a unit vector in W, the distance along that direction, which is never more
        than the distance itself; a side of 0 stands for none. place (4,) [m]: centre of the
        obstacle, and its radius with the margin.
        """
        centre = ball.placed(symbols, ca.SX(ca.DM(ball.centre_at(0.0))))
        obstacle_centre = obstacle.placed(symbols, place[:3])
        d = centre - obstacle_centre
        distance = ca.sqrt(ca.sumsqr(d) + _ROUNDING)
        centre_distance = (1.0 - ca.sumsqr(side)) * distance + ca.dot(side, d)
        return centre_distance - ball.radius - place[3]

    @property
    def _pairs(self) -> list[tuple[Ball, int]]:
        """Every ball of the robot with the index of every obstacle."""
        return list(product(self.robot_balls, range(len(self.obstacles))))

    @property
    def _n_places(self) -> int:
        """Number of parameters that are places of obstacles; those of sides follow."""
        return 4 * len(self.obstacles)

    def n_parameters(self, robot: Robot) -> int:
        return self._n_places + 3 * len(self._pairs)

    def reference(self, t: float) -> np.ndarray:
        """Return the centre of every obstacle at time t [s], its radius with the margin [m], and no
        sides.
        """
        places = [(*ball.centre_at(t), ball.radius + self.margin) for ball in self.obstacles]
        return np.concatenate([np.array(places).ravel(), np.zeros(3 * len(self._pairs))])

    def references(
        self, times: Sequence[float], q: np.ndarray, tightened: NodeMargins | None = None
    ) -> np.ndarray:
        """Return `reference` at times (n,) [s], with the sides on which nodes pass thin obstacles."""
        result = np.array([self.reference(t) for t in times])
        if tightened is None:
            return result
        for side in tightened.sides:
            begin = self._n_places + 3 * side.row
            result[side.node, begin : begin + 3] = self._direction(tightened.robot, side)
        return result

    def _direction(self, robot: Robot, side: Side) -> np.ndarray:
        """Return the unit vector (3,) in W across the way of the robot's ball past the obstacle, to
        the side where the ball is at the given time; upwards where their centres meet.
        """
        d = self._way_apart(robot, side.row, side.time, side.q)
        way = self._way_apart(robot, side.row, side.later, side.q_later) - d
        length = float(np.linalg.norm(way))
        along = way / length if length > 0.0 else way
        across = d - (d @ along) * along
        if np.linalg.norm(across) < _MEET:
            across = _UP - (_UP @ along) * along
        if np.linalg.norm(across) < _MEET:
            across = _ASIDE
        return np.asarray(across / np.linalg.norm(across))

    def _way_apart(self, robot: Robot, row: int, t: float, q: np.ndarray) -> np.ndarray:
        """Return the way (3,) [m] in W from the obstacle of a pair to the robot's ball, at q (n_q,)
        [m, rad].
        """
        ball, i = self._pairs[row]
        return ball.centre_in_world(robot, q, t) - self.obstacles[i].centre_in_world(robot, q, t)

    def scenery(self, t: float) -> tuple[ObstacleMeta, ...]:
        """Return the balls that are fixed to the world, as they are at time t [s], as spheres;
        radii of 0 have nothing to draw.
        """
        balls = [ball for ball in self.obstacles if ball.frame is None and ball.radius > 0]
        obstacles = []
        for i, ball in enumerate(balls, start=1):
            obstacle = ObstacleMeta(
                name=f"obstacle {i}",
                shape="sphere",
                size=(ball.radius,),
                position=tuple(ball.centre_at(t).tolist()),
            )
            obstacles.append(obstacle)
        return tuple(obstacles)


@checked_dataclass(eq=False)
class Ball:
    """A ball fixed to a frame of the robot or, without a frame, to the world.

    Raises `InvalidInput` for numbers that are not finite, and for a negative radius.
    """

    centre: tuple[Finite, Finite, Finite] | VectorReference = (0.0, 0.0, 0.0)
    """[m] Centre in the frame; of an obstacle also a function of time, ``t -> (position,
    velocity)``.
    """
    radius: Magnitude
    """[m] radius of the ball."""
    frame: str | None = None
    """Name of the robot's frame that the ball is fixed to; `None` for the world."""

    def centre_at(self, t: float) -> np.ndarray:
        """Return the centre (3,) [m] in the frame at time t [s]. Raises `InvalidInput` for a
        reference that is not finite there.
        """
        reference: VectorReference | np.ndarray
        if callable(self.centre):
            reference = self.centre
        else:
            reference = np.array(self.centre, dtype=float)
        centre, _ = evaluate_vector("ball", reference, t)
        if centre.shape != (3,):
            raise InvalidInput(f"ball: centre {centre} at t = {t} s; give three numbers [m]")
        return centre

    def centre_in_world(self, robot: Robot, q: np.ndarray, t: float) -> np.ndarray:
        """Return the centre (3,) [m] in W at q (n_q,) [m, rad], whatever the limits of joints, and
        time t [s].
        """
        centre = self.centre_at(t)
        if self.frame is None:
            return centre
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, q)
        return np.asarray(data.oMf[robot.frame_id(self.frame)].act(centre))

    def placed(self, symbols: TickSymbols, centre: ca.SX) -> ca.SX:
        """Return the centre (3,) [m] in W of a ball whose centre in the frame is (3,) [m]."""
        if self.frame is None:
            return centre
        R, p = symbols.kinematics.pose(self.frame)
        return p + R @ centre
