"""PPO (Schulman et al., 2017): the state of a run, one update of it, and its `Algorithm`.

Brax's networks, loss, normaliser and distributions in a loop of our own.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jax.flatten_util import ravel_pytree
from numpy.typing import NDArray

from core.algorithms.algorithm import Failure
from core.algorithms.brax_training import (
    PPONetworkParams,
    RunningStatisticsState,
    Transition,
    init_normalizer,
    normalization,
    running_statistics,
)
from core.algorithms.checkpoint import Format, describe
from core.algorithms.evaluation import EpisodeTotals, evaluation_metrics, run_episodes
from core.algorithms.experience import (
    any_not_finite,
    bootstrap_timeouts,
    collect,
    cut_into_unrolls,
    drawn_starts,
    find_failure,
    of_whole_episodes,
    summarise,
    training_metrics,
)
from core.algorithms.policy_file import PolicyConfig, PolicyParams, write_policy
from core.algorithms.ppo.intention import LATENT_METRICS
from core.algorithms.ppo.kernels import layout
from core.algorithms.ppo.loss import (
    ADAM,
    METRICS,
    Hyperparameters,
    adapt_to_kl,
    clipped,
    descend,
    linear,
    loss_of,
    ramped,
)
from core.algorithms.ppo.networks import acting, init_params, make_networks
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.sharding import ONE_DEVICE, Sharding
from core.environments.environment import Environment
from core.environments.wrappers.action_repeat import repeat_action
from core.environments.wrappers.autoreset import Episodes, begun_at_random, start_episodes
from core.environments.wrappers.clip_parts import counted, first_record, under_record
from core.environments.wrappers.curriculum import at_progress, progress_at, progress_metrics
from core.environments.wrappers.vectorized import VectorEnv

FORMAT = Format("gaitway-ppo-2")


def header(description: Mapping[str, Any]) -> dict[str, Any]:
    """A checkpoint's header. An unset bound is left out: some checkpoints are older than the bound."""
    return {name: value for name, value in description.items() if value is not None}


# Checked after each update, in the order in which one spoils the next.
QUANTITIES = (
    "observation",
    "reward",
    "policy loss",
    "value loss",
    "entropy loss",
    "gradient",
    "parameters",
)
_LOSSES = ("policy_loss", "v_loss", "entropy_loss", "grad_norm")


@struct.dataclass
class TrainingState:
    """Everything that a run's future depends on, besides its settings.

    learning_rate: [] float32, that of the last minibatch, from which an adaptive one continues; 0 before the
    first. num_updates: [] int32, updates made so far. key: the next update's random key. eval_key: the random
    key of every evaluation, never changed. record: how often steps failed in each part of a reference's
    clips; None of a task whose starts do not follow from that.
    """

    params: PPONetworkParams
    optimizer: optax.ScaleByAdamState
    learning_rate: jax.Array
    normalizer: RunningStatisticsState
    episodes: Episodes
    key: jax.Array
    eval_key: jax.Array
    num_updates: jax.Array
    record: jax.Array | None = None


