"""How far each engine solves for Brax's ant and humanoid: what a policy learns on one must hold on others."""

import mujoco
import pytest

from core.physics.model import with_asked_solver, with_enough_iterations, with_solver, with_solver_of_compiled
from tests.unit.physics.compiled.test_substep import of_environment

_EXPLICIT = int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)


def _solver(model: mujoco.MjModel) -> tuple[int, int, bool]:
    return model.opt.iterations, model.opt.ls_iterations, not model.opt.disableflags & _EXPLICIT


@pytest.mark.parametrize(("body", "on_native"), [("ant", 100), ("humanoid", 8)])
def test_compiled_and_native_solve_to_the_end_and_mjx_and_warp_as_brax(body: str, on_native: int) -> None:
    model, settings = of_environment(body)
    assert _solver(with_asked_solver(model, settings)) == (on_native, 50, True)
    assert _solver(with_solver_of_compiled(model, settings)) == (4, 8, True)
    assert _solver(with_enough_iterations(model, settings)) == (2, 4, False)
    assert _solver(with_solver(model, settings)) == (1, 4, False)
