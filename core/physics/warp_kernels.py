"""Warp's kernels, compiled on all cores at once."""

import os
import threading
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import warp as wp

_BLOCK_DIM = 256  # Warp's default


def load_kernels(programs: Iterable[Callable[[], None]], device: Any) -> None:
    """Compile and load the kernels that these programs launch, without running them.

    Warp compiles each module at its first launch, one after the other: half a minute for the forty modules of
    a substep. Side by side they take 12 s on 16 cores. Modules in Warp's cache are only loaded.

    programs: must launch the same kernels whatever the arrays hold.
    """
    with _launches_noted() as needed:
        for program in programs:
            program()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(lambda one: one[0].load(device, one[1] if device.is_cuda else 1), needed))


@contextmanager
def _launches_noted() -> Generator[dict[tuple[Any, int], None]]:
    """Records the (module, size of thread blocks) of launches instead of launching; loops run once.

    Affects only this thread. Warp has no dry run of its own.
    """
    needed, thread = dict[tuple[Any, int], None](), threading.get_ident()
    launch, launch_tiled, capture_while = wp.launch, wp.launch_tiled, wp.capture_while

    def noting(real: Callable[..., Any]) -> Callable[..., Any]:
        def note(kernel: Any, *arguments: Any, block_dim: int = _BLOCK_DIM, **named: Any) -> Any:
            if threading.get_ident() != thread:
                return real(kernel, *arguments, block_dim=block_dim, **named)
            needed[kernel.module, block_dim] = None
            return None

        return note

    def enter(condition: Any, while_body: Callable[..., None], **named: Any) -> None:
        if threading.get_ident() == thread:
            while_body(**named)
        else:
            capture_while(condition, while_body, **named)

    wp.launch, wp.launch_tiled, wp.capture_while = noting(launch), noting(launch_tiled), enter
    try:
        yield needed
    finally:
        wp.launch, wp.launch_tiled, wp.capture_while = launch, launch_tiled, capture_while
