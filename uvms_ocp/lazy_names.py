"""Names of a package that its stub lists, each loaded when it is first asked for."""

from __future__ import annotations

from collections.abc import Callable

import lazy_loader

from uvms_ocp.interrupts import held_back


def attach_stub(
    package: str, file: str
) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package with its ``__init__.pyi``
    beside `file`.

    Ctrl-C waits until a module is loaded: one that is loaded by half, such as NumPy, stays so until
    the process ends.
    """
    load, directory, names = lazy_loader.attach_stub(package, file)

    def load_whole(name: str) -> object:
        with held_back():
            return load(name)

    return load_whole, directory, names
