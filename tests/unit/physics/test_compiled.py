"""The library of the engine `compiled` behind the engines' interface: its refusals, and its fields."""

from dataclasses import fields

import jax
import jax.numpy as jnp
import mujoco
import pytest

import mujoco_compiled
from core.errors import JobFailed
from core.physics.choose import engine_builder
from core.physics.compiled import CompiledEngine
from core.physics.engine import DERIVED_FIELDS, MODEL_FIELDS, PhysicsState, SolverSettings, overflowed
from mujoco_compiled.constraints import contact_room
from mujoco_compiled.tests.test_contact_slots import boxes


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


def test_less_room_for_contacts_than_the_model_begins_with_is_refused_by_its_number() -> None:
    settings = SolverSettings(4, 8, implicit_damping=True, nconmax=47)
    with pytest.raises(JobFailed, match="48 points where it begins, more than its `nconmax` of 47"):
        engine_builder("compiled")(boxes(12), 1, (), accelerated=settings)


def test_a_body_without_room_for_its_contacts_is_told_from_one_that_bursts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(contact_room, "MOST_SLOTS", 50)
    model = boxes(13)
    engine, qpos = CompiledEngine(model, 1, ()), jnp.asarray(model.qpos0, jnp.float32)
    # Boxes that touch at 52 points, that fly, and one whose height is no number.
    starts = jnp.stack([qpos, qpos.at[2::7].add(1.0), qpos.at[2::7].add(1.0).at[2].set(jnp.nan)])

    def moved(qpos: jax.Array) -> PhysicsState:
        return engine.step(engine.reset(qpos, jnp.zeros(model.nv)), jnp.zeros(0))

    # One after the other: those of a vector share their room.
    states = [jax.jit(jax.vmap(moved))(one[None]) for one in starts]
    assert [float(overflowed(one)[0]) for one in states] == [1.0, 0.0, 0.0]
    assert [bool(jnp.isfinite(one.qpos).all()) for one in states] == [False, True, False]


def test_the_library_has_the_fields_that_every_engine_has() -> None:
    assert set(DERIVED_FIELDS) <= set(mujoco_compiled.DERIVED_FIELDS)
    assert set(MODEL_FIELDS) <= set(mujoco_compiled.MODEL_FIELDS)
    assert set(mujoco_compiled.DERIVED_FIELDS) <= {field.name for field in fields(mujoco_compiled.Data)}
