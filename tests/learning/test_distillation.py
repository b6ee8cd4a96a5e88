"""One policy learns from experts of which everything is known."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.events import TrainingProgress
from core.algorithms.trained_policy import load_policy, policy_from_checkpoint
from core.environments.task import TaskEnv
from core.errors import JobFailed, Rejected
from tests import probes
from tests.learning.runs import distillation_run, linear_expert
from tests.unit.environments.mjcf.test_imitation import flight, follower

# The probe flies forward in one clip and backward in the other, at 1 m/s; it sees its speeds, of which the
# first is along x and the last that of the elbow.
FORWARD = (0.5, 0, 0, 0, 0, 0, 0.2)
BACKWARD = (-1.0, 0, 0, 0, 0, 0, 0.2)
BY_CLIP = ({"clips": ["flight"]}, {"clips": ["ba.*"]})


def flying(folder: Path) -> TaskEnv:
    return follower(folder, [flight(), flight(-1.0, name="back")], observation=[{"kind": "qvel"}])


def test_a_student_does_in_each_clip_what_its_expert_does(tmp_path: Path) -> None:
    environment = flying(tmp_path)
    experts = (linear_expert(*FORWARD), linear_expert(*BACKWARD))
    run = distillation_run(environment, *experts, experts=BY_CLIP, num_evals=0, epoch_s=0.0)
    told = [event.metrics for event in run.events() if isinstance(event, TrainingProgress)]
    assert told[0]["training/beta"] == 1.0
    assert told[-1]["training/beta"] == 0.0
    # Of an untrained student it is about tanh(1)² = 0.58 in one clip and tanh(0.6)² = 0.29 in the other.
    assert told[-1]["training/action_error"] < 2e-3
    student = load_policy(run.policy(), "distillation", is_checkpoint=False)
    same = policy_from_checkpoint(run.checkpoint())
    assert environment.playback is not None
    for row, weights in ((2, FORWARD), (11, BACKWARD)):
        state = environment.at_frame(jnp.int32(row)).reset(jax.random.key(0))
        wanted = np.tanh(np.dot(weights, state.obs))
        for policy in (student, same):
            assert policy.answer is not None
            action = policy.answer(policy.parameters, state.obs, jax.random.key(0))
            np.testing.assert_allclose(action, [wanted], atol=0.1)


@pytest.mark.extra
def test_an_expert_sees_its_own_places_and_a_student_may_have_an_encoder() -> None:
    # The encoder sees one of the signs and the decoder the other; the expert has them the other way round.
    network = {"kind": "intention", "latent": 2, "encoder": [16], "decoder": [16], "places": [[0, 1]]}
    crossed: Any = [{"places": [[1, 1], [0, 1]]}]
    run = distillation_run(
        probes.intention(), linear_expert(0.4, 0.5), experts=crossed, network=network, num_timesteps=80 * 128
    )
    last = [event.metrics for event in run.events() if isinstance(event, TrainingProgress)][-1]
    # Who sees only one of the signs misses tanh(0.9) or tanh(0.1) by 0.3 or more, 0.1 in the mean square.
    assert last["training/action_error"] < 0.02
    assert last["training/latent_kl"] > 0


def test_what_does_not_fit_is_refused_before_it_begins(tmp_path: Path) -> None:
    with pytest.raises(JobFailed, match=r"sees 3 numbers, gives 1 .*; here it would see 2"):
        distillation_run(probes.intention(), linear_expert(1, 2, 3))
    with pytest.raises(JobFailed, match="needs more than an observation"):
        distillation_run(probes.intention(), replace(linear_expert(1, 2), answer=None))
    environment = flying(tmp_path)
    with pytest.raises(Rejected, match="The clip 'back' has no expert"):
        distillation_run(environment, linear_expert(*FORWARD), experts=BY_CLIP[:1])
