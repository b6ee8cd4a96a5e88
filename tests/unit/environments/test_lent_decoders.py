"""The catalog's bodies behind a decoder of their own imitation: what they see, and what moves them."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.algorithms.ppo.spec import PPOSpec
from core.environments import catalog
from core.environments.dm_control.corridor.as_rodent import AsRodent
from core.environments.dm_control.corridor.info import CorridorOptions
from core.environments.dm_control.corridor.model import corridor_model
from core.environments.dm_control.rodent.model import rodent_model
from core.environments.terms.imitating import OBSERVATION
from core.environments.terms.inventory import inventory_of
from core.environments.terms.observations import Activation
from core.environments.terms.task import TaskOptions, parts_of
from core.environments.wrappers.decoded import Decoded
from core.errors import Rejected
from core.physics.choose import engine_builder
from core.physics.engine import PhysicsState
from core.physics.model import initial_qpos
from tests.exports import numpy_file_of, policy_file

# What the decoder of an imitation sees: all but the reference.
SEEN = {"rodent": [*OBSERVATION[1:], Activation()], "humanoid": OBSERVATION[1:]}
NETWORK = {"kind": "intention", "latent": 5, "encoder": [8], "decoder": [8], "places": [[0, 3]]}


def action(body: str) -> dict[str, Any]:
    """As a submission fills it in."""
    sees = [term.model_dump(mode="json") for term in SEEN[body]]
    moves = {"kind": "control", "scaled": body != "rodent"}
    return {
        "kind": "decoder", "job": "019aa3c2f0b1-5be0c1d2e3", "latent": 5, "sees": sees, "moves": moves,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("body", "environment", "options"),
    [
        pytest.param("rodent", "rodent", {}, marks=pytest.mark.extra),
        ("rodent", "corridor", {"walker": "rodent", "num_next_obstacles": 2, "num_layouts": 2}),
        ("humanoid", "humanoid", {}),
    ],
    ids=["rodent", "corridor", "humanoid"],
)
def test_a_decoder_that_imitated_moves_the_body_in_another_task(
    body: str, environment: str, options: dict[str, Any], tmp_path: Path
) -> None:
    model = inventory_of(body)
    parts = parts_of(TaskOptions(), model)
    size = sum(part.size for term in SEEN[body] for part in term.slices_of_history(parts))
    observations = np.random.default_rng(0).normal(size=(50, size + 3)).astype(np.float32)
    content = policy_file(PPOSpec.model_validate({"network": NETWORK}), observations, model.sizes.nu)
    (file := tmp_path / "decoder").write_bytes(numpy_file_of(content))
    row, chosen = catalog.resolve(environment, {**options, "action": action(body)})
    behind = catalog.make(row, chosen, engine_builder("native"), decoder=file)
    assert (row.observation_size, row.action_size) == (behind.observation_size, behind.action_size)
    assert behind.action_size == 5
    plain, _ = catalog.resolve(environment, options)
    assert (plain.observation_size or 0) + size == behind.observation_size

    assert isinstance(behind, Decoded)
    state = jax.jit(behind.reset)(jax.random.key(0))
    intention = jnp.linspace(-1, 1, 5)
    after = jax.jit(behind.step)(state, intention)
    # The names say which numbers the previous action is: what the decoder gave.
    [previous] = [part for part in row.spaces.observation if part.name == "previous_action"]
    given = after.obs[previous.start : previous.start + previous.size]
    expected = behind.decoder(3.5 * intention, state.obs[behind.places])
    np.testing.assert_allclose(given, expected, atol=1e-5)
    assert np.ptp(given) > 0.1


def test_a_rat_in_a_corridor_is_seen_as_the_one_on_a_floor() -> None:
    model = corridor_model(CorridorOptions.model_validate({"walker": "rodent", "arena": "empty"}))
    rodent = rodent_model(model.opt.timestep)
    data, random = mujoco.MjData(model), np.random.default_rng(0)
    data.qpos[:3], data.qpos[7:] = [3.0, 1.0, 0.5], random.normal(0, 0.2, model.nq - 7)
    data.qpos[3:7] = [0.5, -0.1, 0.7, 0.5] / np.linalg.norm([0.5, -0.1, 0.7, 0.5])
    data.qvel[:], data.act[:] = random.normal(0, 1, model.nv), random.normal(0, 1, model.na)
    mujoco.mj_forward(model, data)
    trunk = model.body("walker/torso").id
    seen = AsRodent(SEEN["rodent"], model, trunk, 0.01)
    fields = (jnp.float32(one) for one in (data.qpos, data.qvel, data.act, data.qacc_warmstart, data.time))
    physics = PhysicsState(*fields, derived={})
    given = jnp.linspace(-1, 1, model.nu)
    numbers, _ = seen(physics, physics, given, {})

    # MuJoCo's velocity of the torso's own frame: angular, then linear.
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, trunk, velocity, 1)
    expected = [
        velocity[3:],
        0.25 * velocity[:3],
        -data.xmat[trunk].reshape(3, 3)[2],
        data.qpos[7:] - initial_qpos(rodent)[7:],
        0.05 * data.qvel[6:],
        given,
        data.act,
    ]
    np.testing.assert_allclose(numbers, np.concatenate(expected), atol=1e-5)


@pytest.mark.parametrize(
    ("environment", "options", "changes", "sentence"),
    [
        ("rodent", {}, {"sees": [{"kind": "nonsense"}]}, "`sees` has not what a decoder of this body sees"),
        ("rodent", {}, {"sees": [{"kind": "reference_ahead"}]}, "`sees` has not what a decoder"),
        ("corridor", {}, {}, "is for the walker 'rodent': no environment trains a decoder of the ant"),
        ("corridor", {"walker": "rodent", "zero_action": "start"}, {}, "leave `zero_action` out"),
    ],
    ids=["junk", "reference", "ant", "zero-action"],
)
def test_what_no_decoder_fits_is_refused(
    environment: str, options: dict[str, Any], changes: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(Rejected, match=sentence):
        catalog.resolve(environment, {**options, "action": {**action("rodent"), **changes}})
