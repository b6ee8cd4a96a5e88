"""Substeps of bodies with other contacts than feet on a plane, against C MuJoCo, both converged."""

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mujoco_compiled.coverage import uncovered
from mujoco_compiled.substep import SubstepState, read_model
from mujoco_compiled.tests.extra import extra
from mujoco_compiled.tests.recorded_substep import recorded
from mujoco_compiled.tests.rows_of_mujoco import assert_same_rows
from mujoco_compiled.tests.states import THOROUGH, converge, of_all, relative

NUM_STATES, NUM_SUBSTEPS = 12, 20
# A quadruped's trunk and two limbs that hit each other, on the ground and on a step.
LIMBS = """
<mujoco>
  <option timestep="0.002" cone="{cone}" impratio="{impratio}"/>
  <default><joint damping="0.3" armature="0.01" {joint}/><geom friction="0.9 0.1 0.05" {geom}/></default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    <geom name="step" type="box" size="0.3 1 0.1" pos="0.5 0 0"/>
    <body name="trunk" pos="0 0 0.45">
      <freejoint/>
      <geom type="{trunk}" size="0.25 0.15 0.1"/>
      <body name="left" pos="0.1 0.15 0">
        <joint name="a" axis="1 0 0" range="-90 90"/><joint name="b" axis="0 1 0" range="-60 60"/>
        <geom type="capsule" fromto="0 0 0 0.1 0.05 -0.3" size="0.05"/>
      </body>
      <body name="right" pos="0.1 -0.15 0">
        <joint name="c" axis="1 0 0" range="-90 90"/><joint name="d" axis="0 1 0" range="-60 60"/>
        <geom type="capsule" fromto="0 0 0 0.1 -0.05 -0.3" size="0.05"/>
        <geom size="0.08" pos="0.1 -0.05 -0.3"/>
      </body>
    </body>
  </worldbody>
  <contact>{contact}</contact>
  <actuator><motor joint="a" gear="8"/><motor joint="b" gear="8"/><motor joint="c" gear="8"/>
  <motor joint="d" gear="8"/></actuator>
</mujoco>
"""


# They tie limbs of different branches together.
TENDONS = """<tendon>
  <fixed range="-0.3 0.4"><joint joint="a" coef="1"/><joint joint="c" coef="-1"/></fixed>
  <fixed frictionloss="0.4"><joint joint="b" coef="1"/><joint joint="d" coef="0.5"/></fixed>
</tendon>"""


def limbs(
    cone: str = "pyramidal",
    impratio: str = "1",
    joint: str = "",
    geom: str = "",
    trunk: str = "box",
    tendons: str = "",
) -> mujoco.MjModel:
    # The trunk touches the floor alone: with the step, MuJoCo has other points for cylinders and ellipsoids.
    parts = {"cone": cone, "impratio": impratio, "joint": joint, "geom": geom, "trunk": trunk}
    contact = '<exclude body1="world" body2="trunk"/><pair geom1="floor" geom2="trunk" condim="3"/>'
    xml = LIMBS.replace('type="{trunk}"', 'name="trunk" type="{trunk}"')
    xml = xml.format(contact=contact, **parts)
    return mujoco.MjModel.from_xml_string(xml.replace("</contact>", f"</contact>{tendons}"))


def falling(model: mujoco.MjModel, speed: float = 1.0) -> list[mujoco.MjData]:
    """States as they come about where the body falls again and again. speed: about how fast it starts."""
    generator, found = np.random.default_rng(0), list[mujoco.MjData]()
    while len(found) < NUM_STATES:
        data = mujoco.MjData(model)
        data.qpos[:2] += generator.uniform(-0.2, 0.5, size=2)
        data.qvel[:] = generator.normal(scale=speed, size=model.nv)
        for step in range(1, 361):
            if step % 20 == 1:
                data.ctrl[:] = generator.uniform(-1.0, 1.0, size=model.nu)
            mujoco.mj_step(model, data)
            if step % 120 == 0:
                kept = mujoco.MjData(model)
                mujoco.mj_copyData(kept, model, data)
                found.append(kept)
    return found


