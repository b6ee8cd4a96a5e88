import json
from typing import Any, get_args

import pytest
from brax.training.networks import ACTIVATION
from pydantic import ValidationError

from core.algorithms.catalog import reported, resolve
from core.algorithms.dqn.spec import DQNSpec
from core.algorithms.ppo.spec import Activation, PPOSpec
from core.algorithms.q_learning.spec import QLearningSpec
from core.algorithms.sac.spec import SACSpec
from core.algorithms.spec import BaseSpec, check_resumption
from core.environments import catalog
from core.environments.info import Device
from core.errors import Rejected


def refusal(**changes: Any) -> Rejected:
    """Why the ant is not trained with this on a CPU."""
    with pytest.raises(Rejected) as refused:
        resolve(PPOSpec.model_validate(changes), catalog.find("ant"), "cpu")
    return refused.value


def pointers(refused: Rejected) -> list[str]:
    return [problem.pointer for problem in refused.problems]


def test_a_lowest_learning_rate_above_the_highest_is_refused() -> None:
    refused = refusal(learning_rate_schedule_min_lr=0.1, learning_rate_schedule_max_lr=0.01)
    assert (
        "learning_rate_schedule_min_lr = 0.1 is above learning_rate_schedule_max_lr = 0.01" in refused.detail
    )
    assert pointers(refused) == [
        "/algorithm/learning_rate_schedule_min_lr",
        "/algorithm/learning_rate_schedule_max_lr",
    ]


@pytest.mark.parametrize(
    "spec",
    [
        PPOSpec(learning_rate=0.125),
        SACSpec(learning_rate=0.125),
        DQNSpec(learning_rate=0.125),
        QLearningSpec.model_validate({"state_discretizer": {"kind": "arm_role"}}),
    ],
)
def test_settings_that_another_version_recorded_are_understood(spec: BaseSpec) -> None:
    record = spec.model_dump(mode="json")
    assert reported({**record, "of_another_version": 1}) == spec
    with pytest.raises(ValidationError):
        reported({**record, "discounting": 2.0, "of_another_version": 1})


def test_settings_that_a_run_did_not_read_are_not_given_by_its_record() -> None:
    record = PPOSpec.model_validate({"network": {"kind": "intention"}}).model_dump(mode="json")
    given = reported(record).model_fields_set
    assert "network" in given
    assert "policy_hidden_layer_sizes" not in given


def test_an_observation_that_the_environment_does_not_have_is_refused() -> None:
    refused = refusal(value_obs_key="privileged_state")
    assert refused.detail == "ant has one observation, 'state', and none called 'privileged_state'."
    assert pointers(refused) == ["/algorithm/value_obs_key"]


def test_a_held_action_counts_as_the_steps_it_is_held_for() -> None:
    spec = PPOSpec.model_validate(
        {"num_envs": 8, "batch_size": 8, "num_minibatches": 2, "unroll_length": 5, "action_repeat": 3}
    )
    # Sixteen unrolls of five actions: 80 actions, ten of each environment, and three steps for each.
    assert (spec.env_steps_per_update, spec.actions_per_update) == (240, 10)
    assert spec.actions_per_episode == 334  # 1000 steps, and two more


def test_every_activation_is_one_of_brax_s() -> None:
    assert set(get_args(Activation)) <= set(ACTIVATION)


@pytest.mark.parametrize(
    ("spec", "change", "sentence"),
    [
        (PPOSpec, {"activation": "tanh"}, "activation = swish; this job has tanh"),
        (PPOSpec, {"action_repeat": 2}, "action_repeat = 1; this job has 2"),
        (PPOSpec, {"reset_pool_size": 0}, "returns_to_first_state = False; this job has True"),
        (SACSpec, {"activation": "tanh"}, "activation = relu; this job has tanh"),
        (SACSpec, {"max_replay_size": 2**18}, "replay_rows = 4096; this job has 2048"),
        (SACSpec, {"value_max": 50}, "value_max = 100.0; this job has 50.0"),
        (DQNSpec, {"hidden_layer_sizes": [8]}, r"hidden_layer_sizes = \[64, 64\]; this job has \[8\]"),
        (DQNSpec, {"action_set": {"kind": "leading_arm"}}, "action_set = None; this job has"),
        (SACSpec, {"unroll_length": 4}, "env_steps_per_update = 1024; this job has 512"),
    ],
)
def test_what_a_checkpoint_fixes_is_told_where_it_differs(
    spec: type[BaseSpec], change: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(Rejected, match=sentence):
        check_resumption(spec.model_validate(change), spec())


@pytest.mark.parametrize(
    "free",
    [
        PPOSpec.model_validate(
            {
                "learning_rate_schedule": "ADAPTIVE_KL",
                "desired_kl": 0.02,
                "clipping_epsilon_value": 0.2,
                "bootstrap_on_timeout": True,
                "reset_pool_size": 7,
            }
        ),
        SACSpec.model_validate(
            {
                "n_step": 1,
                "batch_size": 64,
                "grad_updates_per_step": 4,
                "min_replay_size": 0,
                "tau": 0.1,
                "reset_pool_size": 7,
            }
        ),
        DQNSpec.model_validate({"n_step": 3, "batch_size": 64, "tau": 0.1, "epsilon": {"start": 0.2}}),
    ],
    ids=lambda spec: spec.kind,
)
def test_what_does_not_change_the_state_may_change_on_the_way(free: BaseSpec) -> None:
    check_resumption(free, type(free)())


@pytest.mark.parametrize("device", ["cpu", "gpu"])
def test_what_was_resolved_for_an_environment_is_read_back_as_it_was(device: Device) -> None:
    # An attempt that goes on begins from what the one before wrote down.
    star = catalog.find("brittle_star")
    steered = star.under(catalog.parse_options(star, {"control": "cpg"}))
    trained = [(spec, info) for spec in (PPOSpec(), SACSpec()) for info in catalog.ENVIRONMENTS.values()]
    for spec, info in [*trained, (QLearningSpec(), steered), (DQNSpec(), steered)]:
        settings = resolve(spec, info, device)
        read_back = type(settings).model_validate_json(json.dumps(settings.model_dump()))
        assert resolve(read_back, info, device) == settings
