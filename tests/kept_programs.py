"""Compiled programs are kept between runs, in the user's cache folder, for all processes of all runs.

Each library finds its own by what they were made from: JAX's keys have its version and flags, Warp's its
kernels' sources, and the engine `compiled` has its generator's. The folder's name has the rest: the CPU's
instructions, and the versions of all packages that compile. A test that counts compilations has a folder of
its own.
"""

import os
from pathlib import Path

import jax
import platformdirs
from jax._src import lru_cache

from mujoco_compiled import keep_code
from worker.compile_cache.fingerprint import fingerprint
from worker.compile_cache.local import keep_within

_ALL = Path(platformdirs.user_cache_dir("gaitway"), "tests")
_MOST_BYTES = 2**32
KEPT = _ALL / fingerprint("cpu")


def keep_programs() -> None:
    """From here on, JAX's programs and the code of the engine `compiled` come from there, and go there."""
    lru_cache.LRUCache.put = _put_whole  # JAX 0.10 writes in place: others would read half a program.
    jax.config.update("jax_compilation_cache_dir", str(KEPT / "jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    keep_code(KEPT / "compiled")


def forget_old_programs() -> None:
    """Remove those that were used longest ago, as far as all take more than 4 GiB."""
    keep_within(_ALL, _MOST_BYTES)


def _put_whole(self: lru_cache.LRUCache, key: str, value: bytes) -> None:
    file = Path(str(self.path), f"{key}-cache")
    part = file.with_suffix(f".{os.getpid()}")
    part.write_bytes(value)
    part.replace(file)
