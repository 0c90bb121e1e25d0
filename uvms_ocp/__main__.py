"""``python -m uvms_ocp``."""

from __future__ import annotations

from uvms_ocp.cli.commands import main

main()
