"""Pre-flight: can a mission be done, and what has to change if not."""

from uvms_ocp.lazy_names import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
