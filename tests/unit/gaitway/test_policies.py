"""The client reads policies without the service's code, and they act as the service's own do."""

import pickle
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from itertools import product
from pathlib import Path
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.training.acme import running_statistics
from pydantic import TypeAdapter

from core.algorithms.brax_training import init_normalizer
from core.algorithms.catalog import ALGORITHMS
from core.algorithms.checkpoint import describe
from core.algorithms.dqn import policy as dqn
from core.algorithms.dqn.network import QNetwork
from core.algorithms.dqn.spec import DQNSpec
from core.algorithms.policy_file import PolicyConfig, PolicyParams, write_policy
from core.algorithms.ppo.networks import init_params, make_networks
from core.algorithms.ppo.policy import make_inference
from core.algorithms.ppo.spec import Activation, PPOSpec
from core.algorithms.q_learning import table as tables
from core.algorithms.q_learning.discrete_env import make_state_discretizer
from core.algorithms.q_learning.spec import StateDiscretizerOptions
from core.algorithms.q_learning.table import epsilon_greedy, greedy
from core.algorithms.sac import policy as sac
from core.algorithms.sac.networks import make_networks as make_sac_networks
from core.algorithms.sac.spec import SACSpec
from core.algorithms.trained_policy import load_policy
from gaitway import PolicyUnreadable, policy
from tests import probes
from tests.exports import numpy_file_of
from tests.extra import extra
from tests.learning.q_probes import PlanarStar
from tests.unit.algorithms.checkpoints import pack

Answer = Callable[[Any, jax.Array], jax.Array]

KEY = jax.random.key(5)
# The algorithms whose policies are networks.
NETWORKS = ("ppo", "sac", "dqn")
SMALL = {"policy_hidden_layer_sizes": [8, 4], "value_hidden_layer_sizes": [6]}
SEEN = {
    "state": jnp.array([[1.0, -2.0, 0.5], [0.0, 3.0, -1.0]]),
    "other": jnp.array([[4.0, 0.1], [-1.0, 2.0]]),
}


def ppo_files(settings: PPOSpec, *, by_name: bool = False) -> Mapping[bool, bytes]:
    """A checkpoint (True) and a policy file (False) of one policy whose normaliser has seen something."""
    sizes: Any = {"state": 3, "other": 2} if by_name else 3
    networks = make_networks(sizes, 2, settings)
    trained: Any = jax.jit(lambda key: init_params(networks, key))(jax.random.key(0))
    normalizer = init_normalizer(sizes)
    if settings.normalize_observations:
        normalizer = running_statistics.update(normalizer, SEEN if by_name else SEEN["state"])
    config = PolicyConfig.of(settings.model_dump() | {"encoder_places": settings.encoder_places})
    state = {"normalizer": normalizer, "params": {"policy": trained.policy, "value": trained.value}}
    description = describe(probes.endless(), settings) | {"observation_size": sizes, "action_size": 2}
    return {
        True: pack(description, {}, state),
        False: write_policy(PolicyParams(normalizer, trained.policy, trained.value, config)),
    }


def sac_files(settings: SACSpec) -> Mapping[bool, bytes]:
    """The same of SAC."""
    networks = make_sac_networks(3, 2, settings)
    trained: Any = jax.jit(lambda key: networks.init(key, 3, 2, 0.1))(jax.random.key(0))
    normalizer = init_normalizer(3)
    if settings.normalize_observations:
        normalizer = running_statistics.update(normalizer, SEEN["state"])
    facts = describe(probes.endless(), settings) | {"observation_size": 3, "action_size": 2}
    state = {"normalizer": normalizer, "params": trained}
    return {
        True: sac.FORMAT.pack(facts, {}, state),
        False: sac.write_policy(normalizer, trained.policy, facts),
    }


def dqn_files(settings: DQNSpec) -> Mapping[bool, bytes]:
    """The same of DQN; two parts of the body choose one of three actions each."""
    network = QNetwork(2, 3, tuple(settings.hidden_layer_sizes), settings.activation)
    params: Any = jax.jit(lambda key: network.init(key, 3))(jax.random.key(0))
    normalizer = init_normalizer(3)
    if settings.normalize_observations:
        normalizer = running_statistics.update(normalizer, SEEN["state"])
    facts = describe(probes.endless(), settings) | {"observation_size": 3, "action_size": 2}
    facts |= {"num_parts": 2, "num_choices": 3, "epsilon": 0.7}
    return {
        True: dqn.FORMAT.pack(facts, {}, {"normalizer": normalizer, "params": params}),
        False: dqn.write_policy(normalizer, params, facts),
    }


def files_of_network(algorithm: str, **options: Any) -> Mapping[bool, bytes]:
    """Those of an algorithm whose policies are networks."""
    sizes = {"policy_hidden_layer_sizes": [8, 4]}
    if algorithm == "sac":
        return sac_files(SACSpec.model_validate({**sizes, "q_hidden_layer_sizes": [6], **options}))
    if algorithm == "dqn":
        own = {"action_set": {"kind": "arm_actions", "actions": [[0.0], [0.5], [1.0]]}}
        sizes = {"hidden_layer_sizes": options.pop("policy_hidden_layer_sizes", [8, 4])}
        return dqn_files(DQNSpec.model_validate({**own, **sizes, **options}))
    return ppo_files(PPOSpec.model_validate({**SMALL, **options}))


