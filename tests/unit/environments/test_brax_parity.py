"""Rewards, observations, terminations and metrics against Brax's own environments.

Brax's derived fields lag one substep behind its positions, ours do not. So Brax is handed the physics:
its environment reads the body's frames that MuJoCo computes for exactly our states. That the physics
themselves agree is `tests/contract/test_engines.py`'s business.
"""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.environments import catalog
from core.environments.environment import Environment
from core.physics.availability import EngineName
from core.physics.choose import engine_builder
from core.physics.engine import PhysicsState
from tests.extra import extra

BRAX_NAMES = {"half_cheetah": "halfcheetah"}
BRAXS = [name for name in catalog.BUILT_IN if f"brax/{BRAX_NAMES.get(name, name)}" in catalog.ENVIRONMENTS]
# Brax writes infinities into the ranges of what has no limit.
BRAX_REWRITES = {"jnt_range", "actuator_ctrlrange", "actuator_forcerange"}


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo complains about one of Brax's files, into a file where it stands."""
    monkeypatch.chdir(tmp_path)


@dataclass
class Frames:
    """The fields that Brax's environments read of a physics state, and ours beside them."""

    physics: PhysicsState
    q: jax.Array
    qd: jax.Array
    x: Any
    xd: Any


def frames(model: mujoco.MjModel, physics: PhysicsState) -> Frames:
    import brax.base

    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = physics.qpos, physics.qvel
    mujoco.mj_forward(model, data)
    angular, linear = data.cvel[1:, :3], data.cvel[1:, 3:]
    offset = data.xpos[1:] - data.subtree_com[model.body_rootid[1:]]
    return Frames(
        physics,
        physics.qpos,
        physics.qvel,
        brax.base.Transform(
            pos=jnp.asarray(data.xpos[1:], jnp.float32), rot=jnp.asarray(data.xquat[1:], jnp.float32)
        ),
        brax.base.Motion(
            ang=jnp.asarray(angular, jnp.float32),
            vel=jnp.asarray(linear + np.cross(angular, offset), jnp.float32),
        ),
    )


def brax_envs() -> Any:
    """Brax's environments, with MJX and Warp, which take seconds to load."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Brax tells everybody that its environments are not maintained
        from brax import envs
    return envs


def braxs(environment_id: str) -> Any:
    envs = brax_envs()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return envs.get_environment(BRAX_NAMES.get(environment_id, environment_id), backend="mjx")


def peer(environment: Any, environment_id: str) -> Any:
    """Brax's environment, moved by our environment's engine."""
    theirs = braxs(environment_id)
    step = jax.jit(environment.engine.step)

    def pipeline_step(state: Frames, ctrl: jax.Array) -> Frames:
        return frames(environment.model, step(state.physics, ctrl))

    theirs.pipeline_step = pipeline_step
    return theirs


def make(environment_id: str, engine: EngineName = "native") -> Environment:
    info = catalog.find(environment_id)
    return catalog.make(info, info.options(), engine_builder(engine))


@pytest.mark.parametrize("environment_id", ["ant", *extra(*(name for name in BRAXS if name != "ant"))])
def test_an_environment_does_what_braxs_does(environment_id: str) -> None:
    ours = make(environment_id)
    theirs = peer(ours, environment_id)
    assert float(theirs.dt) == pytest.approx(ours.dt)
    assert theirs.action_size == ours.action_size
    state, step = ours.reset(jax.random.key(3)), jax.jit(ours.step)
    their_state = brax_envs().State(
        pipeline_state=frames(ours.model, state.physics),
        obs=state.obs,
        reward=jnp.zeros(()),
        done=jnp.zeros(()),
        metrics={},
        info={},
    )
    for index in range(3):
        key = jax.random.fold_in(jax.random.key(4), index)
        action = jax.random.uniform(key, (ours.action_size,), minval=-1.0, maxval=1.0)
        state = step(state, action)
        their_state = theirs.step(their_state, action)
        np.testing.assert_allclose(state.obs, their_state.obs, rtol=2e-4, atol=2e-5)
        np.testing.assert_allclose(state.reward, their_state.reward, rtol=1e-4, atol=1e-5)
        assert float(state.done) == float(their_state.done)
        assert state.metrics.keys() == their_state.metrics.keys()
        for name, value in their_state.metrics.items():
            np.testing.assert_allclose(state.metrics[name], value, rtol=1e-4, atol=1e-5, err_msg=name)


@pytest.mark.parametrize("environment_id", BRAXS)
def test_a_model_is_the_one_that_brax_steps(environment_id: str) -> None:
    ours = make(environment_id).model
    theirs = braxs(environment_id).sys.mj_model
    for name in dir(theirs):
        wanted = getattr(theirs, name)
        if isinstance(wanted, np.ndarray) and wanted.dtype.kind == "f" and name not in BRAX_REWRITES:
            np.testing.assert_allclose(getattr(ours, name), wanted, rtol=1e-6, atol=1e-9, err_msg=name)
    np.testing.assert_array_equal(ours.geom_contype, theirs.geom_contype)
    np.testing.assert_array_equal(ours.jnt_type, theirs.jnt_type)


@pytest.mark.slow  # it compiles two MJX ants
@pytest.mark.filterwarnings("ignore:Accessing:DeprecationWarning")  # Brax reads MJX by old names
def test_the_ant_on_mjx_is_braxs_ant_on_mjx() -> None:
    """The whole of it once, Brax's physics included; Brax is asked for frames that are not a substep old."""
    import brax.base
    from mujoco import mjx

    ours, theirs = make("ant", "mjx"), braxs("ant")
    plain_step = theirs.pipeline_step

    def pipeline_step(state: Any, ctrl: jax.Array) -> Any:
        after = plain_step(state, ctrl)
        fresh = mjx.kinematics(theirs.sys, after)
        return after.replace(x=brax.base.Transform(pos=fresh.xpos[1:], rot=fresh.xquat[1:]))

    theirs.pipeline_step = pipeline_step
    state = jax.jit(ours.reset)(jax.random.key(3))
    zero = jnp.zeros(())
    their_state = brax_envs().State(
        pipeline_state=jax.jit(theirs.pipeline_init)(state.physics.qpos, state.physics.qvel),
        obs=state.obs,
        reward=zero,
        done=zero,
        metrics=dict(state.metrics),
        info={},
    )
    step, their_step = jax.jit(ours.step), jax.jit(theirs.step)
    for index in range(5):
        action = jax.random.uniform(jax.random.key(index), (8,), minval=-1.0, maxval=1.0)
        state, their_state = step(state, action), their_step(their_state, action)
        np.testing.assert_allclose(state.obs, their_state.obs, atol=1e-4)
        np.testing.assert_allclose(state.reward, their_state.reward, atol=1e-4)
        np.testing.assert_allclose(state.metrics["x_velocity"], their_state.metrics["x_velocity"], atol=1e-4)
