"""Metrics and reports of one run, read from its `Record` alone, of two runs side by side, and of
plans.
"""

from uvms_ocp.lazy_names import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
