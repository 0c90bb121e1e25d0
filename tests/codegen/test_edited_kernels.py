"""Kernels of a module that is edited and loaded again, as in a notebook with autoreload."""

from __future__ import annotations

import importlib
import os
from pathlib import Path

import pytest

from uvms_ocp.codegen.kernel_layout import structure_of
from uvms_ocp.codegen.kernels import make_memory

SOURCE = """from uvms_ocp.codegen.kernel_layout import Layout


class Pair(Layout):
    x: float
    y: float


def step(m: Pair) -> None:
    m.y = {} * m.x
"""


def test_a_kernel_that_is_edited_and_loaded_again_is_the_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "edited_kernel.py"
    monkeypatch.syspath_prepend(tmp_path)
    for k, factor in enumerate((2.5, 4.5)):
        file.write_text(SOURCE.format(factor), encoding="utf-8")
        os.utime(file, (k, k))  # one second apart, as the clock of files tells them
        module = importlib.reload(importlib.import_module("edited_kernel"))
        memory, (step,) = make_memory(structure_of(module.Pair), (module.step,))
        memory.x = 2.0
        step(memory)
        assert memory.y == 2.0 * factor
