"""Environments that differ in fields of the model: one set of tests for all engines."""

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.errors import JobFailed
from core.physics.availability import EngineName
from core.physics.choose import engine_builder
from core.physics.engine import CONSTANTS, MODEL_FIELDS, Engine, PhysicsState
from mujoco_compiled import GEOMETRY, model_field
from tests.extra import extra

NUM_SUBSTEPS, NUM_STEPS = 3, 10
# A ball that slides on a floor, with an arm on which everything acts that a field below is about.
BODY = """
<mujoco>
  <option timestep="0.005" iterations="30" ls_iterations="30"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    <body name="ball" pos="0 0 0.1">
      <freejoint/>
      <geom name="ball" type="sphere" size="0.1"/>
      <site name="ball"/>
      <body name="arm" pos="0.1 0 0">
        <joint name="hinge" axis="0 1 0" damping="0.2" frictionloss="0.05" armature="0.01" limited="true"
               range="-60 60"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.03" mass="0.2" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <general name="motor" joint="hinge" dyntype="filter" dynprm="0.05" gainprm="1" biastype="affine"
             biasprm="0 -1 0" forcelimited="true" forcerange="-0.9 0.9"/>
  </actuator>
</mujoco>
"""


def _slower(model: mujoco.MjModel) -> None:
    model.opt.gravity[:] = [0.5, 0, -6]


def _heavier(model: mujoco.MjModel) -> None:
    model.body_mass[1:] *= [2, 3]


def _rounder(model: mujoco.MjModel) -> None:
    model.body_inertia[1:] *= 3


def _off_centre(model: mujoco.MjModel) -> None:
    model.body_ipos[1:] += [[0.02, 0.01, 0.03], [0.05, -0.02, 0.01]]


def _elsewhere(model: mujoco.MjModel) -> None:
    model.body_pos[2] += [0.05, 0.02, 0.03]


def _turned(model: mujoco.MjModel) -> None:
    model.body_quat[2] = [np.cos(0.2), 0, 0, np.sin(0.2)]


def _scaled(name: str, factor: float) -> Callable[[mujoco.MjModel], None]:
    def change(model: mujoco.MjModel) -> None:
        getattr(model, name)[:] *= factor

    return change


def _stiff(model: mujoco.MjModel) -> None:
    model.jnt_stiffness[1] = 2.0  # it had none


# An environment for each.
CHANGES: Mapping[str, Callable[[mujoco.MjModel], None]] = {
    "nothing": lambda model: None,
    "opt.gravity": _slower,
    "body_mass": _heavier,
    "body_inertia": _rounder,
    "body_ipos": _off_centre,
    "body_pos": _elsewhere,
    "body_quat": _turned,
    "dof_armature": _scaled("dof_armature", 4),
    "dof_damping": _scaled("dof_damping", 3),
    "dof_frictionloss": _scaled("dof_frictionloss", 10),
    "geom_friction": _scaled("geom_friction", 0.3),
    "geom_solref": _scaled("geom_solref", 3),
    "jnt_stiffness": _stiff,
    "actuator_gear": _scaled("actuator_gear", 0.5),
    "actuator_gainprm": _scaled("actuator_gainprm", 0.6),
    "actuator_biasprm": _scaled("actuator_biasprm", 2),
    "actuator_dynprm": _scaled("actuator_dynprm", 3),
    "actuator_forcerange": _scaled("actuator_forcerange", 0.3),
}


@dataclass(frozen=True)
class RandomizedEngine:
    """The environments of `CHANGES` on an engine; tolerance: how near to plain MuJoCo it must stay."""

    engine: Engine
    start: PhysicsState
    end: PhysicsState
    step_many: Callable[..., PhysicsState]
    tolerance: float


def changed(name: str) -> mujoco.MjModel:
    model = copy.copy(NOMINAL)
    CHANGES[name](model)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


