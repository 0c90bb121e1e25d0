"""Clearance between balls, for robots and obstacles that a few of them describe, as rows of an optimal
control problem.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.terms import At, StageSymbols, Term
from uvms_ocp.record.meta_values import ObstacleMeta
from uvms_ocp.robot.robot import Robot
from uvms_ocp.tasks.goals import VectorReference, evaluate_vector
from uvms_ocp.tasks.task import Residual, TickSymbols, bounded_residual
from uvms_ocp.types import Finite, Magnitude


@checked_dataclass(eq=False)
class BallClearance(Term):
    """Every ball of the robot stays `margin` away from every obstacle: one row per pair, signed
    distance [m] >= 0.

    Raises `InvalidInput` for a ball of the robot whose centre moves by itself.
    """

    name = "clearance"
    at: At = At.PATH
    robot_balls: tuple[Ball, ...]
    obstacles: tuple[Ball, ...]
    margin: Finite = 0.05
    """[m]"""

    def __post_init__(self) -> None:
        Term.__post_init__(self)
        if any(callable(ball.centre) for ball in self.robot_balls):
            raise InvalidInput(
                "a ball of the robot has a centre that moves; move its frame, only obstacles move"
                " on their own"
            )

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        pairs = [(ball, i) for ball in self.robot_balls for i in range(len(self.obstacles))]
        places = ca.reshape(parameters, 4, len(self.obstacles))
        gaps = [self._gap(ball, self.obstacles[i], places[:, i], stage.tick) for ball, i in pairs]
        return bounded_residual(ca.vertcat(ca.SX(0, 1), *gaps), lower=0.0)

    def _gap(self, ball: Ball, other: Ball, place: ca.SX, symbols: TickSymbols) -> ca.SX:
        d = ball.placed(symbols, ca.SX(ca.DM(ball.centre_at(0.0)))) - other.placed(
            symbols, place[:3]
        )
        return ca.sqrt(ca.sumsqr(d) + 1e-12) - ball.radius - place[3]

    def n_parameters(self, robot: Robot) -> int:
        return 4 * len(self.obstacles)

    def reference(self, t: float) -> np.ndarray:
        """Centre of every obstacle at time t [s], and its radius with the margin [m]."""
        return np.array(
            [(*ball.centre_at(t), ball.radius + self.margin) for ball in self.obstacles]
        ).ravel()

    def scenery(self, t: float) -> tuple[ObstacleMeta, ...]:
        """Return the balls that are fixed to the world, as they are at time t [s], as spheres;
        radii of 0 have nothing to draw.
        """
        balls = [ball for ball in self.obstacles if ball.frame is None and ball.radius > 0]
        return tuple(
            ObstacleMeta(
                name=name,
                shape="sphere",
                size=(ball.radius,),
                position=tuple(ball.centre_at(t).tolist()),
            )
            for name, ball in zip(
                (f"obstacle {i}" for i in range(1, len(balls) + 1)), balls, strict=True
            )
        )


@checked_dataclass(eq=False)
class Ball:
    """A ball fixed to a frame of the robot or, without a frame, to the world.

    Raises `InvalidInput` for numbers that are not finite, and for a negative radius.
    """

    centre: tuple[Finite, Finite, Finite] | VectorReference = (0.0, 0.0, 0.0)
    """[m] in the frame; of an obstacle also a function of time, ``t -> (position, velocity)``."""
    radius: Magnitude
    """[m]"""
    frame: str | None = None

    def centre_at(self, t: float) -> np.ndarray:
        """(3,) [m] in the frame at time t [s]. Raises `InvalidInput` for a reference that is not
        finite there.
        """
        goal = self.centre if callable(self.centre) else np.array(self.centre, dtype=float)
        centre = evaluate_vector("ball", goal, t)[0]
        if centre.shape != (3,):
            raise InvalidInput(f"ball: centre {centre} at t = {t} s; give three numbers [m]")
        return centre

    def placed(self, symbols: TickSymbols, centre: ca.SX) -> ca.SX:
        """In W (3,) [m], for a centre (3,) [m] in the frame."""
        if self.frame is None:
            return centre
        R, p = symbols.kinematics.pose(self.frame)
        return p + R @ centre
