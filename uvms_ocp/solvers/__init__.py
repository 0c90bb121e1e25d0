"""Solvers of levels, of lexicographic programs and of QPs of stages: pure maths that knows no robot."""

from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet as LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.cascade import LexicographicQp as LexicographicQp
from uvms_ocp.solvers.hierarchy.icat import Icat as Icat
from uvms_ocp.solvers.hierarchy.level import Level as Level
from uvms_ocp.solvers.hierarchy.solution import Solution as Solution
from uvms_ocp.solvers.hierarchy.solution import Status as Status
from uvms_ocp.solvers.hierarchy.solution import Tick as Tick
from uvms_ocp.solvers.hierarchy.solution import TickResult as TickResult
