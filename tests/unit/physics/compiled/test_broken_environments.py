"""Environments that break, on machine code: they become NaN, and no neighbour changes a bit."""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.physics.compiled import CompiledEngine
from core.physics.engine import PhysicsState
from mujoco_compiled.code import cpu_call
from tests.extra import extra

# Fewer than a vector has lanes, a whole vector, and one more than one and two of them.
NUM_ENVS = (1, 3, 16, 17, 33)
# A ball with an arm on the floor: contacts, a limit, friction loss, and an actuator with a state.
BODY = """
<mujoco>
  <option timestep="0.005" iterations="10" ls_iterations="10"/>
  <worldbody>
    <geom type="plane" size="5 5 1"/>
    <body pos="0 0 0.1">
      <freejoint/>
      <geom size="0.1"/>
      <body pos="0.1 0 0">
        <joint name="hinge" axis="0 1 0" damping="0.1" frictionloss="0.1" range="-20 20"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.03"/>
      </body>
    </body>
  </worldbody>
  <actuator><general joint="hinge" dyntype="filter" dynprm="0.05" gainprm="2" ctrlrange="-1 1"/></actuator>
  <sensor><jointvel joint="hinge"/></sensor>
</mujoco>
"""
DERIVED = ("xpos", "sensordata", "qfrc_actuator")
Step = Callable[[PhysicsState, jax.Array], PhysicsState]


@pytest.fixture(scope="module")
def step() -> Step:
    engine = CompiledEngine(mujoco.MjModel.from_xml_string(BODY), 3, DERIVED)
    return jax.jit(jax.vmap(engine.step))


def begun(num_envs: int) -> tuple[PhysicsState, jax.Array]:
    """The first environments of always the same ones, and their controls."""
    model, generator, most = mujoco.MjModel.from_xml_string(BODY), np.random.default_rng(0), max(NUM_ENVS)
    blank = mujoco.MjData(model)
    names = ("qpos", "qvel", "act", "qacc_warmstart", "ctrl")
    values = {name: 0.1 * generator.normal(size=(most, getattr(blank, name).size)) for name in names}
    values["qpos"] += model.qpos0
    # Numbers that a processor may take for 0, or not: each thread must do the same.
    values["qvel"][::2, 0] = 1e-39
    first = {name: jnp.asarray(each[:num_envs], jnp.float32) for name, each in values.items()}
    derived = {name: jnp.zeros((num_envs, *np.shape(getattr(blank, name)))) for name in DERIVED}
    ctrl = first.pop("ctrl")
    return PhysicsState(**first, time=jnp.zeros(num_envs), derived=derived, model={}), ctrl


def assert_same_bits(state: PhysicsState, other: PhysicsState, envs: np.ndarray) -> None:
    for one, two in zip(jax.tree.leaves(state), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(np.asarray(one)[envs], np.asarray(two)[envs])


@pytest.mark.parametrize("num_cores", [2, *extra(1)])
@pytest.mark.parametrize("num_envs", NUM_ENVS)
def test_an_environment_that_breaks_is_nan_and_changes_no_bit_of_its_neighbours(
    step: Step, num_envs: int, num_cores: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = step(*begun(max(NUM_ENVS)))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(whole))
    monkeypatch.setattr(cpu_call, "num_cores", lambda: num_cores)
    state, ctrl = begun(num_envs)
    alone = step(state, ctrl)
    first = jax.tree.map(lambda leaf: leaf[:num_envs], whole)
    assert_same_bits(alone, first, np.arange(num_envs))
    generator = np.random.default_rng(num_envs)
    for name in ("qpos", "qvel", "act", "qacc_warmstart", "ctrl"):
        for value in (np.nan, np.inf, -np.inf, 2e10, -3e38):
            values = ctrl if name == "ctrl" else getattr(state, name)
            broken = int(generator.integers(num_envs))
            values = values.at[broken, int(generator.integers(values.shape[1]))].set(value)
            given = (state, values) if name == "ctrl" else (replace(state, **{name: values}), ctrl)
            after = step(*given)
            assert_same_bits(after, alone, np.delete(np.arange(num_envs), broken))
            for again in (after, step(after, ctrl)):
                moved = replace(again, time=jnp.full(num_envs, np.nan))
                assert all(np.isnan(leaf[broken]).all() for leaf in jax.tree.leaves(moved)), (name, value)
