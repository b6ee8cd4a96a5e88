"""A stand-in for the training process that compiles one real program, and says how JAX came by it."""

import json
import os
import sys
import time
import warnings
from collections import Counter
from pathlib import Path

import jax
import jax.numpy as jnp

from worker.training.built_environment import keep_programs

spool, events_fd = Path(sys.argv[1]), int(sys.argv[2])
counted = Counter[str]()


def say(**message: object) -> None:
    os.write(events_fd, json.dumps(message).encode() + b"\n")


def program(x: jax.Array) -> jax.Array:
    return jnp.tanh(x @ x).sum()


say(type="hello", pid=os.getpid())
jax.monitoring.register_event_listener(lambda event, **_: counted.update([event.rpartition("/")[2]]))
keep_programs()
# A program as small as this one would not be kept.
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
say(type="started", device="cpu", engine="none")
began = time.perf_counter()
with warnings.catch_warnings(record=True) as warned:
    warnings.simplefilter("always")
    compiled = jax.jit(program).lower(jax.ShapeDtypeStruct((64, 64), "float32")).compile()
say(type="phase", name="compile", seconds=time.perf_counter() - began)
answer = {
    "hits": counted["cache_hits"],
    "misses": counted["cache_misses"],
    "result": float(compiled(jnp.eye(64))),
    "warnings": [str(warning.message) for warning in warned],
}
(spool / "summary.json").write_text(json.dumps(answer))
say(type="file", name="summary.json", path="summary.json", role="summary", media_type="application/json")
say(type="finished")