def table_files(discretizer: Mapping[str, Any], num_rows: int) -> Mapping[bool, bytes]:
    """A checkpoint of two agents, whose second is the best, and that one's policy file."""
    both = np.random.default_rng(0).normal(size=(2, num_rows, 4)).astype(np.float32)
    facts = {
        "state_discretizer": discretizer,
        "action_set": {"kind": "actions", "actions": [[0.0]] * 4},
        "decision_steps": 5,
        "num_states": 5,
        "policy_agent": "best",
        "epsilon": [0.1, 0.7],
    }
    visits = np.zeros(both.shape, np.int32)
    state = {"table": both, "visits": visits, "eval_return": np.array([1.0, 2.0], np.float32)}
    learnt = tables.of_agent(1, both, visits, facts)
    return {True: tables.FORMAT.pack(facts, {}, state), False: tables.write_policy(learnt)}


def network_answers(algorithm: str, content: bytes, *, is_checkpoint: bool, deterministic: bool) -> Answer:
    """The service's own answers with a network."""
    own = load_policy(content, algorithm, is_checkpoint=is_checkpoint, deterministic=deterministic)
    if algorithm == "dqn":
        choose: Any = jax.jit(dqn.make_choose(dqn.read_policy(content)[1], deterministic=deterministic))
        return lambda observation, key: choose(own.parameters, observation, key)
    make: Any = {"ppo": make_inference, "sac": sac.make_inference}[algorithm]
    answer: Any = jax.jit(lambda params, *seen: make(params, deterministic=deterministic)(*seen))
    return lambda observation, key: answer(own.parameters, observation, key)


def table_answers(_: str, content: bytes, *, is_checkpoint: bool, deterministic: bool) -> Answer:
    """The service's own answers with a table, on a star of five arms."""
    learnt = tables.table_from_checkpoint(content) if is_checkpoint else tables.read_policy(content)
    options: Any = TypeAdapter(StateDiscretizerOptions).validate_python(learnt.facts["state_discretizer"])
    rows = make_state_discretizer(options, PlanarStar(observation_size=8))
    table, epsilon = jnp.asarray(learnt.table), jnp.float32(learnt.facts["epsilon"])

    def answer(seen: Any, key: jax.Array) -> jax.Array:
        if deterministic:
            return greedy(table, rows(seen))
        return epsilon_greedy(table, rows(seen), epsilon, key)

    return jax.jit(answer)


def clients_file(algorithm: str, content: bytes, *, is_checkpoint: bool) -> bytes:
    """The client reads `policy.npz` in place of the policy file that is for Brax."""
    return numpy_file_of(content) if algorithm in ("ppo", "sac") and not is_checkpoint else content


def assert_acts_alike(
    tmp_path: Path, algorithm: str, files: Mapping[bool, bytes], *observations: Any
) -> None:
    """The checkpoint's policy without noise and the file's with noise act as the service's own do.

    Bit for bit: both consist of the same operations.
    """
    answers = table_answers if algorithm == "q_learning" else network_answers
    for is_checkpoint, content in files.items():
        (tmp_path / "file").write_bytes(clients_file(algorithm, content, is_checkpoint=is_checkpoint))
        options: dict[str, bool] = {"is_checkpoint": is_checkpoint, "deterministic": is_checkpoint}
        act = policy.load(tmp_path / "file", algorithm, **options)
        answer = answers(algorithm, content, **options)
        for observation in observations:
            expected = answer(observation, KEY)
            got = act(observation, KEY)
            assert (got.dtype, got.shape) == (expected.dtype, expected.shape)
            np.testing.assert_array_equal(got, expected)


@pytest.fixture
def step_by_step() -> Iterator[None]:
    """Each operation alone: its program serves all tests, where whole networks would be compiled for each."""
    with jax.disable_jit():
        yield


@pytest.mark.parametrize("algorithm", NETWORKS)
def test_a_network_acts_alike(tmp_path: Path, algorithm: str) -> None:
    assert_acts_alike(tmp_path, algorithm, files_of_network(algorithm), SEEN["state"])


@pytest.mark.usefixtures("step_by_step")
@pytest.mark.parametrize(
    ("algorithm", "activation"), [("ppo", "tanh"), *extra(*product(NETWORKS, get_args(Activation)))]
)
def test_a_network_of_any_activation_acts_alike(tmp_path: Path, activation: str, algorithm: str) -> None:
    files = files_of_network(algorithm, activation=activation)
    assert_acts_alike(tmp_path, algorithm, files, SEEN["state"])


