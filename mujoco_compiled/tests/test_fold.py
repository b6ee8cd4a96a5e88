"""A body with a limb in each lane moves as the whole body does."""

import mujoco
import numpy as np
import pytest

from mujoco_compiled.lanes.lane_constants import NotAlike
from mujoco_compiled.lanes.limbs import find_limbs
from mujoco_compiled.program.interpret import interpret
from mujoco_compiled.program.program import Assign, Program, Statement
from mujoco_compiled.tests.bodies import brax_model
from mujoco_compiled.tests.extra import extra
from mujoco_compiled.tests.states import of_all, states
from mujoco_compiled.write import Plan, control_step_in_lanes, control_step_program

_FIELDS = ("qpos", "qvel", "qacc_warmstart", "ctrl")


def plan_of(model: mujoco.MjModel, derived: tuple[str, ...] = ()) -> Plan:
    model.opt.iterations, model.opt.ls_iterations = 4, 8
    data = mujoco.MjData(model)
    return Plan(model, {name: np.size(getattr(data, name)) for name in _FIELDS}, (), derived)


def num_operations(statements: list[Statement] | tuple[Statement, ...]) -> int:
    return sum(1 if isinstance(one, Assign) else num_operations(one.body) for one in statements)


def assert_moves_alike(plan: Plan, lanes: Program) -> None:
    """Two substeps in double precision, from states with contacts."""
    datas = states(plan.model)
    given = {name: of_all(datas, name) for name in _FIELDS}
    expected = interpret(control_step_program(plan, 2), given)
    found = interpret(lanes, given)
    for name, values in expected.items():
        whole, shared = (np.stack(np.broadcast_arrays(*one)) for one in (values, found[name]))
        np.testing.assert_allclose(shared, whole, rtol=1e-9, atol=1e-9 * max(1.0, np.abs(whole).max()))


@pytest.mark.parametrize(
    ("name", "num_lanes", "least_saving"),
    [("ant", 4, 2.6), *extra(("humanoid", 2, 1.6), ("half_cheetah", 2, 1.7), ("walker2d", 2, 1.6))],
)
def test_a_body_moves_alike_with_a_limb_in_each_lane(name: str, num_lanes: int, least_saving: float) -> None:
    plan = plan_of(brax_model(name), ("qfrc_actuator", "subtree_com", "cvel"))
    lanes, whole = control_step_in_lanes(plan, 2), control_step_program(plan, 2)
    assert lanes.num_lanes == num_lanes
    assert num_operations(whole.statements) > least_saving * num_operations(lanes.statements)
    assert_moves_alike(plan, lanes)


def test_limbs_may_differ_in_all_their_numbers() -> None:
    model = brax_model("ant")
    generator = np.random.default_rng(0)
    for name in (
        "body_mass",
        "body_inertia",
        "body_ipos",
        "body_pos",
        "dof_armature",
        "dof_damping",
        "geom_size",
    ):
        values = getattr(model, name)
        values[:] = values * generator.uniform(0.8, 1.2, size=values.shape)
    model.jnt_range[1:] *= generator.uniform(0.8, 1.2, size=(model.njnt - 1, 1))
    model.actuator_gear[:, 0] *= generator.uniform(0.8, 1.2, size=model.nu)
    plan = plan_of(model)
    lanes = control_step_in_lanes(plan, 2)
    assert lanes.num_lanes == 4
    assert_moves_alike(plan, lanes)


def test_a_limb_without_a_limit_is_not_like_the_others() -> None:
    model = brax_model("ant")
    model.jnt_limited[3] = 0
    plan = plan_of(model)
    limbs = find_limbs(model, 4)
    assert limbs is not None
    with pytest.raises(NotAlike, match="a limb has parts that another has not"):
        control_step_program(plan, 1, limbs=limbs)
    assert_moves_alike(plan, control_step_in_lanes(plan, 2))


def test_a_body_with_one_leg_has_one_lane() -> None:
    assert control_step_in_lanes(plan_of(brax_model("hopper")), 1).num_lanes == 1
