"""A generated function as a kernel, launched by XLA itself from compiled JAX programs.

XLA launches PTX that a program brings along (`__gpu$xla.gpu.ptx`), so nothing goes through Python, and a loop
of control steps is recorded like a loop of XLA's own kernels.
"""

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from mujoco_compiled.code.function_source import FUNCTION, FunctionSource, Kernel
from mujoco_compiled.code.gpu_kernel import TEAM_WARPS, WARP, most_shared, threads_of

_TARGET = "__gpu$xla.gpu.ptx"


class GpuCall:
    """Moves one environment; `jax.vmap` makes it many, in one kernel."""

    def __init__(self, source: FunctionSource) -> None:
        self._source = source
        card: Any = jax.devices("gpu")[0]
        self._card, self._num_processors = card.compute_capability, int(card.core_count)
        self._kernels: dict[bool, Kernel] = {}  # by whether a processor has more than one block
        self._many: Any = jax.custom_batching.custom_vmap(self._launch)
        self._many.def_vmap(self._on_another_axis)

    def __call__(self, *arrays: jax.Array) -> tuple[jax.Array, ...]:
        """arrays: the inputs, [size] each. Returns the outputs."""
        return tuple(output[0] for output in self._many(*(array[None] for array in arrays)))

    def _launch(self, *arrays: jax.Array) -> Sequence[jax.Array]:
        """arrays: [N, size] each."""
        num_envs = arrays[0].shape[0]
        kernel = self._kernel(math.ceil(num_envs / self._num_processors))
        shapes = [
            jax.ShapeDtypeStruct((num_envs, size), jnp.float32) for size in self._source.outputs.values()
        ]
        if kernel.num_envs:
            room = math.ceil(num_envs / kernel.num_envs) * kernel.num_envs * kernel.num_common
            shapes.append(jax.ShapeDtypeStruct((room,), jnp.float32))
        num_given = 1 + len(arrays)
        count = jnp.array([num_envs], jnp.int32)
        found = jax.ffi.ffi_call(_TARGET, shapes)(
            count,
            *arrays,
            name=FUNCTION,
            kernel_type="ptx",
            kernel_data=kernel.ptx,
            **self._grid(kernel, num_envs),
            shared_mem_bytes=np.int32(kernel.shared_bytes),
            output_indices=np.arange(num_given, num_given + len(shapes), dtype=np.int32),
        )
        return found[: len(self._source.outputs)]

    def _kernel(self, load: int) -> Kernel:
        """For this many environments to a processor of the card."""
        if False not in self._kernels:
            self._kernels[False] = self._source.kernel(self._card)
        is_lean = 0 < self._kernels[False].num_envs < load
        if is_lean not in self._kernels:
            self._kernels[is_lean] = self._source.kernel(self._card, is_lean=is_lean)
        return self._kernels[is_lean]

    def _grid(self, kernel: Kernel, num_envs: int) -> dict[str, np.int32]:
        """Enough blocks, and spread over all of the card's processors."""
        if kernel.num_envs:
            num_blocks = math.ceil(num_envs / kernel.num_envs)
            at_once = math.ceil(num_blocks / self._num_processors)
            # A block takes 1 KiB besides.
            fitting = (most_shared(self._card) + 1024) // (kernel.shared_bytes + 1024)
            at_once = min(at_once, fitting, TEAM_WARPS)
            first = {"grid_x": num_blocks, "block_x": TEAM_WARPS // at_once * WARP}
        else:
            num_warps = math.ceil(num_envs * threads_of(kernel.num_lanes) / WARP)
            of_block = min(kernel.most_warps, math.ceil(num_warps / self._num_processors))
            first = {"grid_x": math.ceil(num_warps / of_block), "block_x": of_block * WARP}
        others = dict.fromkeys(("grid_y", "grid_z", "block_y", "block_z"), 1)
        return {name: np.int32(size) for name, size in (first | others).items()}

    def _on_another_axis(
        self, size: int, is_mapped: list[bool], *arrays: jax.Array
    ) -> tuple[list[jax.Array], list[bool]]:
        """arrays: [size, N, ...], or [N, ...] where not mapped. One launch moves them all."""
        whole = [
            array if mapped else jnp.broadcast_to(array, (size, *array.shape))
            for array, mapped in zip(arrays, is_mapped, strict=True)
        ]
        outputs = self._many(*(array.reshape(-1, array.shape[-1]) for array in whole))
        return [one.reshape(size, -1, one.shape[-1]) for one in outputs], [True] * len(outputs)
