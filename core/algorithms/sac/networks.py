"""A run's policy and critics, and how the policy acts."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float

from core.algorithms.brax_training import distribution, identity_observation_preprocessor, networks
from core.algorithms.evaluation import Policy
from core.algorithms.sac.spec import SACSpec

# Their smaller estimate counts (Fujimoto et al., Addressing Function Approximation Error, 2018).
NUM_CRITICS = 2


@dataclass(frozen=True)
class Critics:
    """Two networks from an observation and an action to logits over `num_atoms` values."""

    hidden_layer_sizes: tuple[int, ...]
    num_atoms: int
    activation: Any
    layer_norm: bool

    def init(self, key: jax.Array, observation_size: int, action_size: int) -> Any:
        """Random parameters, with both critics' in each array's first axis."""
        zeros = jnp.zeros((1, observation_size + action_size))
        return jax.vmap(lambda one: self._network.init(one, zeros))(jax.random.split(key, NUM_CRITICS))

    def logits(
        self, params: Any, observation: Float[Array, "B obs"], action: Float[Array, "B act"]
    ) -> Float[Array, "2 B atoms"]:
        given = jnp.concatenate([observation, action], axis=-1)
        return jax.vmap(self._network.apply, (0, None))(params, given)

    @property
    def _network(self) -> Any:
        return networks.MLP(
            layer_sizes=[*self.hidden_layer_sizes, self.num_atoms],
            activation=self.activation,
            layer_norm=self.layer_norm,
        )


def projected(
    probabilities: Float[Array, "B atoms"], moved: Float[Array, "B atoms"], atoms: Float[Array, " atoms"]
) -> Float[Array, "B atoms"]:
    """The distribution of values that have moved, over the fixed ones.

    Each value shares its probability between its neighbours; those beyond the ends stay at the ends.
    """
    # Fenced: for an H100, XLA fuses what comes before into one kernel with it, which compiles for minutes.
    probabilities, moved = jax.lax.optimization_barrier((probabilities, moved))
    spacing = atoms[1] - atoms[0]
    place = (jnp.clip(moved, atoms[0], atoms[-1]) - atoms[0]) / spacing
    shares = jnp.clip(1.0 - jnp.abs(place[:, None, :] - jnp.arange(len(atoms))[None, :, None]), 0.0, 1.0)
    # Fused by XLA: an einsum would store the shares.
    return jax.lax.optimization_barrier(jnp.sum(shares * probabilities[:, None, :], axis=-1))


@struct.dataclass
class Params:
    """policy: Brax's parameters. q: both critics'. log_alpha: [] float32, of the entropy's weight."""

    policy: Any
    q: Any
    log_alpha: jax.Array


@dataclass(frozen=True)
class Networks:
    """All take normalised observations. atoms: [num_atoms], the values of the critics' distributions."""

    policy: Any
    actions: Any
    critics: Critics
    atoms: Float[Array, " atoms"]

    def init(self, key: jax.Array, observation_size: int, action_size: int, init_alpha: float) -> Params:
        """Random parameters."""
        policy_key, q_key = jax.random.split(key)
        return Params(
            policy=self.policy.init(policy_key),
            q=self.critics.init(q_key, observation_size, action_size),
            log_alpha=jnp.log(jnp.float32(init_alpha)),
        )

    def sample(
        self, policy: Any, observation: Float[Array, "B obs"], key: jax.Array
    ) -> tuple[Float[Array, "B act"], Float[Array, " B"]]:
        """Actions, and the logarithms of their probability densities."""
        logits = self.policy.apply(None, policy, observation)
        raw = self.actions.sample_no_postprocessing(logits, key)
        return self.actions.postprocess(raw), self.actions.log_prob(logits, raw)

    def values(
        self, q: Any, observation: Float[Array, "B obs"], action: Float[Array, "B act"]
    ) -> Float[Array, "2 B"]:
        """The return that each critic expects."""
        return jax.nn.softmax(self.critics.logits(q, observation, action)) @ self.atoms

    def acting(self, policy: Any, normalize: Callable[[Any], Any], *, deterministic: bool = False) -> Policy:
        """The policy as a function of raw observations; its extras hold the actions."""

        def act(observation: Any, key: jax.Array) -> tuple[jax.Array, Any]:
            seen = normalize(observation)
            if deterministic:
                action = self.actions.mode(self.policy.apply(None, policy, seen))
            else:
                action, _ = self.sample(policy, seen, key)
            return action, {"action": action}

        return act


def make_networks(observation_size: int, action_size: int, settings: SACSpec) -> Networks:
    """The networks of these settings."""
    activation = cast("Any", networks.ACTIVATION[settings.activation])
    actions = distribution.NormalTanhDistribution(event_size=action_size)
    policy = networks.make_policy_network(
        actions.param_size,
        observation_size,
        preprocess_observations_fn=cast("Any", identity_observation_preprocessor),
        hidden_layer_sizes=tuple(settings.policy_hidden_layer_sizes),
        activation=activation,
    )
    critics = Critics(
        tuple(settings.q_hidden_layer_sizes),
        settings.num_atoms,
        activation,
        settings.q_network_layer_norm,
    )
    atoms = jnp.linspace(settings.value_min, settings.value_max, settings.num_atoms)
    return Networks(policy, actions, critics, atoms)
