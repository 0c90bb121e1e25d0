"""Clearance between balls, for robots and obstacles that a few of them describe, as rows of an optimal control problem."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from uvms_ocp.arguments import Finite, checked
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.robot import Robot
from uvms_ocp.ocp.terms import At, StageSymbols, Term
from uvms_ocp.tasks.task import Residual, TickSymbols, bounded_residual


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Ball:
    """A ball fixed to a frame of the robot or, without a frame, to the world.

    Raises `InvalidInput` for numbers that are not finite, and for a negative radius.
    """

    centre: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    """[m] in the frame."""
    radius: Finite
    """[m]"""
    frame: str | None = None

    def __post_init__(self) -> None:
        if self.radius < 0:
            raise InvalidInput(f"ball at {self.centre}: radius = {self.radius} m; give one >= 0")

    def placed(self, symbols: TickSymbols, centre: ca.SX) -> ca.SX:
        """In W (3,) [m], for a centre (3,) [m] in the frame."""
        if self.frame is None:
            return centre
        R, p = symbols.kinematics.pose(self.frame)
        return p + R @ centre


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class BallClearance(Term):
    """Every ball of the robot stays `margin` away from every obstacle: one row per pair, signed distance [m] >= 0."""

    at: At = At.PATH
    robot_balls: tuple[Ball, ...]
    obstacles: tuple[Ball, ...]
    margin: Finite = 0.05
    """[m]"""

    @property
    def name(self) -> str:
        return "clearance"

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        pairs = [(ball, i) for ball in self.robot_balls for i in range(len(self.obstacles))]
        places = ca.reshape(parameters, 4, len(self.obstacles))
        gaps = [self._gap(ball, self.obstacles[i], places[:, i], stage.tick) for ball, i in pairs]
        return bounded_residual(ca.vertcat(ca.SX(0, 1), *gaps), lower=0.0)

    def _gap(self, ball: Ball, other: Ball, place: ca.SX, symbols: TickSymbols) -> ca.SX:
        d = ball.placed(symbols, ca.SX(ca.DM(ball.centre))) - other.placed(symbols, place[:3])
        return ca.sqrt(ca.sumsqr(d) + 1e-12) - ball.radius - place[3]

    def n_parameters(self, robot: Robot) -> int:
        return 4 * len(self.obstacles)

    def reference(self, t: float) -> np.ndarray:
        """Centre of every obstacle, and its radius with the margin [m]; the same at all times t [s]."""
        return np.array([(*ball.centre, ball.radius + self.margin) for ball in self.obstacles]).ravel()
