"""The library's stages on bodies of the catalog, with what they have beside small models."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from core.environments.brittle_star.model import star_model
from core.environments.brittle_star.options import DirectedOptions
from core.environments.dm_control.corridor.info import CorridorOptions
from core.environments.dm_control.corridor.model import corridor_model
from core.environments.dm_control.rodent.model import rodent_model
from core.physics.model import initial_qpos
from mujoco_compiled.coverage import uncovered
from mujoco_compiled.substep import SubstepState, control_step
from mujoco_compiled.tests.rows_of_mujoco import assert_same_rows
from mujoco_compiled.tests.states import converge, of_all, relative
from mujoco_compiled.tests.test_contact_sensors import sensing, values_of
from mujoco_compiled.tests.test_contact_substep import after_forward, assert_moves_as_mujoco
from mujoco_compiled.tests.test_fold import assert_moves_alike, num_operations, plan_of
from mujoco_compiled.tests.test_forces import assert_forces_are_mujoco_s, random_states
from mujoco_compiled.write import control_step_in_lanes, control_step_program
from tests.unit.physics.compiled.test_substep import of_environment


@pytest.mark.parametrize(
    "build",
    [
        lambda: rodent_model(0.002),
        lambda: star_model(DirectedOptions()),
        lambda: star_model(DirectedOptions(walls="contacts")),
    ],
    ids=["rodent", "bound star", "free star"],
)
def test_forces_on_real_bodies_are_mujoco_s(build: Callable[[], mujoco.MjModel]) -> None:
    """The rodent has actuators with activations on tendons, the brittle star is in a fluid."""
    model = build()
    assert_forces_are_mujoco_s(model, random_states(model, 0.1))


@pytest.mark.extra
def test_the_star_feels_the_ground_of_the_last_substep() -> None:
    model = converge(star_model(DirectedOptions()), implicit_damping=False)
    ours, datas = sensing(model), [mujoco.MjData(model) for _ in range(4)]
    generator = np.random.default_rng(0)
    for data in datas:
        data.qpos[:] = initial_qpos(model)
        data.ctrl[:] = generator.uniform(-0.5, 0.5, size=model.nu)
        mujoco.mj_step(model, data, 50)
    state = SubstepState(of_all(datas, "qpos"), of_all(datas, "qvel"), [], of_all(datas, "qacc_warmstart"))
    moved = control_step(ours, 3, state, of_all(datas, "ctrl"))
    for data in datas:
        mujoco.mj_step(model, data, 3)
    assert relative(values_of(ours, model, moved), of_all(datas, "sensordata")) < 1e-6
    assert all(data.sensordata.any() for data in datas)


@pytest.mark.extra
def test_the_ant_moves_in_its_corridor_as_in_mujoco() -> None:
    model = converge(corridor_model(CorridorOptions()), implicit_damping=True)
    assert uncovered(model) is None
    generator, datas = np.random.default_rng(0), list[mujoco.MjData]()
    # At the end of the first platform, on a gap, in a gap and beside the floor.
    for x, y, z in ((5.9, 0.0, 0.4), (7.6, 0.1, 0.3), (7.7, 0.0, 0.0), (10.5, 2.5, 0.3)):
        data = mujoco.MjData(model)
        data.qpos[:3] = x, y, z
        data.qvel[:] = generator.normal(size=model.nv)
        for step in range(1, 81):
            if step % 20 == 1:
                data.ctrl[:] = generator.uniform(-1.0, 1.0, size=model.nu)
            mujoco.mj_step(model, data)
            if step % 20 == 0:
                kept = mujoco.MjData(model)
                mujoco.mj_copyData(kept, model, data)
                datas.append(kept)
    assert_same_rows(model, [after_forward(model, data) for data in datas])
    assert_moves_as_mujoco(model, datas)


@pytest.mark.extra
@pytest.mark.parametrize(
    ("name", "num_lanes", "least_saving"), [("corridor", 4, 2.5), ("brittle_star", 5, 3.5)]
)
def test_limbs_touch_each_for_itself(name: str, num_lanes: int, least_saving: float) -> None:
    """Contacts are computed only where geoms touch: limbs of one body differ in that."""
    model, _ = of_environment(name)
    plan = plan_of(model)
    lanes, whole = control_step_in_lanes(plan, 2), control_step_program(plan, 2)
    assert lanes.num_lanes == num_lanes
    assert num_operations(whole.statements) > least_saving * num_operations(lanes.statements)
    assert_moves_alike(plan, lanes)
