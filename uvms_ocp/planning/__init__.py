"""Ahead of time: optimal control with strict priorities."""

from uvms_ocp.planning.ocp import Actuation as Actuation
from uvms_ocp.planning.ocp import HessianKind as HessianKind
from uvms_ocp.planning.ocp import Integrator as Integrator
from uvms_ocp.planning.ocp import OcpLevel as OcpLevel
from uvms_ocp.planning.ocp import OcpPhase as OcpPhase
from uvms_ocp.planning.ocp import OcpProblem as OcpProblem
from uvms_ocp.planning.ocp import single_phase as single_phase
from uvms_ocp.planning.plan import Plan as Plan
from uvms_ocp.planning.plan import PlanStatus as PlanStatus
from uvms_ocp.planning.planner import Planner as Planner
from uvms_ocp.planning.planner import plan as plan
from uvms_ocp.planning.terms import At as At
from uvms_ocp.planning.terms import AtRest as AtRest
from uvms_ocp.planning.terms import Ball as Ball
from uvms_ocp.planning.terms import BallClearance as BallClearance
from uvms_ocp.planning.terms import Duration as Duration
from uvms_ocp.planning.terms import Effort as Effort
from uvms_ocp.planning.terms import Energy as Energy
from uvms_ocp.planning.terms import Smoothness as Smoothness
from uvms_ocp.planning.terms import TaskTerm as TaskTerm
from uvms_ocp.planning.terms import Term as Term
from uvms_ocp.planning.trajectory import Trajectory as Trajectory
from uvms_ocp.planning.trajectory import hold as hold
from uvms_ocp.planning.trajectory import through as through
