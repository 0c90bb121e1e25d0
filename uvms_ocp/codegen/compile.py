"""Compile CasADi functions into machine code: at once, or in the background.

Where that cannot be done callers fall back to slower code, which is said once per process: see
`uvms_ocp.codegen.compiler_log`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from multiprocessing.pool import AsyncResult
from pathlib import Path
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.codegen import casadi_code
from uvms_ocp.codegen.background import await_result, start_beside
from uvms_ocp.codegen.c_compiler import has_compiler
from uvms_ocp.codegen.c_text import MATH, PARTS
from uvms_ocp.codegen.cache_entries import code_of, keep, look_up
from uvms_ocp.codegen.compiler_log import LONG
from uvms_ocp.codegen.libraries import compile_library
from uvms_ocp.codegen.loading import ADDRESSES, load_function
from uvms_ocp.progress import progress_bar

_STRAIGHT = (
    "-O1",
    "-fstrict-aliasing",
    "-finline-small-functions",
    "-fno-semantic-interposition",
)
"""Flags for code without loops, which gains nothing from more optimisation but the time that takes."""
_LONG_STRAIGHT = ("-Og", "-finline-small-functions", "-fno-semantic-interposition")
"""Flags for long code without loops: half the time of `_STRAIGHT`."""
_LONG_CODE = 200_000
"""[bytes] from which code is compiled with `_LONG_STRAIGHT`."""
# Numbers of a library: constants of it, or set when it is loaded, and then they stay.
_CONSTANT_NUMBERS = '__attribute__((visibility("hidden"))) extern const double numbers[{n} + 1];\n'
_SET_NUMBERS = """__attribute__((visibility("hidden"))) double numbers[{n} + 1];
void* numbers_address(void) {{ return numbers; }}
"""
_WAITS = ContextVar("waits", default=True)
"""True where a call waits for its machine code; false inside `compiling_beside`."""
_BESIDE = WeakKeyDictionary[ca.Function, tuple[AsyncResult[Path | None], np.ndarray]]()
"""Functions that are being compiled in the background: their library, and their numbers."""


@checked
def compile_function(function: ca.Function) -> ca.Function:
    """Return ``function`` in machine code with the same names and sparsities; itself where it
    cannot be compiled.

    What is returned is of this process: give others ``function``.
    """
    if function in ADDRESSES:
        return function
    begun = _BESIDE.pop(function, None)
    if begun is not None:
        result, numbers = begun
        library = await_result(result)
    else:
        compilation, numbers = _compilation(function)
        library = compilation()
    return load_function(library, function.name(), numbers) or function


@checked
def external_function(name: str, source: str, flags: Sequence[str] = ()) -> ca.Function | None:
    """Return the CasADi function ``name`` that ``source`` defines, compiled; None where that cannot
    be (logged once).
    """
    return load_function(compile_library(source, flags, name), name)


def compiled_symbol(function: ca.Function) -> int | None:
    """Return the address of the machine code of ``function``, for other machine code to call; None
    where it cannot be compiled.

    It is valid as long as ``function``.
    """
    if function in ADDRESSES:
        return ADDRESSES[function][function.name()]
    if not hasattr(function, "machine_code"):
        compiled = compile_function(function)
        if compiled is function:
            return None
        function.machine_code = compiled
    return compiled_symbol(function.machine_code)


def two_calls(function: ca.Function) -> int | None:
    """Return the address of the machine code for two calls of ``function`` at once, once that is
    compiled; None where there is none.
    """
    compiled = getattr(function, "machine_code", function)
    return ADDRESSES.get(compiled, {}).get(casadi_code.TWO_CALLS)


def start_compiling(function: ca.Function, entry: Path | None = None) -> ca.Function:
    """Start to compile a function in the background, and return it: `compile_function` and
    `compiled_symbol` wait for the end.

    entry: file of the cache that will say in which library the function is, with which numbers.
    """
    if not has_compiler():
        return function
    work, numbers = _compilation(function)
    if entry is not None:
        work = partial(keep, entry, numbers, work)
    _BESIDE[function] = (start_beside(work), numbers)
    return function


def compiled_from(
    name: str, content: str, make: Callable[[], ca.Function], *modules: str
) -> ca.Function:
    """Return the function of that name which `make` makes, compiled in the background as by
    `start_compiling`.

    Where it was compiled before it is not made at all: the cache keeps in which library it is, and
    with which numbers. content: all that the function depends on but CasADi, the compiler, and the
    files `modules` of the code that `make` runs.
    """
    entry, cached = look_up(name, content, *modules)
    if cached:
        library, numbers = cached
        function = load_function(library, name, numbers)
        if function:
            return function
    return start_compiling(make(), entry)


@contextmanager
def compiling_beside(in_background: bool) -> Iterator[None]:
    """Let `available_function` wait for no compiler in the block, unless
    ``UVMS_OCP_WAIT_FOR_COMPILER`` is set.
    """
    is_wait_required = os.environ.get("UVMS_OCP_WAIT_FOR_COMPILER", "0") not in {"", "0"}
    previous = _WAITS.set(not in_background or is_wait_required)
    try:
        yield
    finally:
        _WAITS.reset(previous)


def waits_for_compiler() -> bool:
    """Tell whether machine code is waited for, as it is outside of `compiling_beside`."""
    return _WAITS.get()


def is_being_compiled(function: ca.Function) -> bool:
    """Check for machine code that is not there yet, but will be."""
    begun = _BESIDE.get(function)  # once: other threads take them from there
    return begun is not None and not begun[0].ready()


def available_function(function: ca.Function) -> ca.Function:
    """Return `compile_function` of a function, or inside `compiling_beside` the function itself
    while it is being compiled.
    """
    if waits_for_compiler() or not is_being_compiled(function):
        return compile_function(function)
    _BESIDE.pop(function, None)
    return function


def finish_compiling() -> None:
    """Wait for all that was begun, and show how far that is."""
    with progress_bar(total=len(_BESIDE), desc="compiling", unit="function", delay=LONG) as bar:
        for function in list(_BESIDE):
            compiled_symbol(function)
            bar.update()


def _compilation(function: ca.Function) -> tuple[Callable[[], Path | None], np.ndarray]:
    """Return the work of compiling a function, for any thread, and its numbers; CasADi writes the
    code here.
    """
    generator = ca.CodeGenerator("function.c", {"verbose": False})
    generator.add(function)
    form, numbers = casadi_code.without_numbers(generator.dump())
    comment = f"/* {code_of(casadi_code.__file__)} */\n"
    declaration = _CONSTANT_NUMBERS.format(n=len(numbers))
    source = comment + MATH + PARTS + declaration + form
    flags = _STRAIGHT if len(form) < _LONG_CODE else _LONG_STRAIGHT
    definition = _SET_NUMBERS.format(n=len(numbers))
    work = partial(
        compile_library, source, flags, function.name(), (definition,), casadi_code.in_parts
    )
    return work, numbers


if sys.platform != "win32":
    # What is being compiled is finished by the threads of the parent, which a fork has none of.
    os.register_at_fork(after_in_child=_BESIDE.clear)
