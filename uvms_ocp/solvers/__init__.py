"""Pure maths: levels in, solution out; no robot."""

from uvms_ocp.solvers.active_set import LexicographicActiveSet as LexicographicActiveSet
from uvms_ocp.solvers.cascade import LexicographicQp as LexicographicQp
from uvms_ocp.solvers.daqp import Daqp as Daqp
from uvms_ocp.solvers.icat import Icat as Icat
from uvms_ocp.solvers.level import Level as Level
from uvms_ocp.solvers.solution import Solution as Solution
from uvms_ocp.solvers.solution import Status as Status
from uvms_ocp.solvers.tick import Tick as Tick
from uvms_ocp.solvers.tick import TickResult as TickResult
