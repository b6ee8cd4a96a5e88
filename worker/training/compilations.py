"""Sets where this process finds what was compiled before, and leaves what it compiles."""

from pathlib import Path

import jax

from core.physics.choose import set_warp_cache
from core.physics.compiled.code.kept_code import keep_code
from worker.compile_cache.local import CACHE


def keep_programs() -> None:
    """Cache JAX's programs, if the supervisor has made a folder for them.

    The path is relative to the spool, the working directory: JAX may make the folder's name part of a
    program's key (0.10 does), and would not find what was compiled under another name.
    """
    if Path(CACHE).is_dir():
        jax.config.update("jax_compilation_cache_dir", f"{CACHE}/jax")
        # JAX keeps what took 1 s to compile; an evaluation's program takes less, and a job waits for it, too.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def keep_warp_kernels() -> None:
    """Cache Warp's kernels, too. Raises JobFailed without Warp."""
    if Path(CACHE).is_dir():
        set_warp_cache(Path(CACHE, "warp").absolute())


def keep_machine_code() -> None:
    """Cache the code that the engine `compiled` makes, too."""
    if Path(CACHE).is_dir():
        keep_code(Path(CACHE, "compiled").absolute())
