"""How Hypothesis searches: briefly at the desk, the same examples every time in CI."""

import os

from hypothesis import HealthCheck, settings

settings.register_profile(
    # No deadline: how long an example takes is up to what else the machine does.
    "dev",
    max_examples=50,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile(
    "ci",
    max_examples=100,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("ci" if os.environ.get("CI") else "dev")
