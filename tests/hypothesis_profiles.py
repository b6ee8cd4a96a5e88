"""How Hypothesis searches: briefly at the desk, the same examples every time in CI."""

import os
from datetime import timedelta

from hypothesis import HealthCheck, settings

settings.register_profile(
    "dev", max_examples=50, deadline=timedelta(seconds=2), suppress_health_check=[HealthCheck.too_slow]
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
