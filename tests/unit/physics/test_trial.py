"""An engine beside C MuJoCo: right engines pass, wrong ones fail with a number."""

import copy
from dataclasses import replace

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.physics.choose import engine_builder
from core.physics.trial import ReferenceMotion, compare, record
from tests.contract.test_engines import BODY, DELAYED
from tests.unit.worker.validation.test_validation import CAR


def recorded(model: mujoco.MjModel) -> ReferenceMotion:
    reference = record(model)
    assert reference is not None
    assert reference.num_tries == 50
    return reference


@pytest.mark.parametrize(("xml", "engine"), [(BODY, "native"), (BODY, "compiled"), (DELAYED, "native")])
def test_engines_that_move_a_model_as_mujoco_does_are_right(xml: str, engine: str) -> None:
    model = mujoco.MjModel.from_xml_string(xml)
    reference = recorded(model)
    name = "native" if engine == "native" else "compiled"
    found = compare(engine_builder(name)(model, reference.num_substeps, ("sensordata",)), reference)
    assert found.is_right
    assert (found.half < 1e-5, found.broken) == (True, 0)


def test_an_engine_that_ignores_a_part_of_the_model_is_wrong_by_a_number() -> None:
    """As MJX ignored a delay, a plugin and disabled actuators (issue 41)."""
    model = mujoco.MjModel.from_xml_string(DELAYED)
    reference = recorded(model)
    at_once = copy.copy(model)
    at_once.actuator_delay[:] = 0.0
    found = compare(engine_builder("native")(at_once, reference.num_substeps, ()), reference)
    assert not found.is_right
    assert 0.01 < found.half < 1.0
    assert f"{found.quantity} is off by {found.half:.1g} of the motion" in found.words(50)


def test_an_engine_that_gives_numbers_that_are_none_is_wrong() -> None:
    """As Warp did for contacts without friction (issue 41)."""
    model = mujoco.MjModel.from_xml_string(BODY)
    reference = recorded(model)
    engine = engine_builder("native")(model, reference.num_substeps, ())
    step = engine.step
    engine.step = lambda state, ctrl: replace(  # type: ignore[method-assign]
        step(state, ctrl), qvel=jnp.where(ctrl[0] > 0, jnp.nan, 0.0) * state.qvel
    )
    found = compare(engine, reference)
    assert not found.is_right
    assert "of 50 states are not finite" in found.words(50)


def test_where_mujoco_itself_bursts_there_is_nothing_to_compare_with() -> None:
    assert record(mujoco.MjModel.from_xml_string(CAR.decode())) is None


def test_geoms_that_are_kept_apart_pass_through_each_other() -> None:
    model = mujoco.MjModel.from_xml_string("""
      <mujoco><worldbody><geom type="plane" size="5 5 1"/>
        <body pos="0 0 0.5"><freejoint/><geom size="0.1"/></body>
        <body pos="0.05 0 0.5"><freejoint/><geom size="0.1"/></body>
      </worldbody></mujoco>
    """)
    pushed, free = record(model), record(model, apart=[(2, 1)])
    assert pushed is not None
    assert free is not None
    # They overlap by 0.15 m, and MuJoCo throws them apart along x; both fall on the floor.
    assert np.abs(pushed.ended["qvel"][:25, 0]).max() > 1.0
    assert np.abs(free.ended["qvel"][:, [0, 6]]).max() < 1e-9
    assert free.ended["qpos"][-1, 2] == pytest.approx(0.1, abs=0.01)
    # The filter is gone after it.
    again = record(model)
    assert again is not None
    np.testing.assert_array_equal(again.ended["qpos"], pushed.ended["qpos"])
