"""Steps of many environments: their bits beside others, and their code on disk."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mujoco_compiled import Data, forward, keep_code, make_data, put_model, step
from mujoco_compiled.code import cpu_call, kept_code
from mujoco_compiled.tests.bodies import brax_model

Moves = Callable[[Data], Data]


@pytest.fixture(scope="module")
def hopper() -> tuple[Moves, Data]:
    return of_mass(1.0)


def of_mass(factor: float) -> tuple[Moves, Data]:
    """Ten steps of 100 hoppers, each under a control of its own speed's making, and where they begin."""
    model = brax_model("hopper")
    model.body_mass[2] *= factor
    m = put_model(model, nstep=4)
    once = jax.vmap(lambda d: step(m, d.replace(ctrl=jnp.clip(d.qvel[:3], -1.0, 1.0))))
    qvel = 0.5 * jax.random.normal(jax.random.key(0), (100, model.nv))
    begun = jax.vmap(lambda one: forward(m, make_data(m).replace(qvel=one)))(qvel)
    return jax.jit(partial(jax.lax.fori_loop, 0, 10, lambda _, d: once(d))), begun


@pytest.mark.parametrize("num_cores", [1, 2, 5])
def test_no_number_of_threads_or_neighbours_changes_a_bit(
    hopper: tuple[Moves, Data], num_cores: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    moves, begun = hopper
    whole = moves(begun)
    monkeypatch.setattr(cpu_call, "num_cores", lambda: num_cores)
    for part in (slice(0, 100), slice(3, 50), slice(99, 100)):
        alone = moves(jax.tree.map(lambda leaf, part=part: leaf[part], begun))
        for one, other in zip(jax.tree.leaves(alone), jax.tree.leaves(whole), strict=True):
            np.testing.assert_array_equal(one, other[part])


def test_code_is_made_once_for_one_body(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept_code, "_folder", None)
    keep_code(tmp_path / "code")
    moves, begun = of_mass(1.5)
    first = moves(begun)
    (file,) = (tmp_path / "code").iterdir()
    made_at = file.stat().st_mtime_ns
    (moves, begun), (others_moves, _) = of_mass(1.5), of_mass(3.0)
    again, heavier = moves(begun), others_moves(begun)
    assert file.stat().st_mtime_ns == made_at
    assert len(list((tmp_path / "code").iterdir())) == 2
    np.testing.assert_array_equal(first.qpos, again.qpos)
    assert np.abs(first.qpos - heavier.qpos).max() > 1e-3
