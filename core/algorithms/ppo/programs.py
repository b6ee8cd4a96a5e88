"""The compiled programs of a run: traced and compiled once, before the first step."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax.training.agents.ppo.networks import make_inference_fn

from core.algorithms.ppo.evaluation import EpisodeTotals, run_episodes
from core.algorithms.ppo.networks import PolicyParams, make_networks
from core.algorithms.ppo.update import Failure, Hyperparameters, Learner, TrainingState


@dataclass(frozen=True)
class Programs:
    """Functions that can only run, never compile again: other shapes are an error.

    init: the state before the first update, from a seed. epoch: see Learner.epoch; it consumes the state
    it is given. evaluate: totals of the evaluation's episodes, from a policy, a key and an update count.
    """

    init: Callable[[jax.Array], TrainingState]
    epoch: Callable[[TrainingState, Hyperparameters, np.int32], tuple[TrainingState, Any, Failure]]
    evaluate: Callable[[PolicyParams, jax.Array, jax.Array], EpisodeTotals]


def trace(learner: Learner, hyperparameters: Hyperparameters) -> Callable[[], Programs]:
    """Trace every program; calling the result compiles them, side by side."""
    seed, count = jax.ShapeDtypeStruct((), jnp.uint32), jax.ShapeDtypeStruct((), jnp.int32)
    state = jax.eval_shape(learner.init, seed)
    params = (state.normalizer, state.params.policy, state.params.value)
    lowered = (
        jax.jit(learner.init).lower(seed),
        jax.jit(learner.epoch, donate_argnums=0).lower(state, hyperparameters, count),
        jax.jit(_evaluate(learner)).lower(params, state.eval_key, count),
    )

    def compile_all() -> Programs:
        with ThreadPoolExecutor() as pool:
            return Programs(*pool.map(lambda program: program.compile(), lowered))

    return compile_all


def _evaluate(learner: Learner) -> Callable[[PolicyParams, jax.Array, jax.Array], EpisodeTotals]:
    environment, settings = learner.environment, learner.settings

    def evaluate(params: PolicyParams, key: jax.Array, update: jax.Array) -> EpisodeTotals:
        networks = make_networks(environment.observation_size, environment.action_size, settings)
        return run_episodes(
            environment,
            make_inference_fn(networks)(params, deterministic=settings.deterministic_eval),
            jax.random.fold_in(key, update),
            num_envs=settings.num_eval_envs,
            episode_length=settings.episode_length,
        )

    return evaluate
