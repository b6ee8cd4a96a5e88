"""The sizes that shape the kernels."""

from collections.abc import Callable
from dataclasses import dataclass

import jax

from core.algorithms.ppo.kernels.fitting import rows_of_a_tile
from core.algorithms.ppo.kernels.layout import Layout


@dataclass(frozen=True)
class Sizes:
    """unroll_length: T. batch_size: B, unrolls of a minibatch. interpret: without a GPU."""

    layout: Layout
    activation: Callable[[jax.Array], jax.Array]
    action_size: int
    unroll_length: int
    batch_size: int
    interpret: bool = False

    @property
    def rows(self) -> int:
        """Of a tile: unrolls at one time."""
        return rows_of_a_tile(self.batch_size)

    @property
    def samples(self) -> int:
        """Of a minibatch."""
        return self.batch_size * self.unroll_length

    @property
    def num_tiles(self) -> int:
        return self.samples // self.rows

    @property
    def num_blocks(self) -> int:
        """Of unrolls, each of whose advantages one block of threads estimates."""
        return self.batch_size // self.rows
