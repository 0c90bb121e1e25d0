"""Commands as they are typed, called in this process: it has imported what they need. Laws of
processes start their own.
"""

from __future__ import annotations

import os
import sys
import warnings
from contextlib import chdir, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from subprocess import CompletedProcess
from unittest.mock import patch

from uvms_ocp.cli.commands import main


def called(*words: str | Path, cwd: Path, **environment: str) -> CompletedProcess[str]:
    """Call a command in a folder; what it raises but to exit is raised here."""
    typed = ["uvms-ocp", *map(str, words)]
    out = StringIO()
    err = StringIO()
    with (
        chdir(cwd),
        patch.object(sys, "argv", typed),
        patch.dict(os.environ, environment),
        redirect_stdout(out),
        redirect_stderr(err),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("default")  # as in a process of its own
        try:
            main()
            code = 0
        except SystemExit as end:
            code = end.code or 0
    return CompletedProcess(typed, code, out.getvalue(), err.getvalue())
