from .ball_clearance import Ball as Ball, BallClearance as BallClearance
from .plan import OcpStatus as OcpStatus, Plan as Plan
from .planner import Planner as Planner, plan as plan
from .problem import (
    Actuation as Actuation,
    HessianKind as HessianKind,
    Integrator as Integrator,
    OcpLevel as OcpLevel,
    OcpPhase as OcpPhase,
    OcpProblem as OcpProblem,
    single_phase as single_phase,
)
from .request import OcpRequest as OcpRequest, OcpResult as OcpResult, solve_ocp as solve_ocp
from .shape_clearance import ShapeClearance as ShapeClearance
from .terms import (
    At as At,
    AtRest as AtRest,
    Duration as Duration,
    Effort as Effort,
    Energy as Energy,
    Posture as Posture,
    Smoothness as Smoothness,
    TaskTerm as TaskTerm,
    Term as Term,
    residual_term as residual_term,
)
from .trajectory import (
    Trajectory as Trajectory,
    guess_through as guess_through,
    hold_guess as hold_guess,
)
from .verdict import judge_motion as judge_motion
