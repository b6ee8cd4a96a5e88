"""Distillation by DAgger: the state of a run, one update of it, and its `Algorithm`.

The student acts; in a share of the steps, `beta`, the expert acts in its place. In every state that either
comes to, the expert says what it would do there. The loss is the mean squared difference between the modes of
student and expert, after tanh, as the body gets the actions: before tanh, an expert that pushes with all its
force would count most, though the body cannot push beyond its limit. The student's deviation is not learnt,
because it acts by its mode. An update learns from the states that it has just collected; Ross et al. keep
all.

Source: Ross et al., A Reduction of Imitation Learning and Structured Prediction to No-Regret Online Learning
(2011), algorithm 3.1; an intention network's terms of the loss are those of `core.algorithms.ppo.intention`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, cast

import jax
import jax.numpy as jnp
import optax
from flax import struct
from numpy.typing import NDArray

from core.algorithms.algorithm import Failure
from core.algorithms.brax_training import RunningStatisticsState, init_normalizer, running_statistics
from core.algorithms.checkpoint import Format, describe
from core.algorithms.distillation.experts import Experts, Seen
from core.algorithms.distillation.spec import DistillationSpec
from core.algorithms.evaluation import EpisodeTotals, evaluation_metrics, run_episodes
from core.algorithms.experience import (
    any_not_finite,
    collect,
    drawn_starts,
    find_failure,
    summarise,
    training_metrics,
)
from core.algorithms.policy_file import PolicyConfig, PolicyParams, write_policy
from core.algorithms.ppo import policy
from core.algorithms.ppo.intention import LATENT_METRICS, IntentionPolicy
from core.algorithms.ppo.loss import ADAM, clipped, descend, ramped
from core.algorithms.ppo.networks import acting, make_networks
from core.algorithms.sharding import ONE_DEVICE
from core.algorithms.trained_policy import TrainedPolicy
from core.environments.environment import Environment
from core.environments.wrappers.autoreset import Episodes, start_episodes
from core.environments.wrappers.clip_parts import counted, first_record, under_record
from core.environments.wrappers.curriculum import at_progress, progress_at, progress_metrics
from core.environments.wrappers.vectorized import VectorEnv

FORMAT = Format("gaitway-distillation-1")
load = partial(policy.load, form=FORMAT)


@struct.dataclass
class TrainingState:
    """Everything that a run's future depends on, besides its settings and its experts: see PPO's.

    params: of the student's network, as `policy`.
    """

    params: Mapping[str, Any]
    optimizer: optax.ScaleByAdamState
    normalizer: RunningStatisticsState
    episodes: Episodes
    key: jax.Array
    eval_key: jax.Array
    num_updates: jax.Array
    record: jax.Array | None = None


@struct.dataclass
class Hyperparameters:
    """What may change without recompiling: numbers, [] float32 each, and the experts' parameters."""

    learning_rate: jax.Array
    max_grad_norm: jax.Array
    beta: jax.Array
    beta_steps: jax.Array
    kl_weight: jax.Array
    kl_ramp_steps: jax.Array
    smoothness_weight: jax.Array
    experts: tuple[Any, ...]

    @classmethod
    def of(cls, settings: DistillationSpec, experts: Experts) -> "Hyperparameters":
        network, half = settings.network, settings.num_timesteps / 2
        numbers = {
            "learning_rate": settings.learning_rate,
            "max_grad_norm": jnp.inf if settings.max_grad_norm is None else settings.max_grad_norm,
            "beta": settings.beta,
            "beta_steps": half if settings.beta_steps is None else settings.beta_steps,
            "kl_weight": network.kl_weight if network else 0.0,
            "kl_ramp_steps": network.kl_ramp_steps if network else 0.0,
            "smoothness_weight": network.smoothness_weight if network else 0.0,
        }
        return cls(
            **{name: jnp.float32(number) for name, number in numbers.items()}, experts=experts.parameters
        )

    def beta_after(self, steps: jax.Array) -> jax.Array:
        """The share [] of the actions that are the expert's. steps: [], environment steps taken before."""
        left = jnp.clip(1.0 - steps / jnp.maximum(self.beta_steps, 1.0), 0.0, 1.0)
        return jnp.where(self.beta_steps > 0, self.beta * left, 0.0)


