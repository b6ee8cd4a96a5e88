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

import mujoco
import pytest

from core.environments import catalog
from core.physics.choose import engine_builder
from core.physics.engine import Engine, SolverSettings
from mujoco_compiled.substep import SubstepState, read_model
from mujoco_compiled.tests.recorded_substep import recorded
from mujoco_compiled.tests.states import THOROUGH, converge, of_all, relative, states
from tests.extra import extra

# How joints are damped in training. Those that NumPy moves in a tenth of a second, and others.
QUICK = {"ant": False, "half_cheetah": True, "hopper": True, "walker2d": True, "humanoid": False}
LARGE = {"corridor": True, "rodent": True, "brittle_star": False}
# The rodent takes ten minutes.
SLOW = [pytest.mark.slow, pytest.mark.timeout(1800)]


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
