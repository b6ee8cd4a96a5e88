"""Muscles against C MuJoCo: their forces and activations, and models of an arm and a leg."""

from collections.abc import Iterator
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mujoco_compiled.coverage import uncovered
from mujoco_compiled.smooth.actuation import ActuatorState, driven, read_actuators
from mujoco_compiled.smooth.paths import Stretch
from mujoco_compiled.smooth.tree import read_tree
from mujoco_compiled.substep import read_model
from mujoco_compiled.tests.bodies import FEATURES
from mujoco_compiled.tests.recorded_substep import recorded
from mujoco_compiled.tests.states import THOROUGH, converge
from mujoco_compiled.tests.test_forces import assert_close, of_all, random_states, state_of

NUM_STATES = 2000
PULLEY = """
<mujoco>
  <option integrator="{}"/>
  <worldbody>
    <body><joint name="hinge" axis="0 1 0" armature="0.1"/><geom size="0.1" pos="0.1 0 0"/></body>
  </worldbody>
  <actuator><muscle joint="hinge" lengthrange="-0.9 1.3" {}/></actuator>
</mujoco>
"""
KINDS = (
    "",
    'force="30" range="0.5 1.2" lmin="0.3" lmax="1.8" vmax="3" fpmax="2" fvmax="1.4"',
    'scale="150" timeconst="0.02 0.08" tausmooth="0.4" ctrllimited="false"',
    'force="5" fvmax="1" lmax="1.3" gear="-2"',
)


def pulley(kind: str, integrator: str = "Euler") -> mujoco.MjModel:
    model = mujoco.MjModel.from_xml_string(PULLEY.format(integrator, kind))
    model.actuator_actearly[:] = kind == KINDS[-1]
    return model


@pytest.mark.parametrize("kind", KINDS)
def test_a_muscle_pulls_and_follows_its_control_as_in_mujoco(kind: str) -> None:
    model = pulley(kind)
    assert uncovered(model) is None
    generator, data = np.random.default_rng(0), mujoco.MjData(model)
    given, theirs = list[tuple[float, ...]](), list[tuple[float, float]]()
    for _ in range(NUM_STATES):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = 1.5 * generator.normal(), 5.0 * generator.normal()
        data.act[:], data.ctrl[:] = generator.uniform(-0.2, 1.2, 2)
        mujoco.mj_forward(model, data)
        before = data.act[0], data.ctrl[0]
        given.append((data.actuator_length[0], data.qvel[0], *before))
        force = data.actuator_force[0]
        mujoco.mj_step(model, data)
        theirs.append((force, data.act[0]))
    lengths, rates, activations, controls = np.array(given).T
    gear = float(model.actuator_gear[0, 0])
    state = ActuatorState([Stretch(lengths, {0: gear})], [rates], [activations], [controls], [])
    found = driven(read_tree(model), read_actuators(model), state, model.opt.timestep)
    assert_close([*found.forces, *found.act], list(np.array(theirs).T))


def models() -> Iterator[tuple[str, mujoco.MjModel]]:
    for integrator in ("Euler", "implicitfast"):
        for kind in KINDS[1:]:
            yield f"{integrator} {kind}", pulley(kind, integrator)
    for name in ("muscles", "arm_of_muscles", "leg_of_muscles"):
        yield name, mujoco.MjModel.from_xml_path(str(FEATURES / f"{name}.xml"))


@pytest.mark.parametrize(("name", "model"), [pytest.param(*one, id=one[0]) for one in models()])
def test_what_muscles_pull_moves_as_in_mujoco(name: str, model: mujoco.MjModel) -> None:
    assert uncovered(model) is None
    model = converge(model, implicit_damping=True)
    datas, ours = random_states(model, 0.3), read_model(model)
    for data in datas:
        data.ctrl[:], data.act[:] = np.abs(data.ctrl), np.abs(data.act)
    state, ctrl = state_of(datas), of_all(datas, "ctrl")
    step = recorded(replace(ours, solver=replace(ours.solver, **THOROUGH)), state, ctrl)
    for _ in range(10):
        state = step(state, ctrl)
        for data in datas:
            mujoco.mj_step(model, data)
    for field in ("qpos", "qvel", "act"):
        assert_close(getattr(state, field), of_all(datas, field), 1e-9)
