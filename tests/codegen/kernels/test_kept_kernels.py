"""Kernels whose library is kept are not written as C again, unless something that they are made of
has changed.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest
from compiler import needs_compiler

from uvms_ocp.codegen import kernels
from uvms_ocp.codegen.kernel_layout import structure_of
from uvms_ocp.codegen.kernel_program import c_program, program_content

pytestmark = needs_compiler

NUMBERS = """from enum import IntEnum


class Kind(IntEnum):
    FIRST = {member}


SHIFT = {shift}
"""
CALLED = """def scaled(x: float) -> float:
    return {factor} * x
"""
CALLING = """from __future__ import annotations

import kept_numbers as others
from kept_called import scaled
from kept_numbers import SHIFT

from uvms_ocp.codegen.kernel_layout import Layout

GAIN = {gain}


class Pair(Layout):
    x: float
    y: float


def step(m: Pair) -> None:
    m.y = scaled(GAIN * m.x) + SHIFT + others.Kind.FIRST
"""
GIVEN = {"member": 1, "shift": 0.25, "factor": 2.0, "gain": 3.0}
OTHERS = [{"member": 7}, {"shift": 0.75}, {"factor": 5.0}, {"gain": 11.0}]


def _loaded(folder: Path, **numbers: float) -> ModuleType:
    names = {"kept_numbers": NUMBERS, "kept_called": CALLED, "kept_calling": CALLING}
    for name, text in names.items():
        (folder / f"{name}.py").write_text(text.format(**GIVEN | numbers), encoding="utf-8")
        sys.modules.pop(name, None)
    importlib.invalidate_caches()
    return importlib.import_module("kept_calling")


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., ModuleType]:
    """Modules of other numbers in folders of their own, so that none has the byte code of
    another.
    """
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setenv("UVMS_OCP_CACHE", str(tmp_path / "cache"))
    monkeypatch.syspath_prepend(tmp_path)
    return lambda **numbers: _loaded(tmp_path, **numbers)


def _stepped(module: ModuleType) -> float:
    memory, (step,) = kernels.make_memory(structure_of(module.Pair), (module.step,))
    assert step is not module.step
    memory.x = 1.5
    step(memory)
    return float(memory.y)


def _expected(**numbers: float) -> float:
    n = GIVEN | numbers
    return n["factor"] * (n["gain"] * 1.5) + n["shift"] + n["member"]


def test_what_is_kept_is_not_written_as_c_again(
    load: Callable[..., ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert _stepped(load()) == _expected()
    monkeypatch.setattr(kernels, "c_program", None)
    assert _stepped(load()) == _expected()


@pytest.mark.sampled
@pytest.mark.parametrize("change", OTHERS, ids=lambda change: next(iter(change)))
def test_whatever_a_kernel_is_made_of_makes_another(
    load: Callable[..., ModuleType], change: dict[str, float]
) -> None:
    before = program_content([load().step])
    assert _stepped(load()) == _expected()
    assert program_content([load(**change).step]) != before
    assert _stepped(load(**change)) == _expected(**change)
    assert _stepped(load()) == _expected()


@pytest.mark.parametrize(
    ("module", "name"),
    [("kept_calling", "GAIN"), ("kept_calling", "SHIFT"), ("kept_numbers", "Kind")],
)
def test_a_value_that_is_replaced_in_a_running_program_makes_another(
    load: Callable[..., ModuleType], monkeypatch: pytest.MonkeyPatch, module: str, name: str
) -> None:
    step = load().step
    before = program_content([step])
    assert program_content([step]) == before
    value = 9.5 if name != "Kind" else type("Kind", (), {"FIRST": 9})
    monkeypatch.setattr(sys.modules[module], name, value)
    assert program_content([step]) != before


def test_wide_kernels_are_others(
    load: Callable[..., ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    step = load().step
    before = program_content([step])
    monkeypatch.setattr("uvms_ocp.codegen.kernel_program.WIDE", {step})
    assert program_content([step]) != before


def test_a_file_that_was_edited_under_a_loaded_kernel_makes_another(
    load: Callable[..., ModuleType], tmp_path: Path
) -> None:
    module = load()
    before = program_content([module.step])
    (tmp_path / "kept_called.py").write_text(CALLED.format(factor=123.0), encoding="utf-8")
    edited = program_content([module.step])
    assert edited != before
    assert "123.0" in "".join(c_program([module.step], [structure_of(module.Pair)]))


def test_a_library_that_is_gone_is_made_again(
    load: Callable[..., ModuleType], tmp_path: Path
) -> None:
    assert _stepped(load()) == _expected()
    for path in (tmp_path / "cache").iterdir():
        path.unlink()
    assert _stepped(load()) == _expected()


def test_other_flags_are_another_library(
    load: Callable[..., ModuleType], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    _stepped(load())
    monkeypatch.setenv("UVMS_OCP_CFLAGS", "-DOTHER")
    assert _stepped(load()) == _expected()
    assert len([*(tmp_path / "cache").glob("*.so")]) == 2


@pytest.mark.slow
def test_other_processes_tell_the_same() -> None:
    code = """
from hashlib import sha256
from uvms_ocp.codegen.kernel_program import program_content
from uvms_ocp.control.force import tick
print(sha256(program_content([tick.begin_force, tick.force_step]).encode()).hexdigest())
"""
    contents = {
        subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | {"PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2", "3")
    }
    assert len(contents) == 1