@pytest.mark.usefixtures("step_by_step")
@pytest.mark.parametrize(
    ("algorithm", "options"),
    [
        ("ppo", {"normalize_observations_max_abs_value": 0.5}),
        ("sac", {"action_repeat": 3}),
        ("ppo", {"network": {"kind": "intention", "latent": 2, "places": [[0, 1], [2, 1]]}}),
        *extra(
            *product(
                NETWORKS,
                ({"normalize_observations": False}, {"action_repeat": 3}, {"policy_hidden_layer_sizes": [5]}),
            )
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else next(iter(value)),
)
def test_a_network_under_any_option_acts_alike(
    tmp_path: Path, algorithm: str, options: dict[str, Any]
) -> None:
    whole_numbers = jnp.array([1, -2, 3])  # Brax does not normalise these.
    files = files_of_network(algorithm, **options)
    assert_acts_alike(tmp_path, algorithm, files, SEEN["state"][0], whole_numbers)


@pytest.mark.parametrize(("own", "values"), [("state", "other"), ("other", "state")])
def test_a_network_reads_its_own_of_several_observations(tmp_path: Path, own: str, values: str) -> None:
    settings = PPOSpec.model_validate({**SMALL, "policy_obs_key": own, "value_obs_key": values})
    assert_acts_alike(tmp_path, "ppo", ppo_files(settings, by_name=True), SEEN)


def test_no_option_of_a_network_is_left_out() -> None:
    # Those that the tests above vary; value_obs_key changes the value network alone.
    varied = {"activation", "normalize_observations_max_abs_value", "action_repeat", "policy_obs_key"}
    assert {field.name for field in fields(PolicyConfig)} == varied | {"encoder_places", "value_obs_key"}


TARGET = {"xy_direction_to_target": jnp.array([-1.0, -0.1]), "disk_rotation": jnp.array([0.0, 0.0, 0.4])}
GRID = [{"index": 2, "range": [0.0, 4.0], "cells": 4}, {"index": 0, "range": [0.0, 2.0], "cells": 3}]
DISCRETIZERS: dict[str, tuple[dict[str, Any], int, dict[str, jax.Array]]] = {
    "arm_towards_target": ({}, 5, TARGET),
    "arm_role": ({}, 5, TARGET),
    "arm_side": ({}, 3, TARGET),
    "disk_position_grid": (
        {"x": [-1.0, 1.0], "y": [0.0, 3.0], "cells": [2, 3]},
        6,
        {"disk_position": jnp.array([0.3, 1.1, 0.0])},
    ),
    "observation_grid": ({"components": GRID}, 12, {"observation": jnp.array([1.0, 7.0, 3.5])}),
}


@pytest.mark.parametrize("kind", DISCRETIZERS)
def test_a_table_acts_alike(tmp_path: Path, kind: str) -> None:
    options, num_rows, seen = DISCRETIZERS[kind]
    elsewhere = jax.tree.map(lambda values: -3 * values, seen)
    not_finite = jax.tree.map(lambda values: values * jnp.nan, seen)
    files = table_files({"kind": kind, **options}, num_rows)
    assert_acts_alike(tmp_path, "q_learning", files, seen, elsewhere, not_finite)


def test_every_algorithm_and_every_state_discretizer_is_read() -> None:
    union, _ = get_args(StateDiscretizerOptions)
    assert set(DISCRETIZERS) == {get_args(one.model_fields["kind"].annotation)[0] for one in get_args(union)}
    unread = set(ALGORITHMS) - set(policy.READERS)
    assert not unread, (
        f"{unread}: client.load_policy has no reader for them; see READERS in gaitway/policy.py"
    )


@pytest.mark.parametrize("algorithm", [*NETWORKS, "q_learning"])
@pytest.mark.parametrize("is_checkpoint", [True, False])
def test_a_damaged_file_is_refused(tmp_path: Path, algorithm: str, is_checkpoint: bool) -> None:
    is_table = algorithm == "q_learning"
    files = table_files({"kind": "arm_role"}, 5) if is_table else files_of_network(algorithm)
    content = clients_file(algorithm, files[is_checkpoint], is_checkpoint=is_checkpoint)
    damaged = [content[: len(content) // 2], b"nonsense"]
    if is_checkpoint or algorithm in ("q_learning", "dqn"):
        damaged.append(content.replace(b"-1", b"-9").replace(b"ppo-2", b"ppo-9"))
    for body in damaged:
        (tmp_path / "file").write_bytes(body)
        with pytest.raises(PolicyUnreadable):
            policy.load(tmp_path / "file", algorithm, is_checkpoint=is_checkpoint)


def test_no_code_that_a_file_names_runs(tmp_path: Path) -> None:
    class Attack:
        def __reduce__(self) -> Any:
            return Path.touch, (tmp_path / "ran",)

    (tmp_path / "file").write_bytes(pickle.dumps((Attack(), {}, {})))
    with pytest.raises(PolicyUnreadable):
        policy.load(tmp_path / "file", "ppo", is_checkpoint=False)
    assert not (tmp_path / "ran").exists()


def test_a_later_algorithm_is_refused_with_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(PolicyUnreadable, match="does not read policies of 'later'"):
        policy.load(tmp_path / "file", "later", is_checkpoint=False)
