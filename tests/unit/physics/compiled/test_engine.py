"""The engine beyond what every engine must do: its bits, its code on disk, and what it refuses."""

from dataclasses import fields
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import mujoco_compiled
from core.errors import JobFailed
from core.physics.compiled import CompiledEngine
from core.physics.engine import DERIVED_FIELDS, MODEL_FIELDS, PhysicsState
from core.physics.model import brax_model, initial_qpos
from mujoco_compiled.code import cpu_call, kept_code


@pytest.fixture(scope="module")
def engine() -> CompiledEngine:
    return CompiledEngine(brax_model("hopper"), 4, ())


def begun(engine: CompiledEngine, num_envs: int) -> PhysicsState:
    model = brax_model("hopper")
    qvel = 0.5 * jax.random.normal(jax.random.key(0), (num_envs, model.nv))
    qpos = jnp.tile(jnp.asarray(initial_qpos(model), jnp.float32), (num_envs, 1))
    return jax.vmap(engine.reset)(qpos, qvel)


def after(engine: CompiledEngine, state: PhysicsState) -> PhysicsState:
    """Ten steps later, each environment under a control of its own speed's making."""
    step = jax.vmap(lambda one: engine.step(one, jnp.clip(one.qvel[:3], -1.0, 1.0)))
    return jax.jit(lambda state: jax.lax.fori_loop(0, 10, lambda _, one: step(one), state))(state)


@pytest.mark.parametrize("num_cores", [1, 2, 5])
def test_no_number_of_threads_or_neighbours_changes_a_bit(
    engine: CompiledEngine, num_cores: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = begun(engine, 100)
    whole = after(engine, state)
    monkeypatch.setattr(cpu_call, "num_cores", lambda: num_cores)
    for part in (slice(0, 100), slice(3, 50), slice(99, 100)):
        alone = after(engine, jax.tree.map(lambda leaf, part=part: leaf[part], state))
        for one, other in zip(jax.tree.leaves(alone), jax.tree.leaves(whole), strict=True):
            np.testing.assert_array_equal(one, other[part])


def test_code_is_made_once_for_one_body(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept_code, "_folder", None)
    kept_code.keep_code(tmp_path / "code")
    first = after(*of_mass(1.5))
    (file,) = (tmp_path / "code").iterdir()
    made_at = file.stat().st_mtime_ns
    again, heavier = after(*of_mass(1.5)), after(*of_mass(3.0))
    assert file.stat().st_mtime_ns == made_at
    assert len(list((tmp_path / "code").iterdir())) == 2
    np.testing.assert_array_equal(first.qpos, again.qpos)
    assert np.abs(first.qpos - heavier.qpos).max() > 1e-3


def of_mass(factor: float) -> tuple[CompiledEngine, PhysicsState]:
    model = brax_model("hopper")
    model.body_mass[2] *= factor
    engine = CompiledEngine(model, 4, ())
    return engine, begun(engine, 5)


def test_a_model_that_is_not_covered_is_refused_by_its_element() -> None:
    body = "<worldbody><body><freejoint/><geom size='1'/></body></worldbody>"
    xml = f"<mujoco><option integrator='RK4'/>{body}</mujoco>"
    with pytest.raises(JobFailed, match="its integrator is rk4"):
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
