"""Exported policies of every environment: on 1,000 observations they act as in JAX."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from core.algorithms.catalog import ALGORITHMS, resolve
from core.environments import catalog
from core.environments.dm_control.corridor.walkers import WALKERS
from core.environments.environment import Environment
from core.environments.info import EnvironmentInfo
from core.physics.choose import engine_builder
from tests.exports import Numbers, assert_acts_as_in_jax
from tests.unit.environments.mjcf import probe

BODIES = [name for name, info in catalog.BUILT_IN.items() if not info.takes_model]
# Its physics is compiled and stepped within a second.
QUICK = ("inverted_pendulum",)
# One of each that is compiled within a minute.
OF_OTHER_PACKAGES = ("playground/PendulumSwingup", "brax/inverted_pendulum")
NUM_ENVS, NUM_STEPS = 20, 50


def some_states(environment: Environment) -> Numbers:
    """The observations of 20 episodes of random actions, [1000, observation_size]."""

    def step(state: Any, key: jax.Array) -> tuple[Any, jax.Array]:
        actions = jax.random.uniform(key, (NUM_ENVS, environment.action_size), minval=-1.0, maxval=1.0)
        return jax.vmap(environment.step)(state, actions), state.obs

    @jax.jit
    def episodes(key: jax.Array) -> jax.Array:
        start, steps = jax.random.split(key)
        state = jax.vmap(environment.reset)(jax.random.split(start, NUM_ENVS))
        return jax.lax.scan(step, state, jax.random.split(steps, NUM_STEPS))[1]

    seen = np.asarray(episodes(jax.random.key(0)))
    assert np.isfinite(seen).all()
    return seen.reshape(-1, seen.shape[-1])


def assert_exports_act_alike(info: EnvironmentInfo, action_size: int, seen: Numbers) -> None:
    """With the networks that PPO and SAC have for this body on a CPU."""
    assert len(seen) == 1000
    for algorithm in ("ppo", "sac"):
        settings = resolve(ALGORITHMS[algorithm].spec(), info, "cpu")
        assert_acts_as_in_jax(settings, seen, action_size)


@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(
    "environment_id",
    [
        *(pytest.param(name, marks=[] if name in QUICK else [pytest.mark.slow]) for name in BODIES),
        *(pytest.param(name, marks=[pytest.mark.slow]) for name in OF_OTHER_PACKAGES),
    ],
)
def test_exported_policies_act_as_in_jax_on_a_thousand_states(environment_id: str) -> None:
    info = catalog.find(environment_id)
    engine = engine_builder("native" if environment_id in BODIES else "mjx")
    environment = catalog.make(info, catalog.parse_options(info, {}), engine)
    assert_exports_act_alike(info, environment.action_size, some_states(environment))


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("walker", sorted({*WALKERS} - {"ant"}))
def test_those_of_the_corridors_other_walkers_do_too(walker: str) -> None:
    info, options = catalog.resolve("corridor", {"walker": walker, "arena": "empty"})
    environment = catalog.make(info, options, engine_builder("native"))
    assert_exports_act_alike(info, environment.action_size, some_states(environment))


@pytest.mark.extra
def test_those_of_a_users_model_do_too(tmp_path: Path) -> None:
    info, _ = catalog.resolve("mjcf", probe.options())
    environment = probe.build(tmp_path)
    assert_exports_act_alike(info, environment.action_size, some_states(environment))


@pytest.mark.slow
@pytest.mark.parametrize("environment_id", sorted({*catalog.ENVIRONMENTS} - {*catalog.BUILT_IN}))
def test_those_of_another_package_do_on_random_numbers(environment_id: str) -> None:
    """Tracing their physics takes minutes each."""
    info = catalog.find(environment_id)
    assert info.observation_size is not None
    assert info.action_size is not None
    spread = np.geomspace(0.01, 100, info.observation_size)
    seen = np.random.default_rng(0).normal(1, spread, (NUM_ENVS * NUM_STEPS, info.observation_size))
    assert_exports_act_alike(info, info.action_size, seen.astype(np.float32))
