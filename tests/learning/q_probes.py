"""Environments for tables: finite decision processes with a known optimum, and a star that slides."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.algorithms.q_learning.spec import QLearningSpec
from core.algorithms.run import Run, make_run
from core.environments.brittle_star.environment import towards_target
from core.environments.environment import CONTINUOUS, Discretization, Environment, State
from core.physics.engine import NOMINAL, ModelFields
from tests.probes import nowhere


@dataclass(frozen=True)
class FiniteProcess:
    """Observed is the number of the state; the sign of the action chooses the column, 0 or 1.

    following, rewards, ends: [S][2], what comes of each choice. It begins in state 0.
    """

    following: tuple[tuple[int, int], ...]
    rewards: tuple[tuple[float, float], ...]
    ends: tuple[tuple[int, int], ...]
    observation_size: int = 1
    action_size: int = 1
    dt: float = 1.0
    episode_length: int = 8
    tracked_body: int = 0
    discretization: Discretization = CONTINUOUS

    @cached_property
    def model(self) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string("<mujoco/>")

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        zero = jnp.zeros(())
        return State(nowhere(model), jnp.zeros(1), zero, zero, {}, {})

    def step(self, state: State, action: jax.Array) -> State:
        here, column = state.obs[0].astype(jnp.int32), (action[0] > 0).astype(jnp.int32)
        number = [jnp.asarray(table)[here, column] for table in (self.following, self.rewards, self.ends)]
        following, reward, end = (value.astype(jnp.float32) for value in number)
        return replace(state, obs=following[None], reward=reward, done=end)

    def values(self, discounting: float) -> np.ndarray:
        """Q* [S, 2] by value iteration. Source: Sutton & Barto (2018), section 4.4."""
        rewards, ends, best = (
            np.asarray(self.rewards),
            np.asarray(self.ends),
            np.zeros((len(self.rewards), 2)),
        )
        for _ in range(10_000):
            best = rewards + discounting * (1 - ends) * best.max(axis=1)[np.asarray(self.following)]
        return best


def two_rooms(*, breaks: bool = False) -> FiniteProcess:
    """In room 0, column 0 stays for 0.4 and column 1 goes to room 1 for 0. There, column 0 goes back for 0
    and column 1 ends the episode with 2, or with what is no number."""
    return FiniteProcess(
        following=((0, 1), (0, 1)),
        rewards=((0.4, 0.0), (0.0, np.nan if breaks else 2.0)),
        ends=((0, 0), (0, 1)),
    )


@dataclass(frozen=True)
class PlanarStar:
    """A disk with arms, of which each pulls the disk along itself by `speed` m/s times its action.

    Its `info` is that of the brittle stars; the rotation and the direction of the target, 1 m away, are
    drawn. The reward is by how much the target comes nearer. It ends within 0.2 m.
    """

    num_arms: int = 5
    speed: float = 1.0
    observation_size: int = 1
    dt: float = 0.05
    episode_length: int = 100
    tracked_body: int = 0

    @property
    def action_size(self) -> int:
        return self.num_arms

    @property
    def discretization(self) -> Discretization:
        return towards_target(self.num_arms)

    @cached_property
    def model(self) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string("<mujoco/>")

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        rotation, bearing = jax.random.uniform(key, (2,), minval=-jnp.pi, maxval=jnp.pi)
        zero = jnp.zeros(())
        info = _of_the_star(jnp.zeros(2), rotation, jnp.stack([jnp.cos(bearing), jnp.sin(bearing)]))
        return State(nowhere(model), zero[None], zero, zero, {}, info)

    def step(self, state: State, action: jax.Array) -> State:
        info = state.info
        rotation = info["disk_rotation"][2]
        angles = rotation + 2 * jnp.pi * jnp.arange(self.num_arms) / self.num_arms
        pull = jnp.stack([action @ jnp.cos(angles), action @ jnp.sin(angles)])
        place = info["disk_position"][:2] + self.speed * self.dt * pull
        after = _of_the_star(place, rotation, info["target_position"])
        nearer = info["xy_distance_to_target"] - after["xy_distance_to_target"]
        done = (after["xy_distance_to_target"] < 0.2).astype(jnp.float32)
        return replace(state, info=after, reward=nearer, done=done)


def _of_the_star(place: jax.Array, rotation: jax.Array, target: jax.Array) -> Mapping[str, jax.Array]:
    way = target - place
    distance = jnp.linalg.norm(way)
    return {
        "disk_position": jnp.append(place, 0.1),
        "disk_rotation": jnp.zeros(3).at[2].set(rotation),
        "xy_direction_to_target": way / distance,
        "xy_distance_to_target": distance,
        "target_position": target,
    }


FINITE: dict[str, Any] = {
    "state_discretizer": {
        "kind": "observation_grid",
        "components": [{"index": 0, "range": [-0.5, 1.5], "cells": 2}],
    },
    "action_set": {"kind": "actions", "actions": [[-1.0], [1.0]]},
    "num_episodes": 40,
    "num_envs": 8,
    "decisions_per_episode": 6,
    "decision_steps": 1,
    "learning_rate": 0.5,
    "discounting": 0.5,
    "epsilon": {"start": 1.0, "end": 1.0},
    "num_evals": 1,
    "num_eval_envs": 2,
}
STAR: dict[str, Any] = {
    "state_discretizer": {"kind": "arm_towards_target"},
    "action_set": {"kind": "actions", "actions": np.eye(5).tolist()},
    "num_episodes": 60,
    "num_envs": 10,
    "decisions_per_episode": 20,
    "decision_steps": 5,
    "num_evals": 1,
    "num_eval_envs": 20,
}


def q_settings(common: Mapping[str, Any] = FINITE, **changes: Any) -> QLearningSpec:
    return QLearningSpec.model_validate({**common, **changes})


def q_run(
    environment: Environment,
    settings: QLearningSpec,
    *,
    seed: int = 0,
    checkpoint_every_steps: int | None = None,
    resume: bytes | None = None,
    epoch_s: float = 1.0,
) -> Run[Any]:
    return make_run(
        environment,
        settings,
        seed=seed,
        checkpoint_every_steps=checkpoint_every_steps,
        resume=resume,
        epoch_s=epoch_s,
    )
