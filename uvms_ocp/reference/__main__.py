"""``python -m uvms_ocp.reference FOLDER``."""

from __future__ import annotations

import sys

from uvms_ocp.errors import UvmsError
from uvms_ocp.reference.build import build_reference

_BAD_INPUT = 2


def main() -> None:
    """Build the reference into the folder of the command line; exit code 2 with what is wrong."""
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        sys.exit("usage: python -m uvms_ocp.reference FOLDER")
    try:
        index = build_reference(sys.argv[1])
    except UvmsError as error:
        sys.stderr.write(f"error: {error}\n")
        sys.exit(_BAD_INPUT)
    sys.stdout.write(f"{index}\n")


if __name__ == "__main__":
    main()
