"""The same inputs in every run: what fails here fails for everybody.

Seeds are those of the tests' own source, and `drawing` keeps out what differs between machines.
Other inputs are tried by ``pytest tests/generated --hypothesis-profile search --hypothesis-seed
1``, or any other seed.
"""

from __future__ import annotations

from hypothesis import HealthCheck, settings

for name, same in (("same", True), ("search", False)):
    settings.register_profile(
        name,
        derandomize=same,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )
settings.load_profile("same")
