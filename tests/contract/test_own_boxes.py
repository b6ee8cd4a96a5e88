"""Environments whose boxes are elsewhere and of other sizes: one set of tests for all engines."""

import copy
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.errors import JobFailed
from core.physics.availability import EngineName
from core.physics.choose import engine_builder
from mujoco_compiled import GEOMETRY
from tests.extra import extra

NUM_SUBSTEPS, NUM_STEPS = 5, 12
# A ball over the first of three platforms, which stand on a body that is not at the origin, and is turned.
BODY = """
<mujoco>
  <option timestep="0.005" iterations="10" ls_iterations="10"/>
  <worldbody>
    <body name="ground" pos="0.2 0 -0.1" euler="0 0 180">
      <geom type="box" pos="0 0 0" size="0.4 1 0.1"/>
      <geom type="box" pos="-0.9 0 0" size="0.4 1 0.1"/>
      <geom type="box" pos="-1.8 0 0" size="0.4 1 0.1"/>
    </body>
    <body name="ball" pos="0 0 0.1"><freejoint/><geom type="sphere" size="0.1"/></body>
  </worldbody>
</mujoco>
"""
NOMINAL = mujoco.MjModel.from_xml_string(BODY)
QPOS = np.array([0.15, 0, 0.099, 1, 0, 0, 0], np.float32)
QVEL = np.array([2.5, 0, 0, 0, 0, 0], np.float32)


def other_boxes(begin: float, half: float, spacing: float) -> mujoco.MjModel:
    """Three boxes of the half length `half` whose centres are `spacing` apart, the first at `begin`; in m, in
    the ground's frame, whose x axis is the world's -x."""
    model = copy.copy(NOMINAL)
    for box in range(3):
        model.geom_pos[box, 0], model.geom_size[box, 0] = begin - spacing * box, half
        model.geom_rbound[box] = np.linalg.norm(model.geom_size[box])
        model.geom_aabb[box, 3:] = model.geom_size[box]
    return model


# The model's own; all under the ball; an edge under it; nothing under it.
MODELS = [NOMINAL, other_boxes(-0.3, 0.8, 2.0), other_boxes(0.3, 0.4, 1.5), other_boxes(0.8, 0.4, 2.0)]
# MJX takes half a minute to compile a body with contacts.
SLOW_MJX = pytest.param("mjx", marks=[pytest.mark.slow, pytest.mark.timeout(300)])


def fields_of(models: list[mujoco.MjModel]) -> dict[str, Any]:
    return {
        name: np.stack([np.asarray(getattr(one, name), np.float32) for one in models]) for name in GEOMETRY
    }


@pytest.mark.parametrize("name", ["native", "compiled", *extra("warp"), SLOW_MJX])
def test_a_ball_moves_over_each_environments_own_boxes(
    name: EngineName, request: pytest.FixtureRequest
) -> None:
    if name == "warp":
        request.getfixturevalue("warp_kernels")
    engine = engine_builder(name)(NOMINAL, NUM_SUBSTEPS, ("xpos",))
    state = jax.jit(jax.vmap(engine.reset, (None, None, 0)))(QPOS, QVEL, fields_of(MODELS))
    step = jax.jit(jax.vmap(engine.step, (0, None)))
    for _ in range(NUM_STEPS):
        state = step(state, jnp.zeros(0))
    ends = [_plain(_loose(model)) for model in MODELS]
    np.testing.assert_allclose(state.qpos, ends, atol=2e-5 if name == "native" else 2e-3)
    # On its one platform; past an edge; after 0.3 s of free fall.
    heights = np.array(ends)[:, 2]
    assert heights[1] == pytest.approx(0.1, abs=0.01)
    assert heights[3] == pytest.approx(0.1 - 9.81 * 0.3**2 / 2, abs=0.02)
    assert heights[3] < heights[2] < 0.0


# A ball over the end of a ramp, which the model turns, on a body that is turned about the vertical.
RAMP = """
<mujoco>
  <option timestep="0.005" iterations="10" ls_iterations="10"/>
  <worldbody>
    <body name="ground" euler="0 0 90">
      <geom type="box" pos="0.1 0 0" size="1 1 0.1" euler="0 10 0"/>
    </body>
    <body name="ball" pos="0 0 0.25"><freejoint/><geom type="sphere" size="0.1"/></body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("name", ["native", "compiled", *extra("warp"), SLOW_MJX])
def test_a_ball_rolls_down_each_environments_own_ramp(
    name: EngineName, request: pytest.FixtureRequest
) -> None:
    if name == "warp":
        request.getfixturevalue("warp_kernels")
    nominal = mujoco.MjModel.from_xml_string(RAMP)
    models = [copy.copy(nominal) for _ in range(3)]
    for model, angle in zip(models[1:], (0.4, -0.6), strict=True):
        model.geom_quat[0] = [np.cos(angle / 2), 0, np.sin(angle / 2), 0]
    qpos = np.array([0, 0, 0.25, 1, 0, 0, 0], np.float32)
    engine = engine_builder(name)(nominal, NUM_SUBSTEPS, ("xpos",))
    state = jax.jit(jax.vmap(engine.reset, (None, None, 0)))(qpos, np.zeros(6, np.float32), fields_of(models))
    step = jax.jit(jax.vmap(engine.step, (0, None)))
    for _ in range(NUM_STEPS):
        state = step(state, jnp.zeros(0))
    ends: list[np.ndarray] = []
    for model in map(_loose, models):
        data = mujoco.MjData(model)
        data.qpos[:] = qpos
        mujoco.mj_step(model, data, NUM_STEPS * NUM_SUBSTEPS)
        ends.append(np.array(data.qpos))
    np.testing.assert_allclose(state.qpos, ends, atol=2e-5 if name == "native" else 2e-3)
    # Along the ramp's x, which is the world's y: the steeper, the farther; the last slopes the other way.
    assert 0.0 < ends[0][1] < ends[1][1]
    assert ends[2][1] < -ends[1][1]


def _plain(model: mujoco.MjModel) -> np.ndarray:
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = QPOS, QVEL
    mujoco.mj_step(model, data, NUM_STEPS * NUM_SUBSTEPS)
    return np.array(data.qpos)


def _loose(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy with what MuJoCo needs where fields are changed behind its compiler's back."""
    loose = copy.copy(model)
    loose.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    loose.geom_sameframe[:3] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    return loose


def test_compiled_refuses_what_it_cannot_know() -> None:
    engine = engine_builder("compiled")(NOMINAL, NUM_SUBSTEPS, ("geom_xpos",))
    with pytest.raises(JobFailed, match="geom_xpos is read"):
        engine.reset(
            jnp.asarray(QPOS),
            jnp.asarray(QVEL),
            {name: jnp.asarray(values[0]) for name, values in fields_of([NOMINAL]).items()},
        )
