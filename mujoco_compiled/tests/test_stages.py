"""Each stage alone, in double precision, against C MuJoCo's own intermediate results."""

from copy import copy
from functools import cache

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from mujoco_compiled.program.arithmetic import Vector
from mujoco_compiled.smooth.actuation import ActuatorState, actuator_stretch, driven, read_actuators
from mujoco_compiled.smooth.dynamics import Entries, bias_forces, mass_matrix, motion
from mujoco_compiled.smooth.factor import factorize, multiply, solve
from mujoco_compiled.smooth.forces import passive_forces
from mujoco_compiled.smooth.kinematics import poses
from mujoco_compiled.smooth.paths import Posture
from mujoco_compiled.smooth.tree import Tree, read_tree
from mujoco_compiled.tests.bodies import brax_model
from mujoco_compiled.tests.rows_of_mujoco import assert_same_rows

NUM_STATES = 16
# A ball joint off its body's origin, two joints of one body, a tilted inertia, two trees, one fixed.
MIXED = """
<mujoco>
  <option gravity="1 2 -9"/>
  <worldbody>
    <body name="flying" pos="0 0 1" quat="0.9 0.1 0.2 0.3">
      <freejoint/>
      <geom type="box" size="0.1 0.2 0.3" pos="0.1 0 0.2" euler="10 20 30"/>
      <body pos="0.2 0.1 0" euler="30 0 60">
        <joint type="ball" pos="0 0.1 0.05"/>
        <geom type="ellipsoid" size="0.1 0.05 0.2" pos="0 0 0.1"/>
        <body pos="0 0 0.4">
          <joint type="hinge" axis="1 2 0" pos="0.1 0 0" ref="20" armature="0.3"/>
          <joint type="slide" axis="0 1 1" ref="0.2"/>
          <geom type="capsule" size="0.05 0.2" mass="0.7"/>
        </body>
      </body>
    </body>
    <body name="fixed" pos="2 0 0"><geom size="0.1"/>
      <body pos="0 0 1"><joint type="hinge" axis="0 1 0"/><geom type="capsule" size="0.05 0.2"/></body>
    </body>
  </worldbody>
</mujoco>
"""
BODIES = ("ant", "half_cheetah", "hopper", "walker2d", "humanoid", "inverted_pendulum", "reacher", "mixed")


@cache
def model_of(name: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(MIXED) if name == "mixed" else brax_model(name)


class Case:
    """States of a body drawn at random, C MuJoCo's results for each of them, and ours for all at once."""

    def __init__(self, name: str) -> None:
        self.model = model_of(name)
        self.tree: Tree = read_tree(self.model)
        generator = np.random.default_rng(0)
        self.datas = [mujoco.MjData(self.model) for _ in range(NUM_STATES)]
        for data in self.datas:
            data.qpos[:] += generator.normal(size=self.model.nq)
            data.qvel[:] = generator.normal(size=self.model.nv)
            data.ctrl[:] = 2.0 * generator.normal(size=self.model.nu)
            mujoco.mj_forward(self.model, data)
        self.qpos: Vector = list(np.stack([data.qpos for data in self.datas], axis=1))
        self.qvel: Vector = list(np.stack([data.qvel for data in self.datas], axis=1))
        self.ctrl: Vector = list(np.stack([data.ctrl for data in self.datas], axis=1))
        self.poses = poses(self.tree, self.qpos)
        self.motion = motion(self.tree, self.poses, self.qvel)
        self.mass_matrix = mass_matrix(self.tree, self.motion)

    def of_mujoco(self, field: str) -> NDArray[np.float64]:
        """[NUM_STATES, ...]."""
        return np.stack([getattr(data, field) for data in self.datas])

    def dense_mass_matrix(self, data: mujoco.MjData) -> NDArray[np.float64]:
        dense = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, data, dense)
        return dense


@cache
def case_of(name: str) -> Case:
    return Case(name)


@pytest.fixture(params=BODIES)
def case(request: pytest.FixtureRequest) -> Case:
    return case_of(request.param)


def stacked(values: list[Vector]) -> NDArray[np.float64]:
    """[NUM_STATES, ...] of lists of numbers."""
    return np.stack([[np.broadcast_to(x, NUM_STATES) for x in row] for row in values]).transpose(2, 0, 1)


def dense(entries: Entries, size: int) -> NDArray[np.float64]:
    found = np.zeros((NUM_STATES, size, size))
    for (i, j), values in entries.items():
        found[:, i, j] = found[:, j, i] = values
    return found


