"""A trained policy as a function for notebooks. Imports JAX only when called."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gaitway.errors import MissingExtra, PolicyUnreadable

if TYPE_CHECKING:
    import jax

Policy = Callable[..., "jax.Array"]


def load(path: Path, algorithm: str, *, is_checkpoint: bool, deterministic: bool = True) -> Policy:
    """The policy in a file of this algorithm as a jitted `act(observation, key=None) -> action`.

    observation: the input of the algorithm's policies; for PPO [..., observation_size]. action: [...,
    action_size], each component in [-1, 1]; for Q-learning see docs/q_learning.md. key: a JAX random key,
    needed by a stochastic policy (ValueError without one).
    Raises MissingExtra where JAX or msgpack is not installed, and PolicyUnreadable.
    """
    try:
        import jax

        from gaitway.policies import ppo, q_learning
    except ModuleNotFoundError as error:
        raise MissingExtra(
            f"A policy is loaded with JAX and msgpack, and {error.name} is not installed; "
            f"install them with `pip install 'gaitway[policy]'`."
        ) from error
    readers: dict[str, Callable[[bytes, bool, bool], tuple[Any, Any]]] = {
        "ppo": ppo.load,
        "q_learning": q_learning.load,
    }
    if algorithm not in readers:
        raise PolicyUnreadable(f"This version of gaitway does not read policies of {algorithm!r}.")
    parameters, function = readers[algorithm](path.read_bytes(), is_checkpoint, deterministic)
    answer: Any = jax.jit(function)  # pyright: ignore[reportUnknownMemberType]
    unused = jax.random.key(0)

    def act(observation: Any, key: "jax.Array | None" = None) -> "jax.Array":
        if key is None and not deterministic:
            raise ValueError("A policy that samples needs a random key: act(observation, jax.random.key(0)).")
        return answer(parameters, observation, unused if key is None else key)

    return act
