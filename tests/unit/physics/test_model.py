"""Models as they are loaded and changed before they are stepped."""

import mujoco
import numpy as np
import pytest

from core.physics.choose import engine_builder
from core.physics.engine import SolverSettings
from core.physics.model import brax_model, initial_qpos, with_solver

EULERDAMP = int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)


def test_bodies_without_joints_are_fused() -> None:
    # The file has 13 bodies for the ant; the four legs' first links have no joint.
    assert brax_model("ant").nbody == 10  # world, torso, and four legs of two links


def test_the_half_cheetahs_whole_mass_is_the_one_its_file_demands() -> None:
    assert brax_model("half_cheetah").body_mass.sum() == pytest.approx(14.0)


def test_an_episode_begins_at_the_files_own_initial_position() -> None:
    ant = brax_model("ant")
    assert initial_qpos(ant)[2] == 0.55  # the custom numeric init_qpos; qpos0 has 0.75
    hopper = brax_model("hopper")
    np.testing.assert_array_equal(initial_qpos(hopper), hopper.qpos0)


def test_solver_settings_change_a_copy() -> None:
    model = brax_model("ant")
    fast = with_solver(model, SolverSettings(iterations=1, ls_iterations=3, implicit_damping=False))
    assert (fast.opt.iterations, fast.opt.ls_iterations) == (1, 3)
    assert fast.opt.disableflags & EULERDAMP
    assert model.opt.iterations == 4
    assert not model.opt.disableflags & EULERDAMP
    again = with_solver(fast, SolverSettings(iterations=2, ls_iterations=3, implicit_damping=True))
    assert not again.opt.disableflags & EULERDAMP
    assert with_solver(model, None).opt.iterations == 4


def test_a_field_that_no_engine_computes_is_refused() -> None:
    with pytest.raises(ValueError, match="qfrc_bias"):
        engine_builder("native")(brax_model("ant"), 1, ("qfrc_bias",))