class Distillation:
    """See `core.algorithms.algorithm.Algorithm`. Its policy is a file like PPO's, without a value function.

    experts: the policies of `settings.experts`, deterministic. Raises Rejected, and JobFailed where one does
    not fit the environment.
    """

    quantities = ("observation", "reward", "loss", "gradient", "parameters")
    format = FORMAT
    split_fields = ("episodes",)
    sharding = ONE_DEVICE

    def __init__(
        self,
        environment: Environment,
        settings: DistillationSpec,
        *,
        seed: int,
        devices: int = 1,
        experts: Sequence[TrainedPolicy] = (),
    ) -> None:
        settings.check_sharing(devices)
        self.environment = environment
        self.settings = settings
        self.seed = jnp.uint32(seed)
        self._experts = Experts.of(environment, settings, experts)
        self.hyperparameters = Hyperparameters.of(settings, self._experts)
        self.description = describe(environment, settings)
        self.header = {name: value for name, value in self.description.items() if value is not None}
        self.env_steps_per_time_step = settings.num_envs
        self._networks: Any = make_networks(
            environment.observation_size,
            environment.action_size,
            settings.as_ppo,
            normalize=settings.normalize_observations,
        )

    def init(self, seed: jax.Array) -> TrainingState:
        """The state before the first update; seed: [] uint32."""
        params_key, env_key, key, eval_key = jax.random.split(jax.random.PRNGKey(seed), 4)
        params = {"policy": self._networks.policy_network.init(params_key)}
        starting = at_progress(self.environment, self._progress(jnp.int32(0)))
        return TrainingState(
            params=params,
            optimizer=cast("optax.ScaleByAdamState", ADAM.init(cast("Any", params))),
            normalizer=init_normalizer(self.environment.observation_size),
            episodes=start_episodes(VectorEnv(starting), env_key, self.settings.num_envs, keep_first=False),
            key=key,
            eval_key=eval_key,
            num_updates=jnp.int32(0),
            record=first_record(self.environment),
        )

    def update(
        self, state: TrainingState, hyperparameters: Hyperparameters
    ) -> tuple[TrainingState, dict[str, jax.Array], Failure]:
        """Act, ask the experts, update the normaliser, and pass over all that was seen."""
        settings, experts = self.settings, self._experts
        act_key, learn_key, next_key, starts_key = jax.random.split(state.key, 4)
        progress = self._progress(state.num_updates)
        beta = hyperparameters.beta_after(
            state.num_updates.astype(jnp.float32) * settings.env_steps_per_update
        )

        def act(seen: Seen, key: jax.Array) -> tuple[jax.Array, Any]:
            who_key, latent_key = jax.random.split(key)
            own, _ = self._student(state.normalizer, state.params["policy"], seen.observation, latent_key)
            wanted = experts.actions(hyperparameters.experts, seen)
            is_experts = jax.random.uniform(who_key, (len(own), 1)) < beta
            return jnp.where(is_experts, wanted, own), {"wanted": wanted}

        starting = VectorEnv(under_record(at_progress(self.environment, progress), state.record))
        shape = (settings.unroll_length, settings.num_envs)
        episodes, (transitions, outcome) = collect(
            VectorEnv(self.environment),
            act,
            state.episodes,
            jax.random.split(act_key, settings.unroll_length),
            episode_length=settings.episode_length,
            starts=drawn_starts(starting, starts_key, shape, settings.reset_pool_size),
            seen=experts.seen,
        )
        extras = cast("Any", transitions.extras)
        truncation = extras["state_extras"]["truncation"]
        batch = {
            "observation": cast("Seen", transitions.observation).observation,
            "wanted": extras["policy_extras"]["wanted"],
            "continues": transitions.discount * (1 - truncation),
        }
        normalizer = state.normalizer
        if settings.normalize_observations:
            normalizer = running_statistics.update(normalizer, batch["observation"])
        if settings.network is not None:
            steps = settings.env_steps_per_update
            hyperparameters = ramped(cast("Any", hyperparameters), state.num_updates, steps)  # pyright: ignore[reportAssignmentType]
        learnt, metrics = self._learn(state, normalizer, batch, hyperparameters, learn_key)
        new = replace(
            state,
            params=learnt[0],
            optimizer=learnt[1],
            normalizer=normalizer,
            episodes=episodes,
            key=next_key,
            num_updates=state.num_updates + 1,
            record=counted(self.environment, state.record, outcome.parts, outcome.fell),
        )
        of_learning = [~jnp.isfinite(metrics[name]) for name in ("total_loss", "grad_norm")]
        failure = find_failure(
            transitions.next_observation, outcome, [*of_learning, any_not_finite(learnt[0])]
        )
        return new, summarise(outcome) | metrics | {"beta": beta} | progress_metrics(progress), failure

    def _progress(self, num_updates: jax.Array) -> jax.Array | None:
        """The curriculum's progress, if the environment has a curriculum."""
        return progress_at(self.environment, num_updates, self.settings.env_steps_per_update)

    def _student(
        self, normalizer: Any, params: Any, observation: Any, key: jax.Array
    ) -> tuple[jax.Array, Any]:
        """The modes of the student's actions [..., action_size] for observations [..., n], and the
        distribution of its intentions, which it draws with the key; None for a network without an encoder."""
        network, latent = self._networks.policy_network, None
        if isinstance(network, IntentionPolicy):
            latent = network.encode(normalizer, params, observation)
            z = latent.sample(network.noise(key, observation))
            logits = network.decode(params, z, latent.body)
        else:
            logits = network.apply(normalizer, params, observation)
        return self._networks.parametric_action_distribution.mode(logits), latent

    def _loss(
        self, params: Any, normalizer: Any, minibatch: Any, costs: Hyperparameters, key: jax.Array
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """The loss [] and its metrics. minibatch: [T, B, ...], as `update` makes a batch."""
        action, latent = self._student(normalizer, params["policy"], minibatch["observation"], key)
        error = jnp.mean(jnp.square(action - minibatch["wanted"]))
        metrics = {"total_loss": error, "action_error": error}
        if latent is not None:
            divergence, moved = jnp.mean(latent.divergence), latent.step(minibatch["continues"])
            metrics["total_loss"] += costs.kl_weight * divergence + costs.smoothness_weight * moved
            values = (divergence, jnp.mean(jnp.exp(latent.log_std)), moved, costs.kl_weight)
            metrics |= dict(zip(LATENT_METRICS, values, strict=True))
        return metrics["total_loss"], metrics

    def _learn(
        self, state: TrainingState, normalizer: Any, batch: Any, costs: Hyperparameters, key: jax.Array
    ) -> tuple[tuple[Any, optax.ScaleByAdamState], dict[str, jax.Array]]:
        """Several passes over a batch [T, N, ...]: (parameters, optimiser), and means of the metrics."""
        settings = self.settings

        def learn_pass(carry: Any, key: jax.Array) -> tuple[Any, Any]:
            order_key, loss_key = jax.random.split(key)
            order = jax.random.permutation(order_key, settings.num_envs).reshape(settings.num_minibatches, -1)
            return jax.lax.scan(learn_minibatch, carry, (order, jax.random.split(loss_key, len(order))))

        def learn_minibatch(carry: Any, chosen_and_key: tuple[jax.Array, jax.Array]) -> tuple[Any, Any]:
            params, optimizer = carry
            chosen, key = chosen_and_key
            minibatch = jax.tree.map(lambda x: jnp.take(x, chosen, axis=1), batch)
            gradient, metrics = jax.grad(self._loss, has_aux=True)(params, normalizer, minibatch, costs, key)
            gradient, norm = clipped(gradient, costs.max_grad_norm)
            return descend(params, optimizer, gradient, costs.learning_rate), metrics | {"grad_norm": norm}

        keys = jax.random.split(key, settings.num_updates_per_batch)
        learnt, metrics = jax.lax.scan(learn_pass, (state.params, state.optimizer), keys)
        return learnt, jax.tree.map(jnp.mean, metrics)

    def evaluated(self, state: TrainingState) -> tuple[Any, ...]:
        """(normaliser, policy, no value function)."""
        return state.normalizer, state.params["policy"], {}

    def evaluate(self, evaluated: tuple[Any, ...], key: jax.Array, update: jax.Array) -> EpisodeTotals:
        return run_episodes(
            self.environment,
            acting(self._networks, evaluated, deterministic=True),
            jax.random.fold_in(key, update),
            num_envs=self.settings.num_eval_envs,
            episode_length=self.settings.episode_length,
        )

    def training_metrics(
        self, state: TrainingState, sums: Mapping[str, Any], num_updates: int
    ) -> dict[str, float]:
        return training_metrics(sums, num_updates, 1)

    def after_evaluation(
        self, state: TrainingState, totals: EpisodeTotals
    ) -> tuple[TrainingState, dict[str, float]]:
        return state, evaluation_metrics(totals)

    def policy(self, state: TrainingState) -> bytes:
        """A file like PPO's, with nothing in place of the value function."""
        config = PolicyConfig.of(
            self.settings.model_dump() | {"encoder_places": self.settings.encoder_places}
        )
        return write_policy(PolicyParams(state.normalizer, state.params["policy"], {}, config))

    def tables(self, state: TrainingState) -> Mapping[str, NDArray[Any]]:
        return {}