def assert_close(ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> None:
    """Equal to 1e-12 of the largest number: sums are taken in another order."""
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12 * max(1.0, float(np.abs(theirs).max())))


def test_bodies_and_centres_of_mass_are_where_mujoco_has_them(case: Case) -> None:
    assert_close(stacked(case.poses.positions), case.of_mujoco("xpos"))
    assert_close(stacked(case.poses.centres), case.of_mujoco("xipos"))
    rotations = [[x for row in rotation for x in row] for rotation in case.poses.rotations]
    assert_close(stacked(rotations), case.of_mujoco("xmat").reshape(NUM_STATES, -1, 9))
    for root, centre in case.motion.centres.items():
        assert_close(stacked([centre])[:, 0], case.of_mujoco("subtree_com")[:, root])


def test_inertias_axes_and_velocities_are_mujoco_s(case: Case) -> None:
    assert_close(stacked(case.motion.inertias)[:, 1:], case.of_mujoco("cinert")[:, 1:])
    assert_close(stacked(case.motion.axes), case.of_mujoco("cdof"))
    assert_close(stacked(case.motion.velocities), case.of_mujoco("cvel"))
    assert_close(stacked(case.motion.axis_rates), case.of_mujoco("cdof_dot"))


def test_the_mass_matrix_is_mujoco_s_and_has_no_entry_outside_the_tree(case: Case) -> None:
    theirs = np.stack([case.dense_mass_matrix(data) for data in case.datas])
    assert_close(dense(case.mass_matrix, case.model.nv), theirs)
    assert set(case.mass_matrix) == set(case.tree.entries)


def test_bias_forces_are_mujoco_s(case: Case) -> None:
    ours = bias_forces(case.tree, case.motion, case.qvel)
    assert_close(stacked([ours])[:, 0], case.of_mujoco("qfrc_bias"))


def test_the_factor_solves_and_multiplies(case: Case) -> None:
    right: Vector = list(np.random.default_rng(1).normal(size=(case.model.nv, NUM_STATES)))
    x = solve(case.tree, factorize(case.tree, case.mass_matrix), right)
    expected = np.linalg.solve(dense(case.mass_matrix, case.model.nv), np.stack(right, axis=1)[..., None])
    np.testing.assert_allclose(np.stack(x, axis=1), expected[..., 0], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(multiply(case.tree, case.mass_matrix, x), right, rtol=1e-8, atol=1e-8)


def test_passive_and_actuator_forces_are_mujoco_s(case: Case) -> None:
    passive = passive_forces(case.tree, case.qpos, case.qvel)
    assert_close(stacked([passive])[:, 0], case.of_mujoco("qfrc_passive"))
    actuators = read_actuators(case.model)
    at = poses(case.tree, case.qpos)
    posture = Posture(case.tree, at, motion(case.tree, at, case.qvel), case.qpos)
    along = [actuator_stretch(actuator.path, posture) for actuator in actuators]
    state = ActuatorState(along, case.qvel, [], case.ctrl, [])
    done = driven(case.tree, actuators, state, case.model.opt.timestep)
    if done.forces:
        assert_close(stacked([done.forces])[:, 0], case.of_mujoco("actuator_force"))
    assert_close(stacked([done.on_dofs])[:, 0], case.of_mujoco("qfrc_actuator"))


class Touching:
    """States of a body on the floor, and its joints' limits, as C MuJoCo's own steps bring it there."""

    def __init__(self, name: str) -> None:
        self.model = model_of(name)
        generator = np.random.default_rng(0)
        data, self.datas = mujoco.MjData(self.model), list[mujoco.MjData]()
        data.qvel[:] = generator.normal(size=self.model.nv)
        for step in range(200 + 40 * NUM_STATES):
            if step % 10 == 0:
                data.ctrl[:] = generator.uniform(-0.2, 0.2, size=self.model.nu)
            mujoco.mj_step(self.model, data)
            if step >= 200 and step % 40 == 39:
                mujoco.mj_forward(self.model, data)
                self.datas.append(copy(data))


@pytest.mark.parametrize("name", ["ant", "half_cheetah", "hopper", "walker2d", "humanoid"])
def test_rows_press_and_pull_as_mujoco_s(name: str) -> None:
    body = Touching(name)
    assert sum(data.ncon for data in body.datas) > NUM_STATES / 2
    assert_same_rows(body.model, body.datas)
