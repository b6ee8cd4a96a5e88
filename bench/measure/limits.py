"""The least work of the learning phase, and the peak rates of a card."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

FLOAT_BYTES = 4


@dataclass(frozen=True)
class Card:
    """Peaks of one GPU: dense matrix products in TF32 and BF16, everything else in float32, and its memory.

    flops in operations per second, memory in bytes per second.
    """

    name: str
    bf16_flops: float
    tf32_flops: float
    fp32_flops: float
    memory: float
    source: str


CARDS = (
    Card(
        name="H200",
        bf16_flops=989e12,
        tf32_flops=494e12,
        fp32_flops=67e12,
        memory=4.8e12,
        source="NVIDIA H200 Tensor Core GPU Datasheet, SXM; it states tensor peaks with sparsity, which are "
        "twice these",
    ),
)


def card_of(accelerator: str | None) -> Card | None:
    """The card with this name from its driver; None for one whose peaks are not listed here."""
    return next((card for card in CARDS if accelerator and card.name in accelerator), None)


@dataclass(frozen=True)
class Need:
    """One gradient step's need: operations in matrix products, and bytes read from or written to memory."""

    flops: float
    bytes: float

    def least_s(self, flops: float, memory: float) -> float:
        """Seconds on a card with these peaks, which computes and moves data at the same time."""
        return max(self.flops / flops, self.bytes / memory)


def forward_flops(layers: Sequence[int], samples: int) -> float:
    """Operations of a dense network for a batch of inputs. layers: its widths, from input to output."""
    return 2.0 * samples * sum(a * b for a, b in pairwise(layers))


def gradient_flops(layers: Sequence[int], samples: int) -> float:
    """The same forward and backward: backward adds twice as much, less the gradient by the inputs."""
    return 3 * forward_flops(layers, samples) - 2.0 * samples * layers[0] * layers[1]


def num_parameters(layers: Sequence[int]) -> int:
    return sum((a + 1) * b for a, b in pairwise(layers))


def gradient_step(
    policy: Sequence[int], value: Sequence[int], *, unrolls: int, unroll_length: int, sample_floats: int
) -> Need:
    """One minibatch of PPO: both networks on every sample, and the value once more at the end of each unroll.

    sample_floats: numbers stored per step. Bytes: the batch is read once; parameters and Adam's two moments
    are read and written. At best, everything between stays in the card's caches.
    """
    samples = unrolls * unroll_length
    flops = gradient_flops(policy, samples) + gradient_flops(value, samples) + forward_flops(value, unrolls)
    parameters = num_parameters(policy) + num_parameters(value)
    return Need(flops, FLOAT_BYTES * (samples * sample_floats + 6.0 * parameters))
