"""What is written as C does what Python does, from the same memory."""

from __future__ import annotations

import ctypes
import math
import re
import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
from compiler import COMPILER, needs_compiler
from sample_kernels import Memory, Motion, advance, tick

from uvms_ocp.codegen.casadi_code import without_numbers
from uvms_ocp.codegen.kernel_layout import structure_of
from uvms_ocp.codegen.kernels import c_library, initial_value

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wno-unused-parameter")


def run_c(folder: Path, sources: dict[str, str]) -> list[float]:
    """What the program prints, one number per line."""
    for name, text in sources.items():
        (folder / name).write_text(text)
    program = folder / "program"
    built = [COMPILER, *STRICT, "-o", program, *(folder / name for name in sources), "-lm"]
    subprocess.run(
        [str(part) for part in built], check=True, capture_output=True, text=True, timeout=100.0
    )
    run = subprocess.run(
        [str(program)], check=True, capture_output=True, text=True, timeout=100.0
    ).stdout
    return [float(line) for line in run.split()]


def pendulum() -> ca.Function:
    x = ca.SX.sym("x", 2)
    push = ca.SX.sym("push")
    rate = ca.vertcat(x[1], push - ca.sin(x[0]))
    return ca.Function(
        "pendulum",
        [x, push],
        [rate, ca.densify(ca.jacobian(rate, x)), x[1] ** 2 / 2 - ca.cos(x[0])],
    )


@needs_compiler
def test_a_memory_with_a_function_goes_on_in_c_where_python_left_it(tmp_path: Path) -> None:
    memory = structure_of(Motion, dynamics=pendulum())()
    memory.x[:] = 0.3, -0.1
    library = c_library((advance,), memory)
    main = f"""#include <stdio.h>
{library.types}{library.declarations}{library.kernels}
static const Motion INITIAL = {library.initial};
int main(void) {{
  Motion m = INITIAL;
  printf("%.17g\\n", k_advance(&m, 0.2, 50));
  printf("%.17g %.17g\\n", m.x[0], m.x[1]);
  return 0;
}}
"""
    energy, *x = run_c(
        tmp_path, {"functions.c": library.functions, "numbers.c": library.numbers, "main.c": main}
    )
    assert energy == advance(memory, 0.2, 50)
    np.testing.assert_array_equal(x, list(memory.x))


def test_functions_are_written_as_python_calls_them_without_their_numbers() -> None:
    """A compiler that knew them would compute with them itself, and round otherwise than libm."""
    function = pendulum()
    library = c_library((advance,), structure_of(Motion, dynamics=function)())
    generator = ca.CodeGenerator("functions.c")
    generator.add(function)
    form, numbers = without_numbers(generator.dump())
    assert len(numbers) > 0
    assert library.functions.endswith(form)
    assert set(re.findall(r"(?<![\w.])\d+\.\d*(?![\w.])", library.functions)) <= {"0.", "1."}


@needs_compiler
def test_what_a_memory_holds_is_written_to_the_last_bit(tmp_path: Path) -> None:
    structure = structure_of(Memory, n=3)
    memory = structure()
    for x in (0.1, -7.0, math.pi):
        tick(memory, x, False)
    memory.now = math.nan
    memory.double[1][2] = -math.inf
    memory.double[2][0] = -0.0
    memory.out[3] = 5e-324
    library = c_library((tick,), memory)
    main = f"""#include <stdio.h>
{library.types}{library.kernels}
static const Memory INITIAL = {library.initial};
int main(void) {{
  const unsigned char *bytes = (const unsigned char *)&INITIAL;
  for (size_t i = 0; i < sizeof INITIAL; i++) printf("%d\\n", bytes[i]);
  return 0;
}}
"""
    assert bytes(map(int, run_c(tmp_path, {"main.c": main}))) == bytes(memory)


def test_a_memory_of_zeros_is_written_as_nothing() -> None:
    assert initial_value(structure_of(Memory, n=3)()) == "{0}"


def test_signs_of_zeros_are_kept() -> None:
    class Plain(ctypes.Structure):
        _fields_ = (("x", ctypes.c_double), ("y", ctypes.c_double))

    assert initial_value(Plain(x=-0.0, y=0.0)) == "{.x = -0x0.0p+0}"
