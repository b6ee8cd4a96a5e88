"""Compiling several programs of JAX at once."""

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from jax.stages import Compiled, Lowered


def compiled_side_by_side(lowered: Iterable[Lowered], options: Any = None) -> Sequence[Compiled]:
    """The compiled programs; each is compiled in a thread of its own. options: of XLA; None: its defaults."""

    def compiled(function: Any) -> Compiled:
        return function.compile(options)

    with ThreadPoolExecutor() as pool:
        return list(pool.map(compiled, lowered))
