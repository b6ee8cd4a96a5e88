"""A rollout job: episodes of a policy, their trajectory, recording, summary, replay, video and battery."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax

from core.algorithms.activations import ActivationReader
from core.algorithms.trained_policy import TrainedPolicy, load_policy, policy_from_checkpoint
from core.environments import trajectory
from core.environments.environment import Environment
from core.environments.rollout import (
    ParametricPolicy,
    Roller,
    constant_policy,
    filmed,
    random_policy,
    trajectory_of,
    zero_policy,
)
from core.environments.trajectory import Episode
from core.errors import JobFailed
from core.jobs.spec import CheckpointPolicy, ConstantPolicy, RandomPolicy, RolloutSpec, ZeroPolicy
from core.reasons import Reason
from worker.protocol import Advanced, Measured, Noted, PhaseBegan, Task
from worker.stopping import StopRequest
from worker.training.battery import BatteryWriter
from worker.training.built_environment import BuiltEnvironment
from worker.training.event_writer import EventWriter
from worker.training.pictures import kept_with_path
from worker.training.recording import recorded
from worker.training.video import ReplayWriter, VideoRecorder

# Episodes that run side by side.
_MAX_ENVS = 64


def roll_out(
    task: Task, spec: RolloutSpec, built: BuiltEnvironment, events: EventWriter, stopping: StopRequest
) -> bool:
    """Act, record and draw; returns whether a stop cut it short. The episodes until then are kept.

    Nothing is kept for an attempt elsewhere, which starts again. Raises JobFailed("diverged").
    """
    events.send(built.started(policy=spec.policy.model_dump()))
    if differs := built.other_versions(task.made_with):
        events.send(Noted(text=differs))
    policy, env, activations = actor(task, spec, built, events)
    whole, built = built, replace(built, environment=env)
    events.send(PhaseBegan(phase="acting"))
    with recorded(task, spec, built, activations, events) as record:
        episodes = _act(spec, built, policy, events, stopping, record)
    differs = (
        {"randomization": [rule.model_dump() for rule in spec.randomization]} if spec.randomization else {}
    )
    shown = trajectory_of(
        built.environment,
        episodes,
        environment=spec.environment.model_dump(),
        policy=spec.policy.model_dump(),
        seed=spec.seed,
        **differs,
    )
    with kept_with_path(events, shown, "", None, f"{spec.environment.id}: path from above"):
        summary = trajectory.summary(shown)
        events.keep(
            "summary.json",
            json.dumps(summary, indent=2, allow_nan=False).encode(),
            "summary",
            "application/json",
        )
        _report(summary, events)
        replays = ReplayWriter(built, events)
        replays.keep(episodes, "", None)
        if spec.video is not None:
            events.send(PhaseBegan(phase="drawing"))
            roller = Roller(built.environment, policy, num_envs=spec.video.episodes)
            film = VideoRecorder(spec, spec.video, built, roller, events, replays)
            of_video = filmed(
                episodes,
                dt=built.environment.dt,
                seconds=spec.video.seconds,
                num_at_once=spec.video.episodes,
            )
            film.show("video", of_video, None)
    if spec.battery is not None and not stopping.asked:
        events.send(PhaseBegan(phase="testing"))
        writer = BatteryWriter(spec.battery, whole, lambda: stopping.asked)
        metrics = writer.test(spec, partial(trained_policy, task, spec, events), None, events)
        if metrics:
            events.send(Measured(step=_steps(episodes), values=dict(metrics)))
    return len(episodes) < spec.num_episodes


def _act(
    spec: RolloutSpec,
    built: BuiltEnvironment,
    policy: ParametricPolicy,
    events: EventWriter,
    stopping: StopRequest,
    record: Callable[[Episode], None],
) -> list[Episode]:
    """The episodes asked for; after a stop, those that have ended by then. record: is given each of them.

    Raises JobFailed("diverged").
    """
    key = jax.random.PRNGKey(spec.seed)
    num_envs = min(spec.num_episodes, _MAX_ENVS)
    roller = Roller(built.environment, policy, num_envs=num_envs)
    episodes = list[Episode]()
    for episode in roller.episodes(None, key, num_steps=spec.num_steps, num_episodes=spec.num_episodes):
        if (found := trajectory.not_finite(episode)) is not None:
            raise _diverged(len(episodes), *found)
        record(episode)
        episodes.append(episode)
        if len(episodes) % num_envs == 0:
            events.send(Advanced(step=_steps(episodes), total=spec.num_steps * spec.num_episodes))
        if stopping.asked:
            break
    return episodes


def _steps(episodes: Sequence[Episode]) -> int:
    return sum(episode.num_steps for episode in episodes)


def _diverged(episode: int, step: int, quantity: str) -> JobFailed:
    return JobFailed(
        Reason.DIVERGED,
        f"The {quantity} became non-finite at step {step} of episode {episode}.",
        step=step,
        quantity=quantity,
    )


class Actor(NamedTuple):
    """A policy, which ignores its parameters, and the environment that it acts in. activations: see
    `TrainedPolicy`."""

    policy: ParametricPolicy
    environment: Environment
    activations: Callable[[], ActivationReader] | None = None


def actor(task: Task, spec: RolloutSpec, built: BuiltEnvironment, events: EventWriter) -> Actor:
    """The policy that the job names. Raises JobFailed where its file is damaged."""
    size = built.environment.action_size
    match spec.policy:
        case CheckpointPolicy():
            trained = trained_policy(task, spec, events)
            env, act = trained.acting(built.environment)
            return Actor(lambda _, state, key: act(trained.parameters, state, key), env, trained.activations)
        case RandomPolicy():
            policy = random_policy(size)
        case ZeroPolicy():
            policy = zero_policy(size)
        case ConstantPolicy(action=action):
            policy = constant_policy(action)
    return Actor(lambda _, state, key: policy(state.obs, key), built.environment)


def trained_policy(task: Task, spec: RolloutSpec, events: EventWriter) -> TrainedPolicy:
    """The policy of the checkpoint that the task names. Raises JobFailed where its file is damaged."""
    content = (events.spool / str(task.checkpoint)).read_bytes()
    if task.policy_of is None:
        return policy_from_checkpoint(content, deterministic=spec.deterministic, seed=task.policy_seed)
    return load_policy(content, task.policy_of, is_checkpoint=False, deterministic=spec.deterministic)


def _report(summary: dict[str, Any], events: EventWriter) -> None:
    steps = sum(row["num_steps"] for row in summary["episodes"])
    values = {
        "eval/episode_reward": summary["mean"]["return"],
        "eval/episode_reward_std": summary["std"]["return"],
        "eval/avg_episode_length": summary["mean"]["num_steps"],
        "eval/forward_speed": summary["mean"]["forward_speed_m_s"],
    }
    events.send(Measured(step=steps, values=values))
    events.send(Advanced(step=steps, total=steps, eta_s=0.0))
