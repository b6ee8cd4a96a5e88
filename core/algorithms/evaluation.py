"""Evaluating a policy: whole episodes side by side, without learning."""

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int

from core.environments.environment import Environment, State
from core.environments.wrappers.autoreset import select, without_lost

# (observations [N, obs], or several by name, key) -> (actions [N, act], extras)
Policy = Callable[[Any, jax.Array], tuple[jax.Array, Any]]


# [N], or [agents, episodes] as Q-learning groups them; on a device, or on the host.
PerEnvironment = Float[Array | np.ndarray, "*N"]

V = TypeVar("V")

# Totals that an action's steps are already summed in; every other is a mean over them.
_OF_AN_EPISODE = ("reward", "lost_body")


@struct.dataclass
class EpisodeTotals:
    """Sums over an episode's actions for each of N environments. metrics: by name, `reward`, and `lost_body`,
    which is 1 where the episode ended because its body's state was lost (`without_lost`)."""

    metrics: dict[str, PerEnvironment]
    length: PerEnvironment


@struct.dataclass
class _Trial:
    state: State
    totals: EpisodeTotals
    alive: Bool[Array, " N"]
    time: Int[Array, ""]


def run_episodes(
    environment: Environment,
    policy: Policy,
    key: jax.Array,
    *,
    num_envs: int,
    episode_length: int,
    copies: int = 1,
) -> EpisodeTotals:
    """One episode in each environment, until it ends or is `episode_length` actions long.

    policy: (observations [N, obs], key) -> (actions [N, act], extras). copies: N is `copies * num_envs`, and
    each copy of the `num_envs` environments has the same starts. Stops when the last episode has ended.
    """
    reset_key, act_key = jax.random.split(key)
    starts = jax.random.split(reset_key, num_envs)
    num_envs *= copies
    state = jax.vmap(environment.reset)(jnp.tile(starts, (copies, 1)) if copies > 1 else starts)
    zeros = jnp.zeros(num_envs)
    totals = EpisodeTotals({name: zeros for name in (*_OF_AN_EPISODE, *state.metrics)}, zeros)
    trial = _Trial(state, totals, jnp.ones(num_envs, bool), jnp.int32(0))

    def going(trial: _Trial) -> Bool[Array, ""]:
        return (trial.time < episode_length) & jnp.any(trial.alive)

    def act(trial: _Trial) -> _Trial:
        action, _ = policy(trial.state.obs, jax.random.fold_in(act_key, trial.time))
        state, lost = without_lost(trial.state, jax.vmap(environment.step)(trial.state, action))
        seen = {"reward": state.reward, "lost_body": lost, **state.metrics}
        # An ended episode adds nothing, and its environment stands still.
        totals = EpisodeTotals(
            {
                name: total + jnp.where(trial.alive, seen[name], 0.0)
                for name, total in trial.totals.metrics.items()
            },
            trial.totals.length + trial.alive,
        )
        return _Trial(
            select(trial.alive, state, trial.state), totals, trial.alive & (state.done == 0), trial.time + 1
        )

    return jax.lax.while_loop(going, act, trial).totals


def clearly_named(metrics: Mapping[str, V]) -> dict[str, V]:
    """An environment's metrics, with `forward_speed` as the name of `x_velocity`."""
    return {"forward_speed" if name == "x_velocity" else name: value for name, value in metrics.items()}


def evaluation_metrics(totals: EpisodeTotals, action_repeat: int = 1) -> dict[str, float]:
    """Means over the episodes, by Brax's names; totals: arrays on the host.

    action_repeat: environment steps per action. The result is summed over steps, as rewards are; the totals
    count actions, and an action's metrics are means over its steps (`RepeatedAction`).
    """
    summed = {
        name: value if name in _OF_AN_EPISODE else value * np.float32(action_repeat)
        for name, value in totals.metrics.items()
    }
    metrics = {f"eval/episode_{name}": float(np.mean(value)) for name, value in summed.items()}
    metrics["eval/episode_reward_std"] = float(np.std(totals.metrics["reward"]))
    metrics["eval/avg_episode_length"] = float(np.mean(totals.length)) * action_repeat
    if (speed := clearly_named(totals.metrics).get("forward_speed")) is not None:
        metrics["eval/forward_speed"] = float(np.sum(speed) / np.sum(totals.length))
    return metrics
