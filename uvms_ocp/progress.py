"""Bars that tell how far long work is: on terminals and in notebooks, and nowhere else."""

from __future__ import annotations

import os
import sys
import warnings
from typing import Any

from uvms_ocp.checks import checked

SILENT = 2.0
"""[s] that work may take without a word."""
_shown_by_user = True
"""What `show_progress` was told last."""


@checked
def show_progress(shown: bool = True) -> None:
    """Show bars of runs, campaigns, identification and compilation from now on, or none.

    ``TQDM_DISABLE=1`` in the environment hides them, too. Where output is redirected there are
    none.
    """
    global _shown_by_user
    _shown_by_user = shown


def progress_bar(*, shown: bool = True, **options: Any) -> Any:
    """Return a bar of tqdm, of which nothing stays; disabled unless shown, and where nobody looks.

    options: see `tqdm.tqdm`. Beside a display of Rich, which then tells what happens, there is
    none.
    """
    is_hidden = os.environ.get("TQDM_DISABLE", "0") not in ("", "0")
    if is_hidden or not (shown and _shown_by_user and _somebody_looks()):
        return _NoBar()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # in notebooks without ipywidgets bars are lines of text
        from tqdm.auto import tqdm
    options |= {"miniters": 0, "smoothing": 0.0}  # time goes on where nothing else does
    return tqdm(leave=False, dynamic_ncols=True, **options)


def _somebody_looks() -> bool:
    """Return whether standard error is a terminal without a display of Rich, or a notebook."""
    # The stream's module names it: to import Rich or ipykernel for their classes would take a
    # tenth of a second, and neither need be installed.
    package, _, _ = type(sys.stderr).__module__.partition(".")
    if package == "rich":
        return False
    is_terminal = getattr(sys.stderr, "isatty", bool)()
    return is_terminal or package == "ipykernel"


class _NoBar:
    """Stands in for a bar of tqdm where nobody looks, and does nothing, so that tqdm is not
    imported.
    """

    disable = True
    n = 0.0
    update = set_postfix = set_description_str = __exit__ = staticmethod(lambda *_, **__: None)

    def __enter__(self) -> _NoBar:
        return self
