"""Task-priority planning and optimal control of underwater vehicle-manipulator systems.

Public names and subpackages, each loaded when it is first asked for (``__init__.pyi`` lists them); notation and frames:
`uvms_ocp.robot.spatial`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
