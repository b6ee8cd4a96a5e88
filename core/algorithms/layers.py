"""Names of a policy's layers, whose activations a rollout may record (docs/neuroscience.md).

A layer is named by its network and its number. Of an encoder's last layer there is the distribution of z, the
intention, in place of the numbers that say it.
"""

from collections.abc import Sequence

LATENT_MEAN, LATENT_STD, LATENT_SAMPLE = "latent/mean", "latent/std", "latent/sample"

# The network of a policy that is one perceptron, and those of one with an encoder.
POLICY, ENCODER, DECODER = "policy", "encoder", "decoder"


def perceptron(network: str, sizes: Sequence[int]) -> dict[str, int]:
    """The sizes of a network's layers by their names."""
    return {f"{network}/{number}": size for number, size in enumerate(sizes)}


def plain(hidden: Sequence[int], action_size: int) -> dict[str, int]:
    """Of a policy that is one perceptron. Its last layer has a location and a scale for each action."""
    return perceptron(POLICY, [*hidden, 2 * action_size])


def intention(
    encoder: Sequence[int], latent: int, decoder: Sequence[int], action_size: int
) -> dict[str, int]:
    """Of a policy that is an encoder and a decoder."""
    return {
        **perceptron(ENCODER, encoder),
        **dict.fromkeys((LATENT_MEAN, LATENT_STD, LATENT_SAMPLE), latent),
        **perceptron(DECODER, [*decoder, 2 * action_size]),
    }
