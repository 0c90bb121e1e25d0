"""``python -m uvms_ocp``."""

from uvms_ocp.cli import main

main()