NOMINAL = mujoco.MjModel.from_xml_string(BODY)
MODELS = {name: changed(name) for name in CHANGES}
QPOS = np.array([0, 0, 0.099, 1, 0, 0, 0, 0.1], np.float32)
QVEL = np.array([1, 0.5, 0, 0, 0, 0, 0.5], np.float32)
CTRL = np.array([0.8], np.float32)
DERIVED = ("cinert", "site_xpos", "subtree_com", "xpos")


def fields_of(models: list[mujoco.MjModel]) -> dict[str, Any]:
    names = {*CHANGES, *CONSTANTS} - {"nothing"}
    return {
        name: np.stack([np.asarray(model_field(model, name), np.float32) for model in models])
        for name in names
    }


# MJX takes half a minute to compile a body with contacts.
SLOW_MJX = pytest.param("mjx", marks=[pytest.mark.slow, pytest.mark.timeout(300)])


@pytest.fixture(scope="module", params=["native", "compiled", *extra("warp"), SLOW_MJX])
def bench(request: pytest.FixtureRequest) -> RandomizedEngine:
    name: EngineName = request.param
    if name == "warp":
        request.getfixturevalue("warp_kernels")
    engine = engine_builder(name)(NOMINAL, NUM_SUBSTEPS, ())
    step_many = jax.jit(jax.vmap(engine.step))
    fields = fields_of(list(MODELS.values()))
    start = jax.jit(jax.vmap(engine.reset, (None, None, 0)))(QPOS, QVEL, fields)
    end = start
    for _ in range(NUM_STEPS):
        end = step_many(end, np.tile(CTRL, (len(MODELS), 1)))
    return RandomizedEngine(engine, start, end, step_many, 2e-5 if name == "native" else 2e-3)


