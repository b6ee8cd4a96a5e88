"""Compiling programs of JAX in the background, so that several are compiled while others are traced."""

from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from typing import Any

from jax.stages import Compiled, Lowered


def compiling(lowered: Lowered, options: Any = None) -> Future[Compiled]:
    """The compiled program, on which a thread works from now on. options: of XLA; None: its defaults."""
    compiler: Any = lowered
    return _compilers().submit(compiler.compile, options)


@cache
def _compilers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(thread_name_prefix="compiler")
