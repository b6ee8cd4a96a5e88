"""Loads the trained policy of any algorithm, for rollouts and videos."""

from core.algorithms.catalog import ALGORITHMS, loaded
from core.algorithms.checkpoint import kind_of, of_seed
from core.algorithms.trained_policy import TrainedPolicy


def policy_from_checkpoint(
    content: bytes, *, deterministic: bool = True, seed: int | None = None
) -> TrainedPolicy:
    """The policy in a checkpoint; seed: of a job of several seeds. Raises JobFailed where it is damaged."""
    if seed is not None:
        content = of_seed(content, seed)
    return load_policy(content, kind_of(content), is_checkpoint=True, deterministic=deterministic)


def load_policy(
    content: bytes, algorithm: str, *, is_checkpoint: bool, deterministic: bool = True
) -> TrainedPolicy:
    """The policy in a checkpoint or in a policy file of this algorithm.

    deterministic: without the exploration's noise. Raises JobFailed where the file is damaged.
    """
    return loaded(ALGORITHMS[algorithm].policy)(
        content, is_checkpoint=is_checkpoint, deterministic=deterministic
    )
