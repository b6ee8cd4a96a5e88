"""A process that trains shortly on native physics.

`python -m tests.learning.start_process CACHE ALGORITHM CHANGES`; ALGORITHM: `ppo`, `sac` or `dqn`; CHANGES:
JSON, what differs from 512 steps of its small run.

Prints, as one line of JSON, how often JAX's cache had a program and had not, and which libraries of physics
for accelerators were loaded.
"""

import json
import sys
from collections import Counter
from typing import Any

import jax

from core.environments import catalog
from core.physics.choose import engine_builder
from tests.learning.dqn_runs import dqn_run
from tests.learning.runs import small_run
from tests.learning.sac_runs import sac_run


def run(algorithm: str, changes: dict[str, Any]) -> None:
    """Train to the end."""
    begin = {"ppo": small_run, "sac": sac_run, "dqn": dqn_run}[algorithm]
    info = catalog.find("inverted_pendulum")
    environment = catalog.make(info, info.options(), engine_builder("native"))
    for _ in begin(environment, **{"num_timesteps": 512, **changes}).events():
        pass


def main(cache: str, algorithm: str, changes: str) -> None:
    jax.config.update("jax_compilation_cache_dir", cache)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    events = Counter[str]()
    jax.monitoring.register_event_listener(lambda event, **_: events.update([event.rpartition("/")[2]]))
    run(algorithm, json.loads(changes))
    answer = {
        "hits": events["cache_hits"],
        "misses": events["cache_misses"],
        "physics": sorted({"mujoco.mjx", "trimesh", "warp"} & set(sys.modules)),
    }
    print(json.dumps(answer))


if __name__ == "__main__":
    main(*sys.argv[1:])
