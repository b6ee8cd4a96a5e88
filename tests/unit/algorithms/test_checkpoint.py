from typing import Any

import numpy as np
import pytest
from flax import serialization

from core.algorithms.checkpoint import Format, describe, kind_of
from core.algorithms.ppo.learner import FORMAT
from core.algorithms.ppo.spec import PPOSpec
from core.errors import JobFailed
from tests import probes
from tests.unit.algorithms.checkpoints import pack

STATE = {"weights": np.arange(6, dtype=np.float32).reshape(2, 3), "key": np.array([1, 2], np.uint32)}
PROGRESS = {"step": 512, "updates": 1, "evaluated": 0}


def description(**changes: Any) -> dict[str, Any]:
    return describe(probes.endless(), PPOSpec.model_validate(changes))


def refusal(content: bytes, wanted: dict[str, Any], template: Any = STATE) -> str:
    """The sentence with which a checkpoint is refused."""
    with pytest.raises(JobFailed) as failure:
        FORMAT.unpack(content, wanted, template)
    assert failure.value.reason == "bad_checkpoint"
    return failure.value.detail


def test_what_is_packed_is_unpacked() -> None:
    progress, state = FORMAT.unpack(pack(description(), PROGRESS, STATE), description(), STATE)
    assert progress == PROGRESS
    np.testing.assert_array_equal(state["weights"], STATE["weights"])
    assert state["key"].dtype == np.uint32


def test_equal_states_give_equal_bytes() -> None:
    assert pack(description(), PROGRESS, STATE) == pack(description(), PROGRESS, dict(STATE))
    assert pack(description(), PROGRESS, STATE) != pack(
        description(), PROGRESS, STATE | {"key": STATE["key"] + 1}
    )


@pytest.mark.parametrize("content", [b"", b"not a checkpoint", b"\x81\xa6header\x80"])
def test_bytes_that_are_no_checkpoint_are_refused(content: bytes) -> None:
    assert "cannot be read" in refusal(content, description())


def test_a_checkpoint_that_was_cut_off_is_refused() -> None:
    assert "cannot be read" in refusal(pack(description(), PROGRESS, STATE)[:-10], description())


def test_a_changed_byte_in_the_state_is_found() -> None:
    content = bytearray(pack(description(), PROGRESS, STATE))
    place = content.index(STATE["weights"].tobytes())
    content[place + 5] ^= 1
    assert "damaged" in refusal(bytes(content), description())


def test_another_version_is_refused_by_name() -> None:
    content = serialization.msgpack_restore(pack(description(), PROGRESS, STATE))
    content["header"]["format"] = "gaitway-ppo-9"
    assert "'gaitway-ppo-9'" in refusal(serialization.msgpack_serialize(content), description())


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"num_envs": 128}, "num_envs is 256 in the checkpoint and 128 in this job"),
        (
            {"policy_hidden_layer_sizes": [8]},
            "policy_hidden_layer_sizes is [32, 32, 32, 32] in the checkpoint and [8]",
        ),
        ({"unroll_length": 5}, "env_steps_per_update is 20480 in the checkpoint and 10240 in this job"),
    ],
)
def test_a_run_of_another_shape_is_told_what_differs(change: dict[str, Any], sentence: str) -> None:
    assert sentence in refusal(pack(description(), PROGRESS, STATE), description(**change))


def test_a_longer_budget_and_another_learning_rate_go_on_from_a_checkpoint() -> None:
    wanted = description(num_timesteps=10**9, learning_rate=1e-5, entropy_cost=0.1)
    assert FORMAT.unpack(pack(description(), PROGRESS, STATE), wanted, STATE)[0] == PROGRESS


def test_a_state_of_another_shape_is_told_where() -> None:
    template = {"weights": np.zeros((2, 4), np.float32), "bias": np.zeros(1, np.float32), "key": STATE["key"]}
    sentence = refusal(pack(description(), PROGRESS, STATE), description(), template)
    assert "weights is float32[2, 3] in the checkpoint and float32[2, 4] in this job" in sentence
    assert "bias is missing in the checkpoint and float32[1] in this job" in sentence


def test_the_header_says_what_was_trained() -> None:
    header, state = FORMAT.read(pack(description(), PROGRESS, STATE))
    assert header["format"] == "gaitway-ppo-2"
    assert header["observation_size"] == 1
    assert sorted(state) == ["key", "weights"]


@pytest.mark.parametrize("kind", ["dqn", "ppo", "q_learning", "sac", "soft-actor-critic"])
def test_a_checkpoint_says_which_algorithm_wrote_it(kind: str) -> None:
    assert kind_of(Format(f"gaitway-{kind}-2").pack({}, PROGRESS, STATE)) == kind


@pytest.mark.parametrize("name", ["gaitway-ppo", "elsewhere-ppo-2", ""])
def test_a_checkpoint_that_names_no_algorithm_is_refused(name: str) -> None:
    with pytest.raises(JobFailed, match="cannot be read"):
        kind_of(serialization.msgpack_serialize({"header": {"format": name}}))
    with pytest.raises(ValueError, match="must be gaitway-<kind>-<version>"):
        Format(name)
