"""A generated function on all of this machine's cores, called from compiled JAX programs."""

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from itertools import pairwise

import jax
import numpy as np

from mujoco_compiled.code.function_source import FUNCTION, FunctionSource
from mujoco_compiled.code.host_call import Floats, host_call
from mujoco_compiled.code.machine_code import Function, loaded, num_cores, vector_width


class CpuCall:
    """Moves one environment; `jax.vmap` makes it many, in one call. The code is made in the background.

    Every environment has the same result on any number of threads, and beside any others.
    """

    def __init__(self, source: FunctionSource) -> None:
        self._source = source
        self._function: Future[Function] = _compilers().submit(self._loaded)

    def __call__(self, *arrays: jax.Array) -> tuple[jax.Array, ...]:
        """arrays: the inputs, [size] each. Returns the outputs."""
        shapes = [(size,) for size in self._source.outputs.values()]
        return host_call(self._on_the_host, self._source.described, shapes, *arrays)

    def _loaded(self) -> Function:
        num_arrays = len(self._source.inputs) + len(self._source.outputs)
        return loaded(self._source.cpu_code(), FUNCTION, num_arrays)

    def _on_the_host(self, *arrays: Floats) -> Sequence[Floats]:
        function, outer = self._function.result(), arrays[0].shape[:-1]
        num_envs = int(np.prod(outer))
        contiguous = [np.ascontiguousarray(array) for array in arrays]
        found = [np.empty((*outer, size), np.float32) for size in self._source.outputs.values()]
        first, *others = _shares(num_envs, vector_width(), num_cores())
        waiting = [_movers().submit(function, *share, *contiguous, *found) for share in others]
        function(*first, *contiguous, *found)
        for one in waiting:
            one.result()
        return found


def _shares(num_envs: int, width: int, num_threads: int) -> list[tuple[int, int]]:
    """(first, end) of each thread's environments, in whole vectors, of which each has as many as it can."""
    vectors = -(-num_envs // width)
    num_shares = max(1, min(num_threads, vectors))
    ends = [width * (vectors * share // num_shares) for share in range(num_shares)] + [num_envs]
    return list(pairwise(ends))


@cache
def _movers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(num_cores(), "physics")


@cache
def _compilers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(num_cores(), "physics-compiler")
