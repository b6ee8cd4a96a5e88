"""Whole substeps in double precision against C MuJoCo, both converged.

The largest relative errors of 512 states, all with contacts, of each environment's own model: of qacc after
one substep, and of qpos and qvel after 50. Last, how far C MuJoCo's qvel is after 50 from its own where it
begins 1e-13 away in every number.

              qacc     qpos     qvel     C MuJoCo itself
ant           1.3e-13  8.7e-14  1.1e-9   1.2e-8
half_cheetah  1.7e-13  3.8e-15  7.1e-13  5.7e-11
hopper        5.4e-14  2.0e-15  3.6e-14  7.1e-12
walker2d      1.2e-13  3.9e-15  3.3e-13  6.1e-11
humanoid      1.2e-12  1.0e-14  1.7e-13  1.5e-11
corridor      7.6e-13  3.5e-16  8.7e-14  3.4e-11
"""

from copy import copy
from dataclasses import replace
from functools import cache
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from core.environments import catalog
from core.physics.choose import engine_builder
from core.physics.engine import Engine, SolverSettings
from core.physics.model import brax_model, initial_qpos
from mujoco_compiled.substep import SubstepState, read_model
from tests.extra import extra
from tests.unit.physics.compiled.recorded_substep import recorded

NUM_STATES = 64
# Our solver leaves no error with these. A line search may end within the solver's own tolerance, as the next
# iteration goes on from there: below it, rounding alone would end most of them, after three times as long.
THOROUGH: dict[str, Any] = {"iterations": 20, "line_search_iterations": 30, "line_search_tolerance": 1.0}
Arrays = list[NDArray[np.float64]]
# How joints are damped in training. Those that NumPy moves in a tenth of a second, and others.
QUICK = {"ant": False, "half_cheetah": True, "hopper": True, "walker2d": True, "humanoid": False}
LARGE = {"corridor": True, "rodent": True, "brittle_star": False}
# The rodent takes ten minutes.
SLOW = [pytest.mark.slow, pytest.mark.timeout(1800)]


def converged(name: str, *, implicit_damping: bool) -> mujoco.MjModel:
    return converge(brax_model(name), implicit_damping=implicit_damping)


def converge(model: mujoco.MjModel, *, implicit_damping: bool) -> mujoco.MjModel:
    """The model itself, with settings with which MuJoCo's solver leaves no error."""
    model.opt.iterations, model.opt.ls_iterations = 100, 50
    model.opt.tolerance, model.opt.ls_tolerance = 1e-15, 1e-6
    if not implicit_damping:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    return model


@cache
def of_environment(name: str) -> tuple[mujoco.MjModel, SolverSettings | None]:
    """The environment's own model, and its solver settings for engines on which iterations are expensive."""
    kept: list[tuple[mujoco.MjModel, SolverSettings | None]] = []

    def build(
        model: mujoco.MjModel,
        num_substeps: int,
        derived: tuple[str, ...],
        *,
        accelerated: SolverSettings | None = None,
    ) -> Engine:
        kept.append((model, accelerated))
        return engine_builder("native")(model, num_substeps, derived, accelerated=accelerated)

    info = catalog.find(name)
    catalog.make(info, info.options(), build)
    return kept[0]


def states(model: mujoco.MjModel, num_states: int = NUM_STATES) -> list[mujoco.MjData]:
    """As they come about where a body falls and writhes on the floor; each of them has contacts."""
    generator, found = np.random.default_rng(0), list[mujoco.MjData]()
    limited = model.actuator_ctrllimited.astype(bool)
    low, high = np.where(limited, model.actuator_ctrlrange.T, [[-1.0], [1.0]])
    while len(found) < num_states:
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = initial_qpos(model), 0.1 * generator.normal(size=model.nv)
        for step in range(200 + 10 * NUM_STATES):
            if step % 10 == 0:
                share = 0.3 * generator.uniform(-0.5, 0.5, size=model.nu)
                data.ctrl[:] = 0.5 * (low + high) + share * (high - low)
            mujoco.mj_step(model, data)
            if step >= 200 and step % 10 == 9 and data.ncon:
                kept = mujoco.MjData(model)
                mujoco.mj_copyData(kept, model, data)
                found.append(kept)
    return found[:num_states]


def of_all(datas: list[mujoco.MjData], field: str) -> Arrays:
    return list(np.stack([getattr(data, field) for data in datas], axis=1))


def relative(ours: Arrays, theirs: Arrays) -> float:
    """The largest relative error of a state's vector."""
    return float(relative_of_each(ours, theirs).max())


def relative_of_each(ours: Arrays, theirs: Arrays) -> NDArray[np.float64]:
    """The relative error of each state's vector, [states]."""
    apart = np.linalg.norm(np.stack(np.broadcast_arrays(*ours)) - np.stack(theirs), axis=0)
    return apart / np.linalg.norm(np.stack(theirs), axis=0)


@pytest.mark.parametrize(
    ("name", "num_states", "num_substeps"),
    [
        ("ant", 512, 1),
        ("hopper", 8, 50),
        ("corridor", 32, 1),
        *extra(*((name, 512, 1) for name in QUICK if name != "ant")),
        *extra(*((name, 8, 50) for name in QUICK if name != "hopper")),
        *extra(*((name, 32, 1) for name in LARGE if name != "corridor")),
        *(pytest.param(name, 512, 50, marks=SLOW) for name in (*QUICK, *LARGE)),
    ],
)
def test_a_body_on_the_floor_moves_as_in_mujoco(name: str, num_states: int, num_substeps: int) -> None:
    model = converge(copy(of_environment(name)[0]), implicit_damping=(QUICK | LARGE)[name])
    datas, ours = states(model, num_states), read_model(model)
    ours = replace(ours, solver=replace(ours.solver, **THOROUGH))
    state = SubstepState(*(of_all(datas, field) for field in ("qpos", "qvel", "act", "qacc_warmstart")))
    ctrl = of_all(datas, "ctrl")
    step = recorded(ours, state, ctrl)
    for number in range(1, num_substeps + 1):
        state = step(state, ctrl)
        for data in datas:
            mujoco.mj_step(model, data)
        if number == 1:
            assert relative(state.qacc, of_all(datas, "qacc")) < 1e-9
    for field in ("qpos", "qvel"):
        assert relative(getattr(state, field), of_all(datas, field)) < 1e-6