@dataclass(frozen=True)
class Learner:
    """The pure functions of a run, for one environment and the settings that fix shapes.

    sharding: the devices that share it. Except for rounding, the results do not depend on them: random
    numbers and minibatches are drawn for all environments at once, and then split. kernels: whether our own
    may take the gradient steps where they can; False is for comparing.
    """

    environment: Environment
    settings: PPOSpec
    sharding: Sharding = ONE_DEVICE
    kernels: bool = True

    def init(self, seed: jax.Array) -> TrainingState:
        """The state before the first update; seed: [] uint32."""
        seed_key = jax.random.PRNGKey(seed)
        params_key, env_key, key, eval_key = jax.random.split(seed_key, 4)
        params = init_params(self._networks(normalize=True), params_key)
        first = self._progress(jnp.int32(0))
        episodes = start_episodes(
            self._envs_at(first),
            env_key,
            self.settings.num_envs,
            keep_first=self.settings.returns_to_first_state,
        )
        if self.settings.random_initial_episode_length:
            length_key = jax.random.fold_in(seed_key, 4)  # a fifth, which leaves the other four as they are
            episodes = begun_at_random(episodes, length_key, episode_length=self.settings.actions_per_episode)
        return TrainingState(
            params=params,
            optimizer=cast("optax.ScaleByAdamState", ADAM.init(cast("Any", params))),
            learning_rate=jnp.float32(0),
            normalizer=init_normalizer(self.environment.observation_size),
            episodes=episodes,
            key=key,
            eval_key=eval_key,
            num_updates=jnp.int32(0),
            record=first_record(self.environment),
        )

    def update(
        self, state: TrainingState, hyperparameters: Hyperparameters
    ) -> tuple[TrainingState, dict[str, jax.Array], Failure]:
        """Act, update the normaliser, pass over the batch `num_updates_per_batch` times: Brax's order."""
        settings = self.settings
        act_key, learn_key, next_key, starts_key = jax.random.split(state.key, 4)
        progress = self._progress(state.num_updates)
        networks = self._networks(normalize=settings.normalize_observations)
        params = (state.normalizer, state.params.policy, state.params.value)
        policy = acting(networks, params, compute_value=self._values_are_kept)
        episodes, (transitions, outcome) = collect(
            self._envs,
            policy,
            state.episodes,
            jax.random.split(act_key, settings.actions_per_update),
            episode_length=settings.actions_per_episode,
            starts=drawn_starts(
                self._envs_at(progress, state.record),
                starts_key,
                (settings.actions_per_update, settings.num_envs),
                settings.reset_pool_size,
                self.sharding,
            ),
        )
        learnt_from = transitions
        if settings.bootstrap_on_timeout:
            learnt_from = bootstrap_timeouts(
                transitions, hyperparameters.discounting, hyperparameters.reward_scaling
            )
        batch = cut_into_unrolls(learnt_from, settings.unroll_length)
        normalizer = state.normalizer
        if settings.normalize_observations:
            normalizer = running_statistics.update(normalizer, batch.observation)
            # The policy's old and new outputs are comparable only under the same normaliser.
            seen_by = state.normalizer if self._adapts_to_kl else normalizer
            normalize = normalization(settings.normalize_observations_max_abs_value)
            batch = batch._replace(
                observation=normalize(batch.observation, seen_by),
                next_observation=normalize(batch.next_observation, seen_by),
            )
        batch = self.sharding.everywhere(batch)  # so that any device can take any part of a minibatch
        decays = settings.learning_rate_schedule == "LINEAR"
        if decays:
            hyperparameters = _decayed(hyperparameters, state.num_updates)
        if settings.network is not None:
            hyperparameters = ramped(hyperparameters, state.num_updates, settings.env_steps_per_update)
        (params, optimizer, learning_rate), metrics = self._learn(state, batch, hyperparameters, learn_key)
        if decays:
            metrics = metrics | {"learning_rate": learning_rate}
        new = TrainingState(
            params=params,
            optimizer=optimizer,
            learning_rate=learning_rate,
            normalizer=normalizer,
            episodes=episodes,
            key=next_key,
            eval_key=state.eval_key,
            num_updates=state.num_updates + 1,
            record=counted(self.environment, state.record, outcome.parts, outcome.fell),
        )
        of_losses = [~jnp.isfinite(metrics[name]) for name in _LOSSES]
        failure = find_failure(transitions.next_observation, outcome, [*of_losses, any_not_finite(params)])
        if settings.random_initial_episode_length:
            outcome = of_whole_episodes(outcome, self._actions_before(state))
        metrics = metrics | progress_metrics(progress)
        return new, summarise(outcome) | metrics, failure

    @property
    def _envs(self) -> VectorEnv:
        return VectorEnv(self.environment, self.sharding.mesh)

    def _progress(self, num_updates: jax.Array) -> jax.Array | None:
        """The curriculum's progress, if the environment has a curriculum."""
        return progress_at(self.environment, num_updates, self.settings.env_steps_per_update)

    def _envs_at(self, progress: jax.Array | None, record: jax.Array | None = None) -> VectorEnv:
        """Those whose fresh starts are those at this progress, and follow from this record."""
        starting = under_record(at_progress(self.environment, progress), record)
        return replace(self._envs, environment=starting)

    @property
    def _adapts_to_kl(self) -> bool:
        return self.settings.learning_rate_schedule == "ADAPTIVE_KL"

    @property
    def _values_are_kept(self) -> bool:
        """Whether the loss needs the values at the time of acting."""
        return self.settings.bootstrap_on_timeout or self.settings.clipping_epsilon_value is not None

    def _actions_before(self, state: TrainingState) -> jax.Array:
        """How often every environment has acted, [] int32; a lower bound beyond an episode's length."""
        per_update = self.settings.actions_per_update
        enough = -(-self.settings.actions_per_episode // per_update)
        return jnp.minimum(state.num_updates, enough) * per_update

    def _learn(
        self, state: TrainingState, batch: Transition, hyperparameters: Hyperparameters, key: jax.Array
    ) -> tuple[tuple[PPONetworkParams, optax.ScaleByAdamState, jax.Array], dict[str, jax.Array]]:
        """Several passes over a batch [unrolls, unroll_length, ...] of normalised observations.

        Returns (parameters, optimiser, learning rate) and means of the losses.
        """
        settings = self.settings
        if self.has_kernels:
            from core.algorithms.ppo.kernels.learn import learn  # Pallas takes a while to load.

            learnt, metrics = learn(settings, (state.params, state.optimizer), batch, hyperparameters, key)
            return (*learnt, hyperparameters.learning_rate), metrics
        num_unrolls = settings.batch_size * settings.num_minibatches
        loss = loss_of(settings, self._networks(normalize=False), state.normalizer, hyperparameters)
        of_latents = () if settings.network is None else LATENT_METRICS
        names = (*METRICS, *of_latents, "grad_norm", *(["learning_rate"] if self._adapts_to_kl else []))
        # One vector for all parameters, and one for all metrics: one kernel each, not one for each layer.
        vector, unpack = ravel_pytree(state.params)
        packed = state.optimizer._replace(
            mu=ravel_pytree(state.optimizer.mu)[0], nu=ravel_pytree(state.optimizer.nu)[0]
        )

        def learn_pass(carry: Any, key: jax.Array) -> tuple[Any, Any]:
            order_key, loss_key = jax.random.split(key)
            order = jax.random.permutation(order_key, num_unrolls).reshape(settings.num_minibatches, -1)
            return jax.lax.scan(learn_minibatch, carry, (order, jax.random.split(loss_key, len(order))))

        def learn_minibatch(carry: Any, batch_and_key: tuple[jax.Array, jax.Array]) -> tuple[Any, Any]:
            vector, packed, learning_rate = carry
            chosen, key = batch_and_key
            minibatch = self.sharding.split(jax.tree.map(lambda x: jnp.take(x, chosen, axis=0), batch))
            gradient, metrics = jax.grad(lambda vector: loss(unpack(vector), minibatch, key), has_aux=True)(
                vector
            )
            gradient, norm = clipped(gradient, hyperparameters.max_grad_norm)
            metrics = metrics | {"grad_norm": norm}
            if self._adapts_to_kl:
                learning_rate = adapt_to_kl(
                    learning_rate,
                    metrics["kl_mean"],
                    hyperparameters.desired_kl,
                    (
                        hyperparameters.learning_rate_schedule_min_lr,
                        hyperparameters.learning_rate_schedule_max_lr,
                    ),
                )
                metrics = metrics | {"learning_rate": learning_rate}
            vector, packed = descend(vector, packed, gradient, learning_rate)
            return (vector, packed, learning_rate), jnp.stack([metrics[name] for name in names])

        learning_rate = hyperparameters.learning_rate
        if self._adapts_to_kl:
            learning_rate = jnp.where(state.num_updates == 0, learning_rate, state.learning_rate)
        (vector, packed, learning_rate), metrics = jax.lax.scan(
            learn_pass,
            (vector, packed, learning_rate),
            jax.random.split(key, settings.num_updates_per_batch),
        )
        optimizer = packed._replace(mu=unpack(packed.mu), nu=unpack(packed.nu))
        means = dict(zip(names, jnp.mean(metrics, axis=(0, 1)), strict=True))
        return (unpack(vector), optimizer, learning_rate), means

    @property
    def has_kernels(self) -> bool:
        """Whether kernels of our own take the gradient steps."""
        environment = self.environment
        return (
            self.kernels
            and self.sharding.mesh is None
            and layout.usable()
            and layout.fits(self.settings, environment.observation_size, environment.action_size)
        )

    def _networks(self, *, normalize: bool) -> Any:
        environment = self.environment
        return make_networks(
            environment.observation_size, environment.action_size, self.settings, normalize=normalize
        )


def _decayed(hyperparameters: Hyperparameters, num_updates: jax.Array) -> Hyperparameters:
    """With the learning rate of LINEAR after so many updates."""
    learning_rate = linear(
        hyperparameters.learning_rate,
        num_updates,
        hyperparameters.num_updates,
        hyperparameters.learning_rate_schedule_min_lr,
    )
    return replace(hyperparameters, learning_rate=learning_rate)


class PPO:
    """See `core.algorithms.algorithm.Algorithm`. The policy is Brax's file of parameters.

    devices: how many share environments and each minibatch in equal parts. Raises Rejected if they cannot.
    """

    quantities = QUANTITIES
    format = FORMAT
    split_fields = ("episodes",)

    def __init__(self, environment: Environment, settings: PPOSpec, *, seed: int, devices: int = 1) -> None:
        self.settings = settings
        self.seed = jnp.uint32(seed)
        self.hyperparameters = Hyperparameters.of(settings)
        self.sharding = Sharding.over(devices, settings)
        self.description = describe(environment, settings)
        self.header = header(self.description)
        self.env_steps_per_time_step = settings.num_envs * settings.action_repeat
        self._learner = Learner(repeat_action(environment, settings.action_repeat), settings, self.sharding)

    def init(self, seed: jax.Array) -> TrainingState:
        return self._learner.init(seed)

    def update(
        self, state: TrainingState, hyperparameters: Hyperparameters
    ) -> tuple[TrainingState, dict[str, jax.Array], Failure]:
        return self._learner.update(state, hyperparameters)

    def evaluated(self, state: TrainingState) -> tuple[Any, ...]:
        """(normaliser, policy, value)."""
        return state.normalizer, state.params.policy, state.params.value

    def evaluate(self, evaluated: tuple[Any, ...], key: jax.Array, update: jax.Array) -> EpisodeTotals:
        environment, settings = self._learner.environment, self.settings
        networks = make_networks(
            environment.observation_size,
            environment.action_size,
            settings,
            normalize=settings.normalize_observations,
        )
        return run_episodes(
            environment,
            acting(networks, evaluated, deterministic=settings.deterministic_eval),
            jax.random.fold_in(key, update),
            num_envs=settings.num_eval_envs,
            episode_length=settings.actions_per_episode,
        )

    def training_metrics(
        self, state: TrainingState, sums: Mapping[str, Any], num_updates: int
    ) -> dict[str, float]:
        return training_metrics(sums, num_updates, self.settings.action_repeat)

    def after_evaluation(
        self, state: TrainingState, totals: EpisodeTotals
    ) -> tuple[TrainingState, dict[str, float]]:
        return state, evaluation_metrics(totals, self.settings.action_repeat)

    def policy(self, state: TrainingState) -> bytes:
        """(normaliser, policy, value) in the file that `brax.io.model.load_params` reads."""
        places = {"encoder_places": self.settings.encoder_places}
        config = PolicyConfig.of(self.settings.model_dump() | places)
        return write_policy(PolicyParams(state.normalizer, state.params.policy, state.params.value, config))

    def tables(self, state: TrainingState) -> Mapping[str, NDArray[Any]]:
        return {}
