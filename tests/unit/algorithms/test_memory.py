"""The least memory of a run: numbers that can be counted by hand, and by the trainer's own arrays."""

from typing import Any

import jax
import pytest

from core.algorithms.catalog import least_memory
from core.algorithms.dqn.network import QNetwork
from core.algorithms.dqn.spec import DQNSpec
from core.algorithms.memory import perceptron, shown
from core.algorithms.off_policy import replay
from core.algorithms.ppo.networks import init_params, make_networks
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.q_learning.replay import empty
from core.algorithms.q_learning.spec import QLearningSpec
from core.algorithms.sac.networks import make_networks as make_sac_networks
from core.algorithms.sac.spec import SACSpec
from core.environments import catalog

ANT = catalog.find("ant")
GIB = 2**30


def ppo(**said: Any) -> PPOSpec:
    return PPOSpec.model_validate(said)


def test_networks_have_as_many_parameters_as_brax_makes() -> None:
    settings = ppo(policy_hidden_layer_sizes=[8, 4], value_hidden_layer_sizes=[16])
    networks = make_networks(27, 8, settings)
    made = jax.eval_shape(lambda key: init_params(networks, key), jax.random.PRNGKey(0))
    counted = perceptron([27, 8, 4, 16]) + perceptron([27, 16, 1])
    assert counted == sum(leaf.size for leaf in jax.tree.leaves(made))
    part = least_memory(settings, ANT, 1).parts[1]
    assert part.bytes == 4 * 4 * counted  # float32; parameters, gradient, two moments


def test_transitions_are_counted_by_update_and_shared_by_devices() -> None:
    # 1024 * 32 * 20 = 655,360 transitions of 27 + 8 + 4 = 39 floats.
    settings = ppo(num_envs=4096, batch_size=1024, num_minibatches=32, unroll_length=20)
    assert least_memory(settings, ANT, 1).parts[0].bytes == 655_360 * 39 * 4
    assert least_memory(settings, ANT, 4).parts[0].bytes == 655_360 * 39


def test_a_replay_buffer_has_the_size_of_the_arrays_it_is() -> None:
    said = {"replay": {"buffer_size": 1000}, "agents": [{}, {}]}
    part = least_memory(QLearningSpec.model_validate({"num_envs": 10, **said}), ANT, 1).parts[1]
    arrays = jax.tree.leaves(jax.eval_shape(lambda: empty(1000).steps))
    assert part.bytes == 2 * sum(4 * array.size for array in arrays) == 48_000


def test_sac_counts_its_replay_and_networks_as_the_arrays_they_are() -> None:
    settings = SACSpec.model_validate(
        {
            "num_envs": 10,
            "max_replay_size": 1009,  # 100 actions of each environment
            "policy_hidden_layer_sizes": [8, 4],
            "q_hidden_layer_sizes": [16],
            "q_network_layer_norm": False,
        }
    )
    kept, networks, environments = least_memory(settings, ANT, 1).parts
    ring = jax.tree.leaves(jax.eval_shape(lambda: replay.empty(100, 10, 27, 8).rows))
    assert kept.bytes == sum(4 * array.size for array in ring) == 4 * 1000 * (27 + 8 + 3)
    assert kept.lower == ("max_replay_size",)
    made = make_sac_networks(27, 8, settings)
    params = jax.eval_shape(lambda key: made.init(key, 27, 8, 0.1), jax.random.PRNGKey(0))
    policy, critics = (sum(leaf.size for leaf in jax.tree.leaves(part)) for part in (params.policy, params.q))
    # Parameters, gradient and two moments; and the critics that follow.
    assert networks.bytes == 4 * (4 * policy + 5 * critics)
    assert environments.bytes == 4 * 10 * 28


def test_dqn_counts_its_replay_and_network_as_the_arrays_they_are() -> None:
    settings = DQNSpec.model_validate(
        {
            "action_set": {"kind": "arm_roles"},
            "num_envs": 10,
            "max_replay_size": 1009,  # 100 actions of each environment
            "hidden_layer_sizes": [8, 4],
        }
    )
    row = catalog.find("brittle_star")
    star = row.under(catalog.parse_options(row, {"control": "cpg"}))
    # Three pairs of numbers for each of 50 joints and the disk, and three on the way: 2 · 50 + 4 · 3 + 3.
    assert star.observation_size == 115
    kept, network, environments = least_memory(settings, star, 1).parts
    # Five arms choose one of three roles each.
    ring = jax.tree.leaves(jax.eval_shape(lambda: replay.empty(100, 10, 115, 5).rows))
    assert kept.bytes == sum(4 * array.size for array in ring) == 4 * 1000 * (115 + 5 + 3)
    made = QNetwork(5, 3, (8, 4), "relu")
    params = jax.eval_shape(lambda key: made.init(key, 115), jax.random.PRNGKey(0))
    # Parameters, gradient and two moments; and the network that follows.
    assert network.bytes == 4 * 5 * sum(leaf.size for leaf in jax.tree.leaves(params))
    assert environments.bytes == 4 * 10 * 116


def test_the_sentence_says_what_is_needed_what_there_is_and_what_to_lower() -> None:
    settings = ppo(batch_size=2**20, num_minibatches=8, unroll_length=1000, num_envs=2**20)
    # 2^20 * 8 * 1000 transitions of 156 bytes are 1.19 TiB; 2^20 environments of 28 floats, 112 MiB.
    assert least_memory(settings, ANT, 1).does_not_fit(80 * GIB, "the largest GPU of a worker") == (
        "The run needs at least 1.19 TiB of memory on its device (1.19 TiB for the 8,388,608,000 transitions "
        "of one update, 112 MiB for 1,048,576 environments, 4.2 MiB for networks of 275,185 parameters with "
        "their gradient and Adam's moments), but the largest GPU of a worker has 80 GiB: lower batch_size, "
        "num_minibatches or unroll_length."
    )


@pytest.mark.parametrize(
    ("number", "expected"),
    [(0, "0 bytes"), (1023, "1,023 bytes"), (1536, "1.5 KiB"), (80 * GIB, "80 GiB"), (2**60, "1,024 PiB")],
)
def test_bytes_are_shown_with_three_digits(number: int, expected: str) -> None:
    assert shown(number) == expected
