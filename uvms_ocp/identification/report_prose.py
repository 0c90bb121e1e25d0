"""Texts of the reports of an identification."""

from __future__ import annotations

from importlib.resources import files

import tomllib

PROSE = tomllib.loads(
    (files("uvms_ocp.identification") / "report.toml").read_text(encoding="utf-8")
)
"""By name, with places for numbers."""
