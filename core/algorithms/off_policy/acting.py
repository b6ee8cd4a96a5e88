"""The first half of an update: environments act, and what they see is kept."""

from collections.abc import Mapping
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp

from core.algorithms.brax_training import (
    RunningStatisticsState,
    Transition,
    init_normalizer,
    normalization,
    running_statistics,
)
from core.algorithms.evaluation import Policy
from core.algorithms.experience import StepOutcomes, collect, drawn_starts
from core.algorithms.off_policy import replay as replays
from core.algorithms.off_policy.spec import OffPolicySpec
from core.environments.environment import Environment
from core.environments.wrappers.autoreset import Episodes, start_episodes
from core.environments.wrappers.clip_parts import counted, first_record, under_record
from core.environments.wrappers.curriculum import at_progress, progress_at
from core.environments.wrappers.vectorized import VectorEnv


class Experience(NamedTuple):
    """The experience of a run: statistics of all observations, the transitions that are kept, where each
    environment is in its episode, and how often steps failed in each part of a reference's clips; None of a
    task whose starts do not follow from that."""

    normalizer: RunningStatisticsState
    replay: replays.Replay
    episodes: Episodes
    record: jax.Array | None = None


class Acted(NamedTuple):
    """The result of one update's acting. enough: [] bool, whether there are transitions to learn from."""

    transitions: Transition
    outcome: StepOutcomes
    enough: jax.Array


def first_experience(
    environment: Environment, settings: OffPolicySpec, key: jax.Array, numbers_per_action: int
) -> Experience:
    """Fresh episodes and an empty replay, whose rows keep this number of an action's numbers."""
    size = observation_size(environment, settings)
    starting = at_progress(environment, progress(environment, settings, jnp.int32(0)))
    return Experience(
        normalizer=init_normalizer(size),
        replay=replays.empty(settings.replay_rows, settings.num_envs, size, numbers_per_action),
        episodes=start_episodes(
            VectorEnv(starting), key, settings.num_envs, keep_first=settings.returns_to_first_state
        ),
        record=first_record(environment),
    )


def act(
    environment: Environment,
    settings: OffPolicySpec,
    policy: Policy,
    before: Experience,
    keys: tuple[jax.Array, jax.Array],
    at: jax.Array | None,
) -> tuple[Experience, Acted]:
    """Act `unroll_length` times in each environment. policy: its extras hold, as `action`, what is kept.
    keys: for acting, and for fresh starts. at: the progress of the curriculum, if there is one."""
    act_key, starts_key = keys
    starting = VectorEnv(under_record(at_progress(environment, at), before.record))
    episodes, (transitions, outcome) = collect(
        VectorEnv(environment),
        policy,
        before.episodes,
        jax.random.split(act_key, settings.unroll_length),
        episode_length=settings.actions_per_episode,
        starts=drawn_starts(
            starting, starts_key, (settings.unroll_length, settings.num_envs), settings.reset_pool_size
        ),
    )
    normalizer = before.normalizer
    if settings.normalize_observations:
        normalizer = running_statistics.update(normalizer, transitions.observation)
    replay = replays.added(before.replay, _rows(transitions, outcome))
    # Counted for one environment: those of all pass 2**31 in a long run.
    enough = replay.written >= -(-settings.min_replay_size // settings.num_envs)
    enough &= replay.written > settings.n_step
    record = counted(environment, before.record, outcome.parts, outcome.fell)
    return Experience(normalizer, replay, episodes, record), Acted(transitions, outcome, enough)


def progress(environment: Environment, settings: OffPolicySpec, num_updates: jax.Array) -> jax.Array | None:
    """The curriculum's progress after `num_updates` [] int32, from 0 to 1; None without a curriculum."""
    return progress_at(environment, num_updates, settings.env_steps_per_update)


def normalize(settings: OffPolicySpec, normalizer: RunningStatisticsState) -> Any:
    """Raw observations as the networks take them."""
    if not settings.normalize_observations:
        return lambda observation: observation
    normalized = normalization(settings.normalize_observations_max_abs_value)
    return lambda observation: normalized(observation, normalizer)


def observation_size(environment: Environment, settings: OffPolicySpec) -> int:
    """Raises ValueError where the environment has several observations by name."""
    size = environment.observation_size
    if isinstance(size, Mapping):
        kind = settings.algorithm()
        raise ValueError(f"{kind} learns from one observation; there are {sorted(size)}.")
    return size


def _rows(transitions: Transition, outcome: StepOutcomes) -> replays.ReplayRows:
    extras = cast("Any", transitions.extras)
    return replays.ReplayRows(
        observation=cast("Any", transitions.observation),
        action=extras["policy_extras"]["action"],
        reward=transitions.reward,
        ended=outcome.fell,
        truncated=extras["state_extras"]["truncation"],
    )
