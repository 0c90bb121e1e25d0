"""Names of all figures, known before Matplotlib, which draws them, is loaded."""

RUN_NAMES = (
    "errors",
    "misalignment",
    "altitude",
    "tool_error",
    "activations",
    "quantities",
    "velocities",
    "joints",
    "path",
    "efforts",
    "tracking",
    "estimate",
    "health",
    "tick_time",
)
"""Names of all figures of a run, known before what draws them is loaded."""
PLAN_NAMES = ("vehicle_motion", "joint_motion", "clearance", "efforts")
"""Names of all figures of a plan, known before what draws them is loaded."""