@pytest.mark.parametrize(
    "make",
    [
        lambda: limbs(cone="elliptic", impratio="3", geom='condim="6"', trunk="cylinder"),
        *extra(
            lambda: limbs(joint='frictionloss="0.5"', tendons=TENDONS),
            lambda: limbs(trunk="ellipsoid", geom='condim="4"'),
        ),
    ],
    ids=["cylinder, elliptic", "box, friction loss, tendons", "ellipsoid, turning"],
)
def test_a_body_with_all_kinds_of_contacts_moves_as_in_mujoco(make: Callable[[], mujoco.MjModel]) -> None:
    model = converge(make(), implicit_damping=True)
    assert uncovered(model) is None
    assert_moves_as_mujoco(model, falling(model))


def step_converged(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """C MuJoCo's step. With elliptic cones its solver stops too early where it begins far away."""
    if model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC:
        mujoco.mj_forward(model, data)
        data.qacc_warmstart[:] = data.qacc
    mujoco.mj_step(model, data)


# On two platforms with a gap between them, and on each other.
BLOCKS = """
<mujoco>
  <option timestep="0.002" {option}/>
  <default><geom type="box" friction="0.6"/></default>
  <worldbody>
    <geom name="left" size="1 1 0.1" pos="-1 0 0"/>
    <geom name="right" size="1 1 0.1" pos="1.02 0 0"/>
    <body pos="0 0 0.4"><freejoint/><geom name="lower" size="0.6 0.5 0.1"/></body>
    <body pos="0 0 0.7"><freejoint/><geom name="upper" size="0.1 0.15 0.08"/></body>
  </worldbody>
</mujoco>
"""


@pytest.mark.extra
@pytest.mark.parametrize("option", ["", 'cone="elliptic" impratio="3"'], ids=["pyramidal", "elliptic"])
def test_blocks_fall_on_platforms_and_on_each_other_as_in_mujoco(option: str) -> None:
    model = converge(mujoco.MjModel.from_xml_string(BLOCKS.format(option=option)), implicit_damping=True)
    assert uncovered(model) is None
    datas, generator = falling(model, speed=0.3), np.random.default_rng(0)
    for data in datas:
        # Many have come to rest.
        data.qvel[:] += generator.normal(scale=0.3, size=model.nv)
    touching = {tuple(one.geom) for data in datas for one in data.contact}
    assert touching == {(0, 2), (1, 2), (2, 3)}
    assert_same_rows(model, [after_forward(model, data) for data in datas])
    assert_moves_as_mujoco(model, datas, num_substeps=4)


def after_forward(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    """A copy whose rows are those of its state."""
    copied = mujoco.MjData(model)
    mujoco.mj_copyData(copied, model, data)
    mujoco.mj_forward(model, copied)
    return copied


def assert_moves_as_mujoco(
    model: mujoco.MjModel, datas: list[mujoco.MjData], num_substeps: int = NUM_SUBSTEPS
) -> None:
    ours = read_model(model)
    ours = replace(ours, solver=replace(ours.solver, **THOROUGH))
    state = SubstepState(
        *(of_all(datas, field) for field in ("qpos", "qvel")), [], of_all(datas, "qacc_warmstart")
    )
    ctrl = of_all(datas, "ctrl")
    step = recorded(ours, state, ctrl)
    assert sum(data.ncon > 0 for data in datas) > len(datas) / 4
    for number in range(1, num_substeps + 1):
        state = step(state, ctrl)
        for data in datas:
            step_converged(model, data)
        if number == 1:
            assert relative(state.qacc, of_all(datas, "qacc")) < 1e-9
    assert relative(state.qpos, of_all(datas, "qpos")) < 1e-6
    assert relative(state.qvel, of_all(datas, "qvel")) < 1e-6
