"""Brittle stars held to biorobot's own environments, in equal states."""

import copy
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.environments import catalog
from core.environments.brittle_star.options import (
    BODY_OBSERVABLES,
    LIGHT_OBSERVABLES,
    TARGET_OBSERVABLES,
    DirectedOptions,
    LightEscapeOptions,
    UndirectedOptions,
)
from core.environments.environment import State
from core.physics.choose import engine_builder
from tests.extra import extra
from tests.unit.environments.brittle_star.reference import reference

NOISY: Any = {"random_initial_rotation": True, "joint_randomization_noise_scale": 0.2}
TASKS: Any = {
    "brittle_star": (DirectedOptions(walls="contacts", **NOISY), TARGET_OBSERVABLES),
    "brittle_star_undirected": (
        UndirectedOptions(actuation="torque_control", num_segments_per_arm=3, **NOISY),
        (),
    ),
    "brittle_star_light_escape": (
        LightEscapeOptions(light_perlin_noise_scale=5, light_seed=7, num_segments_per_arm=3, **NOISY),
        LIGHT_OBSERVABLES,
    ),
}


@dataclass(frozen=True)
class Case:
    environment: Any
    states: list[State]
    step: Callable[..., State]
    again: Callable[[State], jax.Array]


@cache
def walked(task: str) -> Case:
    """Our environment, and states of its way: the last ones on the ground."""
    options, _ = TASKS[task]
    environment: Any = catalog.make(catalog.find(task), options, engine_builder("native"))
    step: Callable[..., State] = jax.jit(environment.step)
    state = jax.jit(environment.reset)(jax.random.key(5))
    states = [state]
    for index in range(60):
        action = jax.random.uniform(jax.random.key(index), (environment.action_size,), minval=-1.0)
        state = step(state, action)
        if index % 10 == 9:
            states.append(state)
    return Case(environment, states, step, jax.jit(partial(observed, environment)))


def observed(environment: Any, state: State) -> jax.Array:
    """The observation in these positions and velocities, at rest otherwise, with the same target."""
    physics = environment.engine.reset(state.physics.qpos, state.physics.qvel)
    return environment._observe(physics, environment._task.measure(physics, state.info))


@pytest.mark.parametrize("task", ["brittle_star", *extra(*list(TASKS)[1:])])
def test_equal_states_are_observed_as_biorobot_observes_them(task: str) -> None:
    case, (options, of_the_task) = walked(task), TASKS[task]
    theirs = reference(task, options)
    touching = 0
    for state in case.states:
        seen = theirs.put(state.physics.qpos, state.physics.qvel, state.info.get("target_position"))
        values = [np.ravel(seen.observations[name]) for name in (*BODY_OBSERVABLES, *of_the_task)]
        touching += int(np.sum(seen.observations["segment_contact"] > 0))
        ours = case.again(state)
        # Both begin with the same float32 numbers and reckon in float64; ours come back as float32.
        np.testing.assert_allclose(ours, np.concatenate(values), rtol=1e-5, atol=1e-5)
    assert touching >= 5


@pytest.mark.parametrize("task", ["brittle_star", *extra(*list(TASKS)[1:])])
def test_equal_steps_are_rewarded_as_biorobot_rewards_them(task: str) -> None:
    case, (options, _) = walked(task), TASKS[task]
    theirs = reference(task, options)
    for index, before in enumerate(case.states):
        action = jax.random.uniform(jax.random.key(index), (case.environment.action_size,), minval=-1.0)
        after = case.step(before, action)
        target = before.info.get("target_position")
        # biorobot steps one MjData in place: the state before keeps a copy of its own.
        state = theirs.put(before.physics.qpos, before.physics.qvel, target)
        previous = state.replace(mj_data=copy.copy(state.mj_data))
        state = theirs.put(after.physics.qpos, after.physics.qvel, target)
        rewarded = theirs.environment._update_reward(state, previous)
        np.testing.assert_allclose(after.reward, rewarded.reward, atol=1e-6)
        assert bool(after.done) == bool(theirs.environment._update_terminated(state).terminated)


def test_within_the_targets_edge_the_episode_ends_as_biorobots_does() -> None:
    task, (options, _) = "brittle_star", TASKS["brittle_star"]
    case, theirs = walked(task), reference("brittle_star", options)
    physics = case.states[0].physics
    for distance, reached in ((0.199, True), (0.201, False)):
        target = physics.qpos[:3] + jnp.array([0.0, distance, 0.0])
        measured = case.environment._task.measure(physics, {"target_position": target})
        state = theirs.put(physics.qpos, physics.qvel, target)
        assert bool(theirs.environment._update_terminated(state).terminated) == reached
        assert bool(measured.done) == reached


@pytest.mark.parametrize("task", ["brittle_star", "brittle_star_undirected"])
def test_it_moves_as_biorobots_model_does_on_plain_mujoco(task: str) -> None:
    # The first has the free joint and the walls of biorobot, the second slides, a ball and no contacts with
    # walls, from which it is far: equal coordinates, equal motion. Where float32 rounds a state, contacts
    # that are 1e-7 m deeper push harder; after ten steps places differ by less than a hundredth of a mm.
    case = walked(task)
    theirs = reference(task, TASKS[task][0]).state
    model, data = theirs.mj_model, theirs.mj_data
    for before in case.states[::2]:
        action = jax.random.uniform(jax.random.key(1), (case.environment.action_size,), minval=-1.0)
        low, high = model.actuator_ctrlrange.T
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = before.physics.qpos, before.physics.qvel
        data.qacc_warmstart[:] = before.physics.qacc_warmstart
        data.ctrl[:] = low + (np.asarray(action) + 1) * (high - low) / 2
        mujoco.mj_step(model, data, 10)
        after = case.step(before, action)
        np.testing.assert_allclose(after.physics.qpos, data.qpos, atol=1e-5)
        np.testing.assert_allclose(after.physics.qvel, data.qvel, atol=1e-3)
        force = data.qfrc_actuator[6:]
        np.testing.assert_allclose(after.physics.derived["qfrc_actuator"][6:], force, atol=1e-3)
