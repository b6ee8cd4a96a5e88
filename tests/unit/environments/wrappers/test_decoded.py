"""The decoder of a trained policy between actions and a body."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.policy_file import read_policy
from core.algorithms.ppo.policy import make_inference
from core.algorithms.ppo.spec import PPOSpec
from core.environments import catalog
from core.environments.environment import Environment
from core.environments.wrappers.decoded import is_decoded, read_decoder
from core.errors import JobFailed
from core.physics.choose import engine_builder
from tests.exports import numpy_file_of, policy_file
from tests.unit.environments.mjcf.probe import KEY, XML, build, options
from worker.training.exports import simulation_document

JOB = "019aa3c2f0b1-5be0c1d2e3"
# The probe's ball and arm have 6 positions that are seen, and 7 velocities.
QPOS, QVEL = {"kind": "qpos"}, {"kind": "qvel"}
NETWORK = {"kind": "intention", "latent": 3, "encoder": [5], "decoder": [6], "places": [[0, 6]]}
TRAINED = policy_file(
    PPOSpec.model_validate({"network": NETWORK, "normalize_observations_max_abs_value": 2.0}),
    np.random.default_rng(0).normal(size=(50, 13)).astype(np.float32),
    1,
)


def decoded(folder: Path, content: bytes, sees: list[Any], **task: Any) -> Environment:
    (folder / "model").write_bytes(XML)
    (folder / "decoder").write_bytes(content)
    info = catalog.find("mjcf")
    action = {"kind": "decoder", "job": JOB, "latent": 3, "reach": 4.0, "moves": {"kind": "control"}}
    chosen = catalog.parse_options(info, options(action={**action, "sees": sees}, **task))
    builder = engine_builder("native")
    return catalog.make(info, chosen, builder, folder / "model", decoder=folder / "decoder")


def sees_velocities() -> list[Any]:
    """The term of velocities with all its fields, as a submission fills it in."""
    info = catalog.find("mjcf")
    chosen: Any = catalog.parse_options(info, options(observation=[QVEL]))
    return [term.model_dump(mode="json") for term in chosen.observation]


def test_an_intention_moves_the_body_as_the_policy_that_had_it(tmp_path: Path) -> None:
    alone = build(tmp_path, observation=[QPOS, QVEL])
    behind = decoded(
        tmp_path, numpy_file_of(TRAINED), sees_velocities(), observation=[{"kind": "previous_action"}, QVEL]
    )
    assert (behind.action_size, behind.observation_size) == (3, 8)
    act = make_inference(read_policy(TRAINED))
    params = read_policy(TRAINED).policy["params"]["encoder"]
    state, other = (jax.jit(one.reset)(KEY) for one in (alone, behind))
    for _ in range(3):
        # The encoder's mean, by hand: its first layer, swish, and half of its last.
        seen = jnp.clip((state.obs - _normalizer().mean) / _normalizer().std, -2.0, 2.0)[:6]
        hidden = jax.nn.swish(seen @ params["hidden_0"]["kernel"] + params["hidden_0"]["bias"])
        intention = (hidden @ params["hidden_1"]["kernel"] + params["hidden_1"]["bias"])[:3]
        action = act(state.obs, KEY)
        state = alone.step(state, action)
        other = behind.step(other, intention / 4.0)
        np.testing.assert_allclose(other.physics.qpos, state.physics.qpos, atol=1e-6)
        # What the task calls its action is the body's.
        np.testing.assert_allclose(other.obs[0], action[0], atol=1e-5)


def _normalizer() -> Any:
    return read_policy(TRAINED).normalizer


def test_what_cannot_act_behind_a_decoder_says_so(tmp_path: Path) -> None:
    behind = decoded(tmp_path, numpy_file_of(TRAINED), sees_velocities(), observation=[QVEL])
    assert is_decoded(behind)
    assert "a decoder stands between" in simulation_document(behind)["refusal"]


@pytest.mark.parametrize(
    ("content", "task", "sentence"),
    [
        (b"junk", [QVEL], "damaged, or has no decoder"),
        (numpy_file_of(policy_file(PPOSpec(), np.ones((2, 13)), 1)), [QVEL], "damaged, or has no decoder"),
        (numpy_file_of(TRAINED), [QPOS], "this task has 0, 3, 1"),
    ],
    ids=["junk", "no-decoder", "lacking"],
)
def test_a_decoder_that_does_not_fit_ends_the_job(
    tmp_path: Path, content: bytes, task: list[Any], sentence: str
) -> None:
    with pytest.raises(JobFailed, match=sentence):
        decoded(tmp_path, content, sees_velocities(), observation=task)


def test_a_decoder_sees_what_its_encoder_did_not(tmp_path: Path) -> None:
    (tmp_path / "decoder").write_bytes(numpy_file_of(TRAINED))
    decoder = read_decoder(tmp_path / "decoder")
    assert (decoder.latent, len(decoder.mean), decoder.action_size) == (3, 7, 1)
