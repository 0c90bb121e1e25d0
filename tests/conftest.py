"""What holds for all tests."""

from __future__ import annotations

import os
import signal

import pytest

# One process a core is what there is; matrices are small, and two threads of BLAS each would wait
# for one another.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
# What is compiled here runs once: optimising it would take most of the time. Bits do not depend on
# it; give "" for all of it.
os.environ.setdefault("UVMS_OCP_CFLAGS", "-O0")
# What is to be compiled is compiled, and nothing goes on behind the tests.
os.environ.setdefault("UVMS_OCP_WAIT_FOR_COMPILER", "1")


@pytest.fixture(scope="session", autouse=True)
def _interrupts_are_heard() -> None:
    # A shell's background job ignores them, and so would every command that a test interrupts.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
