"""Task-priority planning and optimal control of underwater vehicle-manipulator systems.

Public names and subpackages, each loaded when it is first asked for (``__init__.pyi`` lists them);
notation and frames: `uvms_ocp.robot.spatial`.
"""

from uvms_ocp.lazy_names import attach_stub

_load, __dir__, __all__ = attach_stub(__name__, __file__)
_RENAMED = {
    "scenarios": "scenario"
}  # campaigns keep the missions that they were begun with, and run them again


def __getattr__(name: str) -> object:
    name = _RENAMED.get(name, name)
    if name not in __dir__():
        from difflib import get_close_matches

        nearest = get_close_matches(name, __dir__(), n=1)
        hint = f"; did you mean {nearest[0]!r}?" if nearest else ""
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")
    return _load(name)
