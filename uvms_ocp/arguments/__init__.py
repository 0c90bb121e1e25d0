"""Annotations of public signatures in, wrong arguments named at the call that takes them.

`checked` looks at every argument before the call; `late` is for what runs at every tick: it looks only after a call has
failed, so that a right one costs next to nothing. Both read the annotations, once, when they are first needed. `trusted`
is for the loop, which makes the same values at every tick as users do at times.

Pydantic's `validate_call` is quicker than `checked` (slower than `late`), but takes arrays, CasADi's and Pinocchio's values
by their class alone, without shapes and entries, and "1.5" and True for numbers. Its messages have several lines: all that
`kinds` knows would have to be written again, as its validators.
"""

from uvms_ocp.arguments.checked import checked as checked
from uvms_ocp.arguments.checked import late as late
from uvms_ocp.arguments.extents import Range as Range
from uvms_ocp.arguments.extents import Shape as Shape
from uvms_ocp.arguments.names import DAY as DAY
from uvms_ocp.arguments.names import AtLeastOne as AtLeastOne
from uvms_ocp.arguments.names import Bound as Bound
from uvms_ocp.arguments.names import Count as Count
from uvms_ocp.arguments.names import Finite as Finite
from uvms_ocp.arguments.names import Magnitude as Magnitude
from uvms_ocp.arguments.names import Period as Period
from uvms_ocp.arguments.names import Point as Point
from uvms_ocp.arguments.names import Positive as Positive
from uvms_ocp.arguments.names import Vector3 as Vector3
from uvms_ocp.arguments.trusted import changed as changed
from uvms_ocp.arguments.trusted import trusted as trusted
from uvms_ocp.arguments.trusted import unchecked as unchecked
