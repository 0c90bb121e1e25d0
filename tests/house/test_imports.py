"""Importing the package takes no library along that only a few calls need."""

from __future__ import annotations

import subprocess
import sys

import pytest

RARE = ("scipy.stats", "scipy.optimize", "scipy.spatial", "matplotlib", "meshcat")
_CODE = "import sys, uvms_ocp; print(*sys.modules)"


@pytest.fixture(scope="module")
def imported() -> set[str]:
    told = subprocess.run([sys.executable, "-c", _CODE], check=True, capture_output=True, text=True).stdout
    return set(told.split())


@pytest.mark.parametrize("library", RARE)
def test_what_few_calls_need_is_not_imported_at_once(imported: set[str], library: str) -> None:
    assert library not in imported
