"""Random models: each is refused with a sentence, or moves as in C MuJoCo, both converged.

The scale of an error is the length of the state's vector in MuJoCo, and 1e-3 at least, for states at rest.
The solver minimises a cost that curves as M at least. So where rounding leaves a gradient g, the error of
qacc is |M⁻¹ g| at most: the forces times 1e-16 times the condition of M, which is 1e5 at most here. Of a body
at rest, where forces cancel, that is more of its qacc. The largest error of the first 360 models was 4e-11
(and 2e-12 at the 90th percentile of models).
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from mujoco_compiled.coverage import uncovered
from mujoco_compiled.program.arithmetic import Vector
from mujoco_compiled.substep import Model, SubstepState, read_model
from mujoco_compiled.tests.random_models import random_model
from mujoco_compiled.tests.recorded_substep import recorded
from mujoco_compiled.tests.states import THOROUGH, Arrays, converge, of_all

NUM_STATES, MOST, MOST_SPEED = 8, 1e-9, 1e3
NUM_MODELS = 24
# Almost all states converge within the first. Those that do not are solved again within C MuJoCo's own (see
# `converge`). For all states these would take minutes in NumPy. A state that has converged stays where it is.
FEW = THOROUGH | {"iterations": 30}
MANY = THOROUGH | {"iterations": 100, "line_search_iterations": 50}


def states(model: mujoco.MjModel) -> list[mujoco.MjData]:
    """At random, and up to 60 steps later; those alone of which the next step is determined."""
    generator, found = np.random.default_rng(0), list[mujoco.MjData]()
    for number in range(NUM_STATES):
        data = mujoco.MjData(model)
        mujoco.mj_integratePos(model, data.qpos, generator.normal(size=model.nv), 0.3)
        data.qvel[:], data.ctrl[:] = generator.normal(size=model.nv), generator.normal(size=model.nu)
        data.act[:] = 0.3 * generator.normal(size=model.na)
        mujoco.mj_step(model, data, 20 * (number % 4))
        # A state that is past all bounds, MuJoCo puts back to the beginning. One that bursts is on its way.
        bursts = any(warning.number for warning in data.warning) or np.abs(data.qvel).max() > MOST_SPEED
        if bursts or has_contacts_without_a_normal(model, data):
            continue
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
    """Of each state."""
    expected = np.stack(theirs)
    found = np.stack([np.broadcast_to(x, expected.shape[1]) for x in ours])
    apart, size = (np.linalg.norm(x, axis=0) for x in (found - expected, expected))
    return apart / np.maximum(size, 1e-3)


def largest_errors(moved: SubstepState, datas: list[mujoco.MjData]) -> NDArray[np.float64]:
    """Of each state, the largest of its vectors' errors."""
    fields = ("qacc", "qvel", "qpos", *(("act",) if datas[0].act.size else ()))
    return np.max([errors(getattr(moved, field), of_all(datas, field)) for field in fields], axis=0)


def compare(xml: str) -> Counter[str]:
    """The result for a model, which is refused or moves as in MuJoCo."""
    model = converge(mujoco.MjModel.from_xml_string(xml), implicit_damping=True)
    if reason := uncovered(model):
        assert reason.startswith("it")
        return Counter({"refused": 1})
    datas, ours = states(model), read_model(model)
    if not datas:
        return Counter()
    begun = [of_all(datas, field) for field in ("qpos", "qvel", "act", "qacc_warmstart", "ctrl")]
    # In C MuJoCo the solver's error in qvel is its error in qacc times the stiffness of contacts.
    model.opt.tolerance = 0.0
    for data in datas:
        step_converged(model, data)
    late = np.flatnonzero(largest_errors(moved(ours, begun, np.arange(len(datas)), FEW), datas) > MOST)
    if late.size:
        found = largest_errors(moved(ours, begun, late, MANY), [datas[number] for number in late])
        assert found.max() < MOST, dict(zip(late, found, strict=True))
    touching = sum(data.ncon > 0 for data in datas)
    return Counter({"states": len(datas), "states with contacts": touching, "late states": late.size})


def moved(
    ours: Model, begun: list[Arrays], chosen: NDArray[np.intp], limits: Mapping[str, Any]
) -> SubstepState:
    """Some of the states, one step later."""
    *parts, ctrl = ([x[chosen] for x in part] for part in begun)
    model, state = replace(ours, solver=replace(ours.solver, **limits)), SubstepState(*parts)
    return recorded(model, state, ctrl)(state, ctrl)


@pytest.mark.extra
def test_random_models_are_refused_or_move_as_in_mujoco() -> None:
    seen = Counter[str]()
    for seed in range(NUM_MODELS):
        xml = random_model(seed)
        try:
            seen += compare(xml)
        except Exception as error:
            error.add_note(f"The model of seed {seed}: {xml}")
            raise
    assert seen["refused"] == 3
    assert seen["states"] >= 120
    assert seen["states with contacts"] >= 50
    assert seen["late states"] == 0


def test_a_state_whose_line_search_is_long_moves_as_in_mujoco() -> None:
    # There Newton's steps lead from each end of the line to just inside the other, 38 times, and where the
    # search is cut off after 30, the cost is higher than before it.
    assert compare((Path(__file__).parent / "long_line_search.xml").read_text())["late states"] == 1
