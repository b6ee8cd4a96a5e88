"""The notebooks of the rodent and the corridor to the letter: what their numbers mean on today's bodies."""

from collections.abc import Callable
from functools import cache
from typing import Any

import jax
import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from core.environments import catalog
from core.environments.dm_control.corridor.info import CorridorOptions
from core.environments.dm_control.corridor.model import composed, corridor_model
from core.environments.dm_control.rodent.model import rodent_model
from core.errors import Rejected
from core.jobs.checks import check
from core.jobs.spec import JOB_SPEC
from core.jobs.store import JobStore
from core.physics.availability import choose
from core.physics.choose import engine_builder
from core.physics.model import initial_qpos

# The corridor notebook's solver; the rodent notebook's is CG with 6 and 6.
CORRIDORS_SOLVER: dict[str, Any] = {"solver": "cg", "iterations": 1, "ls_iterations": 4}


@cache
def settled() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The notebook's ant as dm_control composes it, with the notebook's cone, after 3 s without control."""
    model = composed(CorridorOptions())[0].compile()
    model.opt.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    model.opt.noslip_iterations = 0
    data = mujoco.MjData(model)
    data.qpos[0] = 5.0
    mujoco.mj_step(model, data, 1500)
    mujoco.mj_forward(model, data)
    return model, data


def test_the_notebooks_fifth_body_is_a_leg() -> None:
    model, data = settled()
    assert model.nbody == 17  # as many as the notebook counts
    assert [model.body(number).name for number in (1, 4, 5)] == [
        "walls",
        "walker/torso",
        "walker/front_left_leg",
    ]
    # The whole ant weighs 12.4 kg; the leg's subtree is an eighth of it, and lies beside the trunk.
    assert model.body("walker/torso").subtreemass[0] == pytest.approx(12.38, abs=0.01)
    assert model.body(5).subtreemass[0] == pytest.approx(1.46, abs=0.01)
    assert np.linalg.norm(data.subtree_com[5] - data.subtree_com[4]) > 0.4


def test_the_notebooks_height_is_below_the_ground_when_the_ant_is_at_rest() -> None:
    model, data = settled()
    # `q[2]` is that of a frame that hangs 0.522 m below the trunk.
    assert model.body("walker/torso").pos[2] == pytest.approx(0.522)
    assert data.qpos[2] == pytest.approx(0.362 - 0.522, abs=2e-3)
    assert data.body("walker/torso").xpos[2] == pytest.approx(0.362, abs=2e-3)


def test_the_solver_that_a_job_names_is_what_native_computes_with() -> None:
    info = catalog.find("corridor")
    options = catalog.parse_options(info, CORRIDORS_SOLVER)
    environment = catalog.make(info, options, engine_builder("native"))
    state = jax.jit(environment.reset)(jax.random.key(0))
    action = np.linspace(-1.0, 1.0, 8, dtype=np.float32)
    after = jax.jit(environment.step)(state, action)
    ends = []
    for is_cg in (True, False):
        model = corridor_model(CorridorOptions())
        if is_cg:
            model.opt.solver = mujoco.mjtSolver.mjSOL_CG
            model.opt.iterations, model.opt.ls_iterations = 1, 4
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = state.physics.qpos, state.physics.qvel, action
        mujoco.mj_step(model, data, 5)
        ends.append(np.array(data.qvel))
    np.testing.assert_allclose(after.physics.qvel, ends[0], rtol=1e-4, atol=1e-4)
    assert np.abs(ends[0] - ends[1]).max() > 1e-2  # The converged solver's is another motion.


def _after_a_tenth_of_a_second(
    model: mujoco.MjModel, solver: tuple[mujoco.mjtSolver, int, int]
) -> NDArray[Any]:
    """Positions after 0.1 s of constant random controls, from rest. solver: and its iterations."""
    model.opt.solver, model.opt.iterations, model.opt.ls_iterations = solver
    data = mujoco.MjData(model)
    data.qpos[:] = initial_qpos(model)
    data.ctrl[:] = np.random.default_rng(0).uniform(-1.0, 1.0, model.nu)
    mujoco.mj_step(model, data, 50)
    return np.array(data.qpos)


@pytest.mark.parametrize(
    ("make", "cg", "newtons_m", "cgs_m"),
    [
        (lambda: rodent_model(0.002), (6, 6), 1e-3, 1e-2),
        (lambda: corridor_model(CorridorOptions()), (1, 4), 1e-5, 2e-4),
    ],
    ids=["rodent", "ant"],
)
def test_the_notebooks_solver_is_ten_times_as_far_off_as_ours(
    make: Callable[[], mujoco.MjModel], cg: tuple[int, int], newtons_m: float, cgs_m: float
) -> None:
    model, newton = make(), mujoco.mjtSolver.mjSOL_NEWTON
    exact = _after_a_tenth_of_a_second(model, (newton, 100, 50))
    ours = _after_a_tenth_of_a_second(model, (newton, 4, 8))
    theirs = _after_a_tenth_of_a_second(model, (mujoco.mjtSolver.mjSOL_CG, *cg))
    assert np.abs(ours - exact).max() < newtons_m
    assert np.abs(theirs - exact).max() > cgs_m


@pytest.mark.parametrize("environment", ["rodent", "corridor"])
def test_compiled_is_refused_for_a_solver_that_it_lacks(environment: str, jobs: JobStore) -> None:
    job = {
        "kind": "train",
        "environment": {"id": environment, "options": {"solver": "cg"}},
        "physics": "compiled",
    }
    with pytest.raises(Rejected, match=r"the solver 'cg', and 'compiled' has Newton's alone") as refused:
        check(JOB_SPEC.validate_python(job), jobs)
    assert [problem.pointer for problem in refused.value.problems] == ["/physics"]
    info = catalog.find(environment)
    row = info.under(catalog.parse_options(info, {"solver": "cg"}))
    assert choose("auto", "cpu", 2048, row.on_a_cpu, row.cannot_run).name == "native"
    assert "compiled" not in info.under(catalog.parse_options(info, {})).cannot_run


def test_a_rodent_that_does_not_see_where_it_is_is_said_to_observe_two_numbers_fewer() -> None:
    info = catalog.find("rodent")
    hidden = catalog.parse_options(info, {"exclude_current_positions_from_observation": True})
    assert (info.observation_size, info.under(hidden).observation_size) == (1260, 1258)
