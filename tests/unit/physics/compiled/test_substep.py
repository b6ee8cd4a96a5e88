"""Whole substeps in double precision against C MuJoCo, both converged."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from core.physics.compiled.substep import State, read_model, substep
from core.physics.model import brax_model

NUM_STATES, NUM_SUBSTEPS = 64, 20
Arrays = list[NDArray[np.float64]]


def converged(name: str, *, implicit_damping: bool) -> mujoco.MjModel:
    return converge(brax_model(name), implicit_damping=implicit_damping)


def converge(model: mujoco.MjModel, *, implicit_damping: bool) -> mujoco.MjModel:
    """The model itself, with settings with which MuJoCo's solver leaves no error."""
    model.opt.iterations, model.opt.ls_iterations = 100, 50
    model.opt.tolerance, model.opt.ls_tolerance = 1e-15, 1e-6
    if not implicit_damping:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    return model


def states(model: mujoco.MjModel) -> list[mujoco.MjData]:
    """As they come about where a body falls and writhes on the floor."""
    generator = np.random.default_rng(0)
    data, found = mujoco.MjData(model), list[mujoco.MjData]()
    for step in range(200 + 10 * NUM_STATES):
        if step % 10 == 0:
            data.ctrl[:] = generator.uniform(-0.3, 0.3, size=model.nu)
        mujoco.mj_step(model, data)
        if step >= 200 and step % 10 == 9:
            kept = mujoco.MjData(model)
            mujoco.mj_copyData(kept, model, data)
            found.append(kept)
    return found


def of_all(datas: list[mujoco.MjData], field: str) -> Arrays:
    return list(np.stack([getattr(data, field) for data in datas], axis=1))


def relative(ours: Arrays, theirs: Arrays) -> float:
    """The largest relative error of a state's vector."""
    apart = np.linalg.norm(np.stack(np.broadcast_arrays(*ours)) - np.stack(theirs), axis=0)
    return float((apart / np.linalg.norm(np.stack(theirs), axis=0)).max())


@pytest.mark.parametrize(
    ("name", "implicit_damping"),
    [("ant", False), ("half_cheetah", True), ("hopper", True), ("walker2d", False), ("humanoid", True)],
)
def test_a_body_on_the_floor_moves_as_in_mujoco(name: str, implicit_damping: bool) -> None:
    model = converged(name, implicit_damping=implicit_damping)
    datas, ours = states(model), read_model(model)
    ours = replace(ours, solver=replace(ours.solver, iterations=15, line_search_iterations=25))
    state = State(*(of_all(datas, field) for field in ("qpos", "qvel")), [], of_all(datas, "qacc_warmstart"))
    ctrl = of_all(datas, "ctrl")
    assert sum(data.ncon > 0 for data in datas) > NUM_STATES / 4
    for number in range(1, NUM_SUBSTEPS + 1):
        state = substep(ours, state, ctrl)
        for data in datas:
            mujoco.mj_step(model, data)
        if number == 1:
            assert relative(state.qacc, of_all(datas, "qacc")) < 1e-9
    assert relative(state.qpos, of_all(datas, "qpos")) < 1e-6
    assert relative(state.qvel, of_all(datas, "qvel")) < 1e-6
