"""A process with eight devices: `python -m tests.learning.on_devices ENVIRONMENT ENGINE`; see test_devices.

Prints, as one line of JSON, how far apart a run on one device and one on eight end, and the like.
"""

import json
import sys
from typing import Any

import jax
import numpy as np

from core.algorithms.ppo.learner import FORMAT
from core.environments import catalog
from core.environments.environment import Environment
from core.physics.choose import engine_builder
from tests import probes
from tests.learning.runs import INTENTION, STEPS_PER_UPDATE, checkpoints, small_run

# What learning has made, as against what was added up over a whole batch: relative to 1.
_COMPARED = ("params", "optimizer", "episodes", "key", "num_updates")


def made(name: str, engine: str) -> Environment:
    if name == "probe":
        return probes.observed_action_reward()
    if name == "growing":
        return probes.growing(4 * STEPS_PER_UPDATE)
    if name == "intention":
        return probes.intention()
    info = catalog.find(name)
    return catalog.make(info, info.options(), engine_builder(engine))


def distance(one: bytes, other: bytes) -> float:
    """The largest difference between two checkpoints' arrays, relative to the larger number, or to 1."""
    assert FORMAT.read(one)[0] == FORMAT.read(other)[0]
    read = [FORMAT.read(content)[1] for content in (one, other)]
    states: list[Any] = [{part: state[part] for part in _COMPARED} for state in read]
    for state in states:
        state["episodes"]["state"]["physics"].pop("qacc_warmstart")  # an acceleration: a start for a solver

    def apart(a: Any, b: Any) -> float:
        a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
        return float(np.max(np.abs(a - b) / np.maximum(1, np.abs(a)), initial=0))

    return max(jax.tree.leaves(jax.tree.map(apart, *states)))


def main(name: str, engine: str) -> None:
    budget: dict[str, Any] = {
        "num_timesteps": 2 * STEPS_PER_UPDATE,
        "episode_length": 5,
        "num_evals": 0,
        "reset_pool_size": 12,
    }
    if name == "intention":
        budget["network"] = INTENTION
    run = {"checkpoint_every_steps": STEPS_PER_UPDATE, **budget}
    one = checkpoints(small_run(made(name, engine), **run))
    eight = checkpoints(small_run(made(name, engine), devices=8, **run))
    half, end = STEPS_PER_UPDATE, 2 * STEPS_PER_UPDATE
    moved = small_run(made(name, engine), devices=8, resume=one[half], **run)
    again = small_run(made(name, engine), devices=8, resume=eight[half], **run)
    answer = {
        "devices": jax.device_count(),
        "distance": distance(one[end], eight[end]),
        "moved_distance": distance(one[end], checkpoints(moved)[end]),
        "resumed_equals": checkpoints(again)[end] == eight[end],
    }
    print(json.dumps(answer))


if __name__ == "__main__":
    jax.config.update("jax_compilation_cache_dir", sys.argv[3])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    main(sys.argv[1], sys.argv[2])
