"""Environments that break, on machine code: they become NaN, and no neighbour changes a bit."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from mujoco_compiled import Data, put_model, step
from mujoco_compiled.code import cpu_call
from mujoco_compiled.tests.extra import extra

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
Step = Callable[[Data], Data]


@pytest.fixture(scope="module")
def moved() -> Step:
    m = put_model(mujoco.MjModel.from_xml_string(BODY), nstep=3, derived=DERIVED)
    return jax.jit(jax.vmap(partial(step, m)))


def begun(num_envs: int) -> Data:
    """The first environments of always the same ones."""
    model, generator, most = mujoco.MjModel.from_xml_string(BODY), np.random.default_rng(0), max(NUM_ENVS)
    blank = mujoco.MjData(model)
    names = ("qpos", "qvel", "act", "qacc_warmstart", "ctrl")
    values = {name: 0.1 * generator.normal(size=(most, getattr(blank, name).size)) for name in names}
    values["qpos"] += model.qpos0
    # Numbers that a processor may take for 0, or not: each thread must do the same.
    values["qvel"][::2, 0] = 1e-39
    first = {name: jnp.asarray(each[:num_envs], jnp.float32) for name, each in values.items()}
    derived = {name: jnp.zeros((num_envs, *np.shape(getattr(blank, name)))) for name in DERIVED}
    return Data(**first, **derived, time=jnp.zeros(num_envs))


def assert_same_bits(state: Data, other: Data, envs: np.ndarray) -> None:
    for one, two in zip(jax.tree.leaves(state), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(np.asarray(one)[envs], np.asarray(two)[envs])


@pytest.mark.parametrize("num_cores", [2, *extra(1)])
@pytest.mark.parametrize("num_envs", NUM_ENVS)
def test_an_environment_that_breaks_is_nan_and_changes_no_bit_of_its_neighbours(
    moved: Step, num_envs: int, num_cores: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = moved(begun(max(NUM_ENVS)))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(whole))
    monkeypatch.setattr(cpu_call, "num_cores", lambda: num_cores)
    state = begun(num_envs)
    alone = moved(state)
    first = jax.tree.map(lambda leaf: leaf[:num_envs], whole)
    assert_same_bits(alone, first, np.arange(num_envs))
    generator = np.random.default_rng(num_envs)
    for name in ("qpos", "qvel", "act", "qacc_warmstart", "ctrl"):
        for value in (np.nan, np.inf, -np.inf, 2e10, -3e38):
            values = getattr(state, name)
            broken = int(generator.integers(num_envs))
            values = values.at[broken, int(generator.integers(values.shape[1]))].set(value)
            after = moved(state.replace(**{name: values}))
            assert_same_bits(after, alone, np.delete(np.arange(num_envs), broken))
            for again in (after, moved(after.replace(ctrl=state.ctrl))):
                results = again.replace(time=None, ctrl=None)
                assert all(np.isnan(leaf[broken]).all() for leaf in jax.tree.leaves(results)), (name, value)