def reference(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = QPOS, QVEL, CTRL
    for _ in range(NUM_STEPS * NUM_SUBSTEPS):
        mujoco.mj_step(model, data)
    return data


@pytest.mark.parametrize("name", list(CHANGES))
def test_an_environment_moves_as_plain_mujoco_with_its_model_does(bench: RandomizedEngine, name: str) -> None:
    env = list(CHANGES).index(name)
    data, nominal = reference(MODELS[name]), reference(NOMINAL)
    if name != "nothing":  # the change can be seen
        assert np.abs(data.qpos - nominal.qpos).max() > 5e-3
    np.testing.assert_allclose(bench.end.qpos[env], data.qpos, atol=bench.tolerance)
    np.testing.assert_allclose(bench.end.act[env], data.act, atol=bench.tolerance)


@pytest.mark.parametrize("name", ["native", "compiled", *extra("warp"), SLOW_MJX])
def test_derived_fields_are_those_of_each_environments_own_model(
    name: EngineName, request: pytest.FixtureRequest
) -> None:
    if name == "warp":
        request.getfixturevalue("warp_kernels")
    engine = engine_builder(name)(NOMINAL, NUM_SUBSTEPS, DERIVED)
    fields = fields_of(list(MODELS.values()))
    start = jax.jit(jax.vmap(engine.reset, (None, None, 0)))(QPOS, QVEL, fields)
    for state in (start, jax.jit(jax.vmap(engine.step, (0, None)))(start, CTRL)):
        for env, model in enumerate(MODELS.values()):
            data = mujoco.MjData(model)
            data.qpos[:], data.qvel[:] = state.qpos[env], state.qvel[env]
            mujoco.mj_forward(model, data)
            for field in DERIVED:
                np.testing.assert_allclose(state.derived[field][env], getattr(data, field), atol=5e-6)


def test_fields_that_change_between_two_steps_are_those_of_the_next_step(bench: RandomizedEngine) -> None:
    # Each environment runs on with the model of another one.
    others = list(reversed(MODELS.values()))
    state = replace(bench.end, model=fields_of(others))
    for _ in range(NUM_STEPS):
        state = bench.step_many(state, np.tile(CTRL, (len(MODELS), 1)))
    for env, (model, other) in enumerate(zip(MODELS.values(), others, strict=True)):
        data = reference(model)
        mujoco.mj_step(other, data, NUM_STEPS * NUM_SUBSTEPS)
        np.testing.assert_allclose(state.qpos[env], data.qpos, atol=3 * bench.tolerance)


def test_an_environments_fields_stay_as_they_are(bench: RandomizedEngine) -> None:
    for name, values in fields_of(list(MODELS.values())).items():
        np.testing.assert_array_equal(bench.end.model[name], values)


def test_environments_without_fields_of_their_own_come_and_go_between_those_that_have_some(
    bench: RandomizedEngine,
) -> None:
    # As many environments as there are with fields of their own: nothing of theirs may stay behind.
    num_envs = len(MODELS)
    plain = jax.vmap(bench.engine.reset)(np.tile(QPOS, (num_envs, 1)), np.tile(QVEL, (num_envs, 1)))
    assert not jax.tree.leaves(plain.model)
    ctrl = np.tile(CTRL, (num_envs, 1))
    before = bench.step_many(plain, ctrl)
    own = bench.step_many(bench.start, ctrl)
    again = bench.step_many(plain, ctrl)
    np.testing.assert_array_equal(again.qpos, before.qpos)
    np.testing.assert_allclose(own.qpos[0], before.qpos[0], atol=1e-6)
    assert np.abs(own.qpos - before.qpos).max() > 1e-4


def test_one_field_alone_is_enough(bench: RandomizedEngine) -> None:
    state = jax.vmap(bench.engine.reset, (None, None, 0))(
        QPOS, QVEL, {"opt.gravity": jnp.asarray([[0.0, 0, -9.81], [0, 0, 0]])}
    )
    after = bench.step_many(state, np.tile(CTRL, (2, 1)))
    assert float(after.qvel[0, 2]) < float(after.qvel[1, 2])


def test_a_field_that_no_environment_can_have_to_itself_is_refused(bench: RandomizedEngine) -> None:
    with pytest.raises(ValueError, match="geom_margin"):
        bench.engine.reset(jnp.asarray(QPOS), jnp.asarray(QVEL), {"geom_margin": jnp.zeros(3)})


@pytest.mark.extra
def test_pendulums_of_different_mass_and_damping_swing_apart_on_mjx() -> None:
    # What of the above MJX compiles in seconds.
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.03" mass="1"/></body></worldbody></mujoco>"""
    )
    engine = engine_builder("mjx")(model, NUM_SUBSTEPS, ())
    masses, dampings = np.array([[0, 1], [0, 2], [0, 1]]), np.array([[0.1], [0.1], [0.5]])
    fields = {"body_mass": jnp.float32(masses), "dof_damping": jnp.float32(dampings)}
    state = jax.vmap(engine.reset, (None, None, 0))(jnp.zeros(1), jnp.zeros(1), fields)
    step = jax.jit(jax.vmap(engine.step, (0, None)))
    for _ in range(NUM_STEPS):
        state = step(state, jnp.zeros(0))
    for env in range(3):
        own = copy.copy(model)
        own.body_mass[:], own.dof_damping[:] = masses[env], dampings[env]
        data = mujoco.MjData(own)
        mujoco.mj_step(own, data, NUM_STEPS * NUM_SUBSTEPS)
        np.testing.assert_allclose(state.qpos[env], data.qpos, atol=1e-5)
    assert len({round(float(angle), 3) for angle in state.qpos[:, 0]}) == 3


def test_every_field_is_tried_here() -> None:
    # Those of boxes: tests/contract/test_own_boxes.py.
    assert {*CHANGES, *CONSTANTS, *GEOMETRY} - {"nothing"} == set(MODEL_FIELDS)


@pytest.mark.extra
@pytest.mark.usefixtures("warp_kernels")
def test_warp_refuses_the_damping_that_it_cannot_tell_apart() -> None:
    model = mujoco.MjModel.from_xml_string(BODY)
    model.actuator_damping[:] = 0.1
    engine = engine_builder("warp")(model, NUM_SUBSTEPS, ())
    with pytest.raises(JobFailed, match="dof_damping"):
        engine.reset(jnp.asarray(QPOS), jnp.asarray(QVEL), {"dof_damping": jnp.zeros(7)})
