"""Identify the numbers of a vehicle from its own recordings.

Data flows one way: recordings (`reading`, `data_quality`) -> `parameters` (physically consistent at
any value) -> `model` (one step of the vehicle, from the symbolic dynamics) -> `output_error` (the
fit) -> `uncertainty`, `validation` -> `results`. `experiment_design` goes the other way: from
numbers to be identified to commands that excite them.
"""

from uvms_ocp.lazy_names import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
