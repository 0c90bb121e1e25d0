"""Exit codes of commands: 0 done, 1 internal error, and the three below."""

BAD_INPUT = 2
"""Bad input, or a mission that pre-flight refuses."""
NOT_COMPLETED = 3
"""Mission not completed, no plan that may be followed, or no answer of an identification."""
INTERRUPTED = 130
"""Stopped by hand, as shells number Ctrl-C."""
