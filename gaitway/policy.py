"""A trained policy as a function for notebooks. Loads JAX when called, not before."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gaitway.errors import MissingExtra

if TYPE_CHECKING:
    import jax

Policy = Callable[..., "jax.Array"]


def load(path: Path, *, is_checkpoint: bool, deterministic: bool = True) -> Policy:
    """The policy in a file as a jitted `act(observation, key=None) -> action`.

    observation: [..., observation_size]; action: [..., action_size], each component in [-1, 1].
    key: a JAX random key, needed by a stochastic policy (ValueError without one).
    Raises MissingExtra where JAX and Brax are not installed.
    """
    try:
        import jax

        from core.algorithms.ppo.policy import make_inference, policy_from_checkpoint, read_policy
    except ModuleNotFoundError as error:
        raise MissingExtra(
            f"A policy is loaded with JAX and Brax, and {error.name} is not installed; "
            f"install them with `pip install 'gaitway[worker]'`."
        ) from error
    content = path.read_bytes()
    params = policy_from_checkpoint(content) if is_checkpoint else read_policy(content)
    infer: Any = jax.jit(make_inference(params, deterministic=deterministic))  # pyright: ignore[reportUnknownMemberType]
    unused = jax.random.key(0)

    def act(observation: Any, key: "jax.Array | None" = None) -> "jax.Array":
        if key is None and not deterministic:
            raise ValueError("A policy that samples needs a random key: act(observation, jax.random.key(0)).")
        return infer(observation, unused if key is None else key)

    return act
