"""Bars that tell how far long work is: on terminals and in notebooks, and nowhere else."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from uvms_ocp.checks import checked

_wanted = [True]


@checked
def show_progress(shown: bool = True) -> None:
    """Show bars of runs, campaigns and identification from now on, or none.

    ``TQDM_DISABLE=1`` in the environment hides them, too. Where output is redirected there are none.
    """
    _wanted[:] = [shown]


@contextmanager
def no_progress() -> Iterator[None]:
    """Inside no bars are begun: somebody else tells what happens."""
    before, _wanted[:] = list(_wanted), [False]
    try:
        yield
    finally:
        _wanted[:] = before


def progress_bar(*, shown: bool = True, **given: Any) -> Any:
    """Return a bar of tqdm, of which nothing stays; disabled unless shown, and where nobody looks. given: see `tqdm.tqdm`."""
    notebook = type(sys.stderr).__module__.startswith("ipykernel")
    looked_at = sys.stderr is not None and (notebook or sys.stderr.isatty())
    wanted = _wanted[0] and os.environ.get("TQDM_DISABLE", "0") in ("", "0")
    return _tqdm()(disable=not (shown and wanted and looked_at), leave=False, dynamic_ncols=True, **given)


@cache
def _tqdm() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # in notebooks without ipywidgets bars are lines of text
        from tqdm.auto import tqdm
    return tqdm
