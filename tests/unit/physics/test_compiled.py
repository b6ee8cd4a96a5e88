"""The library of the engine `compiled` behind the engines' interface: its refusals, and its fields."""

from dataclasses import fields

import jax.numpy as jnp
import mujoco
import pytest

import mujoco_compiled
from core.errors import JobFailed
from core.physics.compiled import CompiledEngine
from core.physics.engine import DERIVED_FIELDS, MODEL_FIELDS


def test_a_model_that_is_not_covered_is_refused_by_its_element() -> None:
    body = "<worldbody><body><freejoint/><geom size='1'/></body></worldbody>"
    xml = f"<mujoco><option integrator='RK4'/>{body}</mujoco>"
    with pytest.raises(JobFailed, match="'compiled' cannot run the model: its integrator is rk4"):
        CompiledEngine(mujoco.MjModel.from_xml_string(xml), 1, ())


def test_a_field_that_environments_must_share_is_refused_by_name() -> None:
    shelf = "<body name='shelf'><geom size='1'/></body>"
    body = f"<worldbody>{shelf}<body><freejoint/><geom size='1'/></body></worldbody>"
    engine = CompiledEngine(mujoco.MjModel.from_xml_string(f"<mujoco>{body}</mujoco>"), 1, ())
    with pytest.raises(JobFailed, match="body_pos: its body 'shelf' stands still"):
        engine.reset(jnp.zeros(7), jnp.zeros(6), {"body_pos": jnp.zeros((3, 3))})


def test_the_library_has_the_fields_that_every_engine_has() -> None:
    assert set(DERIVED_FIELDS) <= set(mujoco_compiled.DERIVED_FIELDS)
    assert set(MODEL_FIELDS) <= set(mujoco_compiled.MODEL_FIELDS)
    assert set(mujoco_compiled.DERIVED_FIELDS) <= {field.name for field in fields(mujoco_compiled.Data)}
