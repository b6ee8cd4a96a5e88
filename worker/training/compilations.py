"""Where this process finds what was compiled before, and leaves what it compiles."""

from pathlib import Path

import jax

from core.physics.kernels import keep_kernels
from worker.compile_cache.local import CACHE


def keep_programs() -> None:
    """JAX's programs, where a supervisor has laid out a folder for them.

    The path is relative to the spool, where a job stands: JAX may count a folder's name as part of the
    program (0.10 does), and would find nothing that was compiled under another.
    """
    if Path(CACHE).is_dir():
        jax.config.update("jax_compilation_cache_dir", f"{CACHE}/jax")
        # JAX keeps what took a second; an evaluation's program takes less, and a job waits for that, too.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def keep_warp_kernels() -> None:
    """Warp's kernels, likewise. Raises JobFailed without Warp."""
    if Path(CACHE).is_dir():
        keep_kernels(Path(CACHE, "warp").absolute())
