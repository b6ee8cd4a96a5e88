"""Random models: each is refused with a sentence, or moves as in C MuJoCo, both converged.

The scale of an error is the length of the state's vector in MuJoCo, and 1e-3 at least, for states at rest.
The solver minimises a cost that curves as M at least. So where rounding leaves a gradient g, the error of
qacc is |M⁻¹ g| at most: the forces times 1e-16 times the condition of M, which is 1e5 at most here. Of a body
at rest, where forces cancel, that is more of its qacc. The largest in 332 models was 8e-10 (qacc, of a body
at rest; 3e-12 at the 90th percentile), and 1e-10 (qvel).
"""

from collections import Counter
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, seed
from hypothesis import settings as searching
from numpy.typing import NDArray

from core.physics.compiled.coverage import uncovered
from core.physics.compiled.program.arithmetic import Vector
from core.physics.compiled.substep import State, read_model, substep
from tests.unit.physics.compiled.random_models import models
from tests.unit.physics.compiled.test_substep import Arrays, converge, of_all

NUM_STATES = 8
# How many states are enough. Hypothesis draws constants of all loaded modules, too, so how many models of a
# search are covered depends on the tests beside this one: the search goes on until these are there.
LEAST, MOST_SEARCHES = {"refused": 2, "states": 100, "states with contacts": 40}, 10
searched = searching(
    max_examples=15,
    database=None,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


def states(model: mujoco.MjModel) -> list[mujoco.MjData]:
    """At random, and up to 60 steps later."""
    generator, found = np.random.default_rng(0), list[mujoco.MjData]()
    for number in range(NUM_STATES):
        data = mujoco.MjData(model)
        mujoco.mj_integratePos(model, data.qpos, generator.normal(size=model.nv), 0.3)
        data.qvel[:], data.ctrl[:] = generator.normal(size=model.nv), generator.normal(size=model.nu)
        data.act[:] = 0.3 * generator.normal(size=model.na)
        mujoco.mj_step(model, data, 20 * (number % 4))
        # A state that is past all bounds, MuJoCo puts back to the beginning.
        assume(not any(warning.number for warning in data.warning))
        assume(not has_contacts_without_a_normal(model, data))
        found.append(data)
    return found


def has_contacts_without_a_normal(model: mujoco.MjModel, data: mujoco.MjData) -> bool:
    """Whether two balls, or balls at two capsules' ends, have one centre: each program has its own normal."""
    round_ones = np.isin(model.geom_type, [mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE])
    return any(
        round_ones[contact.geom].all() and contact.dist < 1e-9 - model.geom_size[contact.geom, 0].sum()
        for contact in data.contact
    )


def step_converged(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """C MuJoCo's step. Its solver can stop too early where it begins far away."""
    mujoco.mj_forward(model, data)
    data.qacc_warmstart[:] = data.qacc
    mujoco.mj_step(model, data)


def errors(ours: Vector, theirs: Arrays) -> NDArray[np.float64]:
    expected = np.stack(theirs)
    found = np.stack([np.broadcast_to(x, NUM_STATES) for x in ours])
    apart, size = (np.linalg.norm(x, axis=0) for x in (found - expected, expected))
    return apart / np.maximum(size, 1e-3)


def test_a_random_model_is_refused_or_moves_as_in_mujoco() -> None:
    seen = Counter[str]()

    def check(xml: str) -> None:
        model = converge(mujoco.MjModel.from_xml_string(xml), implicit_damping=True)
        if reason := uncovered(model):
            seen["refused"] += 1
            assert reason.startswith("it")
            return
        datas, ours = states(model), read_model(model)
        ours = replace(ours, solver=replace(ours.solver, iterations=30, line_search_iterations=30))
        fields = (of_all(datas, field) for field in ("qpos", "qvel", "act", "qacc_warmstart"))
        moved = substep(ours, State(*fields), of_all(datas, "ctrl"))
        # In C MuJoCo the solver's error in qvel is its error in qacc times the stiffness of contacts.
        model.opt.tolerance = 0.0
        for data in datas:
            seen["states"] += 1
            step_converged(model, data)
            seen["states with contacts"] += data.ncon > 0
        for field in ("qacc", "qvel", "qpos"):
            assert errors(getattr(moved, field), of_all(datas, field)).max() < 1e-9, field
        if model.na:
            assert errors(moved.act, of_all(datas, "act")).max() < 1e-9

    for number in range(MOST_SEARCHES):
        seed(number)(searched(given(models())(check)))()
        if all(seen[what] >= least for what, least in LEAST.items()):
            return
    pytest.fail(f"The searches found too little: {dict(seen)}.")
