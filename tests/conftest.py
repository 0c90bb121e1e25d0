"""What holds for all tests."""

from __future__ import annotations

import os
import signal
from zlib import crc32

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


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--share", metavar="K/N", help="the K-th of N shares of the tests, such as 2/3"
    )


@pytest.hookimpl(tryfirst=True)  # before what is marked slow is left out
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the tests of one share, drawn by their names: the same on every machine."""
    _mark_all_but_drawn_cases(items)
    asked = config.getoption("--share")
    if asked is None:
        return
    share, _, shares = asked.partition("/")
    if not (share.isdigit() and shares.isdigit() and 1 <= int(share) <= int(shares)):
        raise pytest.UsageError(f"--share is {asked}: K/N with K from 1 to N, such as 2/3")
    of_share = []
    of_others = []
    for item in items:
        drawn = crc32(item.nodeid.encode()) % int(shares)
        (of_share if drawn == int(share) - 1 else of_others).append(item)
    config.hook.pytest_deselected(items=of_others)
    items[:] = of_share


def _mark_all_but_drawn_cases(items: list[pytest.Item]) -> None:
    """Mark as slow the cases of each test marked ``sampled(n)`` but n of them, 1 by default.

    Which these are is drawn by the environment variable UVMS_OCP_DRAW, which is another one in each
    run of `.ci/run`.
    """
    cases_by_test: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("sampled") is not None:
            cases_by_test.setdefault(item.nodeid.partition("[")[0], []).append(item)
    draw = os.environ.get("UVMS_OCP_DRAW", "")
    for cases in cases_by_test.values():
        mark = cases[0].get_closest_marker("sampled")
        n_drawn = mark.args[0] if mark is not None and mark.args else 1
        cases.sort(key=lambda item: crc32(f"{draw} {item.nodeid}".encode()))
        for item in cases[n_drawn:]:
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session", autouse=True)
def _interrupts_are_heard() -> None:
    # A shell's background job ignores them, and so would every command that a test interrupts.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
