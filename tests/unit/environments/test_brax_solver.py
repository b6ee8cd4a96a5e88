"""How far each engine solves for Brax's ant and humanoid: what a policy learns on one must hold on others."""

import mujoco
import pytest

from core.environments import catalog
from core.physics.engine import Engine, SolverSettings
from core.physics.model import with_asked_solver, with_enough_iterations, with_solver, with_solver_of_compiled

_EXPLICIT = int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)


class _Asked(Exception):
    pass


class _Asking:
    """Ends the making of the environment where it asks for its engine."""

    name = "compiled"

    def __call__(
        self,
        model: mujoco.MjModel,
        num_substeps: int,
        derived: tuple[str, ...],
        *,
        accelerated: SolverSettings | None = None,
    ) -> Engine:
        raise _Asked(model, accelerated)


def _solver(model: mujoco.MjModel) -> tuple[int, int, bool]:
    return model.opt.iterations, model.opt.ls_iterations, not model.opt.disableflags & _EXPLICIT


@pytest.mark.parametrize(("body", "on_native"), [("ant", 100), ("humanoid", 8)])
def test_compiled_and_native_solve_to_the_end_and_mjx_and_warp_as_brax(body: str, on_native: int) -> None:
    with pytest.raises(_Asked) as asked:
        catalog.make(*catalog.resolve(body, {}), _Asking())
    model, settings = asked.value.args
    assert _solver(with_asked_solver(model, settings)) == (on_native, 50, True)
    assert _solver(with_solver_of_compiled(model, settings)) == (4, 8, True)
    assert _solver(with_enough_iterations(model, settings)) == (2, 4, False)
    assert _solver(with_solver(model, settings)) == (1, 4, False)
