"""A trained policy as a function for notebooks. Imports JAX only when called."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gaitway.errors import MissingExtra

if TYPE_CHECKING:
    import jax

Policy = Callable[..., "jax.Array"]


def load(path: Path, algorithm: str, *, is_checkpoint: bool, deterministic: bool = True) -> Policy:
    """The policy in a file of this algorithm as a jitted `act(observation, key=None) -> action`.

    observation: the input of the algorithm's policies; for PPO [..., observation_size]. action: [...,
    action_size], each component in [-1, 1]; for Q-learning see docs/q_learning.md. key: a JAX random key,
    needed by a stochastic policy (ValueError without one).
    Raises MissingExtra where JAX and Brax are not installed.
    """
    try:
        import jax

        from core.algorithms.policy import load_policy
    except ModuleNotFoundError as error:
        raise MissingExtra(
            f"A policy is loaded with JAX and Brax, and {error.name} is not installed; "
            f"install them with `pip install 'gaitway[worker]'`."
        ) from error
    policy = load_policy(
        path.read_bytes(), algorithm, is_checkpoint=is_checkpoint, deterministic=deterministic
    )
    answer: Any = jax.jit(policy.answer)  # pyright: ignore[reportUnknownMemberType]
    unused = jax.random.key(0)

    def act(observation: Any, key: "jax.Array | None" = None) -> "jax.Array":
        if key is None and not deterministic:
            raise ValueError("A policy that samples needs a random key: act(observation, jax.random.key(0)).")
        return answer(policy.parameters, observation, unused if key is None else key)

    return act
