"""The libraries of the extra ``uvms-ocp[mcap]``, imported when a file is written or read."""

from __future__ import annotations

from importlib import import_module

from uvms_ocp.exceptions import NotInstalled


def require_mcap() -> None:
    """Raise `NotInstalled` where any of them is missing."""
    for name in ("foxglove_schemas_protobuf", "mcap", "mcap_protobuf"):
        try:
            import_module(name)
        except ImportError:
            raise NotInstalled("an MCAP file", '"uvms-ocp[mcap]"') from None
