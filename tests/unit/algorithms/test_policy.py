import functools
import io
import os
import pickle
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.io import model
from brax.training.acme import running_statistics
from brax.training.agents.ppo.networks import make_inference_fn, make_ppo_networks
from brax.training.agents.sac import networks as brax_sac
from hypothesis import given
from hypothesis import strategies as st

from core.algorithms import brax_pickle
from core.algorithms.brax_training import RunningStatisticsState, UInt64, init_normalizer
from core.algorithms.checkpoint import describe
from core.algorithms.policy_file import (
    PolicyConfig,
    PolicyParams,
    _PolicyPickler,
    read_policy,
    write_policy,
)
from core.algorithms.ppo.networks import init_params, make_networks
from core.algorithms.ppo.policy import load, make_inference, policy_from_checkpoint
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.sac import policy as sac
from core.algorithms.sac.networks import make_networks as make_sac_networks
from core.algorithms.sac.spec import SACSpec
from core.environments.rollout import Roller
from core.errors import JobFailed
from gaitway import PolicyUnreadable
from gaitway import policy as client_policy
from tests import probes
from tests.unit.algorithms.checkpoints import pack

SETTINGS = PPOSpec.model_validate({"policy_hidden_layer_sizes": [8, 4], "value_hidden_layer_sizes": [6]})
OBSERVATIONS = jnp.array([[1.0, -2.0, 0.5], [0.0, 3.0, -1.0]])
KEY = jax.random.PRNGKey(5)


@pytest.fixture(scope="module")
def params() -> PolicyParams:
    """A policy that sees 3 numbers and acts with 2, with a normaliser that has seen something."""
    trained = init_params(make_networks(3, 2, SETTINGS), jax.random.PRNGKey(0))
    normalizer = running_statistics.update(init_normalizer(3), OBSERVATIONS)
    return PolicyParams(normalizer, trained.policy, trained.value)


@pytest.mark.parametrize("deterministic", [True, False])
def test_brax_loads_the_file_and_acts_as_we_do(
    params: PolicyParams, tmp_path: Path, deterministic: bool
) -> None:
    path = tmp_path / "policy"
    path.write_bytes(write_policy(params))
    networks = make_ppo_networks(
        3,
        2,
        preprocess_observations_fn=running_statistics.normalize,
        policy_hidden_layer_sizes=(8, 4),
        value_hidden_layer_sizes=(6,),
    )
    policy = make_inference_fn(networks)(model.load_params(str(path)), deterministic=deterministic)
    expected, _ = policy(OBSERVATIONS, KEY)
    got = make_inference(read_policy(path.read_bytes()), deterministic=deterministic)(OBSERVATIONS, KEY)
    assert got.shape == (2, 2)
    np.testing.assert_array_equal(got, expected)


@pytest.mark.parametrize("deterministic", [True, False])
def test_brax_loads_the_file_of_sac_and_acts_as_we_do(tmp_path: Path, deterministic: bool) -> None:
    settings = SACSpec.model_validate({"policy_hidden_layer_sizes": [8, 4], "q_hidden_layer_sizes": [6]})
    trained = make_sac_networks(3, 2, settings).init(jax.random.PRNGKey(0), 3, 2, 0.1)
    normalizer = running_statistics.update(init_normalizer(3), OBSERVATIONS)
    path = tmp_path / "policy"
    path.write_bytes(sac.write_policy(normalizer, trained.policy, settings.model_dump()))
    networks = brax_sac.make_sac_networks(
        3, 2, preprocess_observations_fn=running_statistics.normalize, hidden_layer_sizes=(8, 4)
    )
    first_two = model.load_params(str(path))[:2]
    policy = brax_sac.make_inference_fn(networks)(first_two, deterministic=deterministic)
    expected, _ = policy(OBSERVATIONS, KEY)
    kept = read_policy(path.read_bytes())
    assert kept.config == PolicyConfig(activation="relu")
    got = sac.make_inference(kept, deterministic=deterministic)(OBSERVATIONS, KEY)
    assert got.shape == (2, 2)
    np.testing.assert_array_equal(got, expected)


def test_equal_policies_give_equal_files(params: PolicyParams) -> None:
    assert write_policy(params) == write_policy(jax.tree.map(jnp.array, params))


def test_a_file_written_under_python_3_11_2_is_read(params: PolicyParams) -> None:
    # There, a member of an enumeration is written as `getattr` of its class and its name.
    class Pickler(_PolicyPickler):
        def reducer_override(self, obj: Any, /) -> Any:
            if isinstance(obj, Enum):
                return getattr, (type(obj), obj.name)
            return super().reducer_override(obj)

    file = io.BytesIO()
    Pickler(file, protocol=4).dump(jax.tree.map(np.asarray, tuple(params)))
    assert b"getattr" in file.getvalue()
    assert b"getattr" not in write_policy(params)
    assert write_policy(read_policy(file.getvalue())) == write_policy(params)


def test_a_policy_comes_out_of_a_checkpoint_as_it_went_in(params: PolicyParams) -> None:
    normalizer, policy, value = params
    description = describe(probes.endless(), SETTINGS) | {"observation_size": 3, "action_size": 2}
    state = {"normalizer": normalizer, "params": {"policy": policy, "value": value}}
    got = policy_from_checkpoint(pack(description, {}, state))
    jax.tree.map(np.testing.assert_array_equal, got, jax.device_get(params))
    assert write_policy(got) == write_policy(params)


def test_a_bare_triple_is_a_policy_of_the_default_design(params: PolicyParams) -> None:
    triple = tuple(params)
    assert write_policy(triple) == write_policy(params)
    np.testing.assert_array_equal(
        make_inference(triple)(OBSERVATIONS, KEY), make_inference(params)(OBSERVATIONS, KEY)
    )


def test_a_policy_of_another_design_keeps_it_and_brax_still_reads_the_file(tmp_path: Path) -> None:
    settings = PPOSpec.model_validate(
        {**SETTINGS.model_dump(exclude_unset=True), "activation": "relu", "action_repeat": 3}
    )
    networks = make_networks(3, 2, settings)
    trained = init_params(networks, jax.random.PRNGKey(0))
    state = {
        "normalizer": running_statistics.update(init_normalizer(3), OBSERVATIONS),
        "params": {"policy": trained.policy, "value": trained.value},
    }
    sizes = {"observation_size": 3, "action_size": 2}
    kept = policy_from_checkpoint(pack(describe(probes.endless(), settings) | sizes, {}, state))
    assert kept.config == PolicyConfig(activation="relu", action_repeat=3)
    (path := tmp_path / "policy").write_bytes(write_policy(kept))
    assert read_policy(path.read_bytes()).config == kept.config
    with pytest.raises(JobFailed, match="not a policy file"):
        read_policy(path.read_bytes()[:-1])

    brax = make_inference_fn(networks)(model.load_params(str(path)), deterministic=True)(OBSERVATIONS, KEY)
    np.testing.assert_array_equal(make_inference(kept)(OBSERVATIONS, KEY), brax[0])
    # The same numbers under the default activation act otherwise.
    assert not np.allclose(make_inference(tuple(kept))(OBSERVATIONS, KEY), brax[0])


def test_a_policy_that_holds_its_actions_is_shown_step_by_step() -> None:
    # Observed is the time: a new action after 0, 3 and 6 of the episode's 8 steps.
    networks = make_networks(1, 1, SETTINGS)
    trained = init_params(networks, jax.random.PRNGKey(0))
    held = PolicyParams(init_normalizer(1), trained.policy, trained.value, PolicyConfig(action_repeat=3))
    env = probes.Probe(lambda obs, time, action: (action, jnp.where(time == 7, 1.0, 0.0)), shows_time=True)
    for params, decided in (
        (held, [0, 0, 0, 3, 3, 3, 6, 6]),
        (held.replace(config=PolicyConfig()), range(8)),
    ):
        policy = load(write_policy(params), is_checkpoint=False)
        shown, act = policy.acting(env)
        [episode] = Roller(shown, act).episodes(policy.parameters, KEY, num_steps=20, num_episodes=1)
        times = jnp.array([[float(time)] for time in decided])
        np.testing.assert_allclose(episode.action, make_inference(params)(times, KEY), rtol=1e-5)
        assert len(np.unique(episode.action)) == len(set(decided))
        np.testing.assert_array_equal(episode.reward, episode.action[:, 0])
        assert (shown.dt, episode.time[-1]) == (env.dt, 8 * env.dt)


def test_a_bounded_policy_keeps_its_bound_and_brax_acts_alike_when_it_is_told(tmp_path: Path) -> None:
    settings = PPOSpec.model_validate(
        {**SETTINGS.model_dump(exclude_unset=True), "normalize_observations_max_abs_value": 2.0}
    )
    trained = init_params(make_networks(3, 2, settings), jax.random.PRNGKey(0))
    state = {
        "normalizer": running_statistics.update(init_normalizer(3), OBSERVATIONS),
        "params": {"policy": trained.policy, "value": trained.value},
    }
    sizes = {"observation_size": 3, "action_size": 2}
    kept = policy_from_checkpoint(pack(describe(probes.endless(), settings) | sizes, {}, state))
    (path := tmp_path / "policy").write_bytes(write_policy(kept))
    networks = make_ppo_networks(
        3,
        2,
        preprocess_observations_fn=partial(running_statistics.normalize, max_abs_value=2.0),
        policy_hidden_layer_sizes=(8, 4),
        value_hidden_layer_sizes=(6,),
    )
    far = 100 * OBSERVATIONS
    brax = make_inference_fn(networks)(model.load_params(str(path)), deterministic=True)(far, KEY)[0]
    np.testing.assert_array_equal(make_inference(read_policy(path.read_bytes()))(far, KEY), brax)
    assert not np.allclose(make_inference(tuple(kept))(far, KEY), brax)


def test_a_policy_looks_at_its_own_of_several_observations() -> None:
    settings = PPOSpec.model_validate({**SETTINGS.model_dump(), "policy_obs_key": "eyes"})
    sizes = {"eyes": 3, "state": 5}
    trained = init_params(make_networks(sizes, 2, settings), jax.random.PRNGKey(0))
    params = PolicyParams(
        init_normalizer(sizes), trained.policy, trained.value, PolicyConfig(policy_obs_key="eyes")
    )
    back = read_policy(write_policy(params))
    alone = PolicyParams(init_normalizer(3), trained.policy, trained.value)
    np.testing.assert_array_equal(
        make_inference(back)({"eyes": OBSERVATIONS, "state": jnp.ones((2, 5))}, KEY),
        make_inference(alone)(OBSERVATIONS, KEY),
    )


def test_an_observation_that_is_not_there_is_named() -> None:
    settings = PPOSpec.model_validate({"value_obs_key": "privileged_state"})
    with pytest.raises(ValueError, match=r"no observation 'privileged_state'; there are \['state'\]"):
        make_networks({"state": 3}, 2, settings)


class Command:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, ("exit 1",)


@pytest.mark.parametrize(
    "content",
    [b"", b"no pickle", pickle.dumps(Command()), pickle.dumps((1, 2)), pickle.dumps((Command(), 1, 2))],
)
def test_a_file_that_is_no_policy_is_refused_and_runs_nothing(content: bytes) -> None:
    with pytest.raises(JobFailed, match="not a policy file") as failure:
        read_policy(content)
    assert failure.value.reason == "bad_checkpoint"


@pytest.mark.parametrize("on", ["device", "host"])
@pytest.mark.parametrize("protocol", [3, 4, 5])
def test_a_file_that_brax_wrote_is_read(params: PolicyParams, tmp_path: Path, on: str, protocol: int) -> None:
    triple = tuple(params) if on == "device" else jax.device_get(tuple(params))
    model.save_params(str(tmp_path / "policy"), triple)  # By pickle's default protocol.
    for content in ((tmp_path / "policy").read_bytes(), pickle.dumps(triple, protocol=protocol)):
        assert write_policy(read_policy(content)) == write_policy(params)


class Hostile:
    """It is pickled as this call, with this state."""

    def __init__(self, *reduced: Any) -> None:
        self.reduced = reduced

    def __reduce__(self) -> Any:
        return self.reduced


def _over(address: bytes, *shape: int, kind: str = "O") -> Hostile:
    return Hostile(np.ndarray, (shape, np.dtype(kind), address))


POINTER = (0xDEADBEEF).to_bytes(8, "little")
RECONSTRUCT = np.zeros(1).__reduce__()[0]
EXTENDED = functools.reduce(lambda inner, _: (inner, inner), range(60), ())
# As the audit's pickle_core.py and pickle_in_read.py have them, and their kind.
HOSTILE = {
    "objects at an address": (_over(POINTER, 1), {}, None),
    "used while it is read": (Hostile(np.ndarray, (_over(POINTER, 1),)), {}, None),
    "numbers by ndarray": (_over(POINTER, 2, kind="f4"), {}, None),
    "fewer bytes than the shape": (
        Hostile(RECONSTRUCT, (np.ndarray, (0,), b"b"), (1, (9,), np.dtype("f4"), False, POINTER)),
        {},
        {},
    ),
    "objects as state": (
        Hostile(RECONSTRUCT, (np.ndarray, (0,), b"b"), (1, (1,), np.dtype("O"), False, POINTER)),
        {},
        {},
    ),
    "the state of a dtype": (Hostile(np.dtype, ("f4",), (3, "|", None, ("a",), {"a": 1}, 1, 1, 0)), {}, {}),
    "a text of numbers": (np.array(["a"]), {}, {}),
    "records inside": (np.zeros(1, [("a", "O")]), {}, {}),
    "a name many times over": (EXTENDED, {}, {}),
    "a set": ({1}, {}, {}),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_h5_a_hostile_file_is_refused_and_nothing_of_numpys_is_called(name: str, tmp_path: Path) -> None:
    content = pickle.dumps(HOSTILE[name], protocol=4)
    with pytest.raises(JobFailed, match="not a policy file"):
        read_policy(content)
    (tmp_path / "policy").write_bytes(content)
    with pytest.raises(PolicyUnreadable, match="not a policy file"):
        client_policy.load(tmp_path / "policy", "ppo", is_checkpoint=False)


def test_h5_a_key_whose_hash_takes_for_ever_is_refused() -> None:
    nested = b"".join(b"\x94h" + bytes([number]) + b"\x86" for number in range(60))  # (x, x), 60 deep
    with pytest.raises(JobFailed, match="not a policy file"):
        read_policy(b"\x80\x04})" + nested + b"K\x01s.")


_SCALAR = np.float32(0).__reduce__()[0]
_CALLS = [np.ndarray, np.dtype, np.frombuffer, RECONSTRUCT, _SCALAR, getattr, os.system]
_NAMES = st.sampled_from([*_CALLS, RunningStatisticsState, UInt64, running_statistics.NormalizationMode])
_ATOMS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4) | st.binary(max_size=9)
_KINDS = st.sampled_from(["f4", "O", "i8", "V4", "U1", "c8"]).map(np.dtype)
_PICKLED = st.recursive(
    _ATOMS | _KINDS | _NAMES | st.just(np.zeros(2, np.float32)),
    lambda inner: (
        st.tuples(inner, inner)
        | st.dictionaries(st.text(max_size=4), inner, max_size=2)
        | st.builds(Hostile, _NAMES, st.lists(inner, max_size=4).map(tuple), inner)
    ),
    max_leaves=12,
)


def _is_data(value: Any) -> bool:
    if isinstance(value, dict):
        return all(type(name) is str and _is_data(one) for name, one in value.items())
    if isinstance(value, tuple):
        return all(map(_is_data, value))
    if isinstance(value, np.ndarray | np.generic):
        return value.dtype.kind in "biuf"
    return value is None or type(value) in (bool, int, float, str)


@given(_PICKLED, st.sampled_from([2, 4, 5]), st.data())
def test_h5_whatever_a_pickle_names_it_is_data_or_refused(said: Any, protocol: int, data: Any) -> None:
    content = bytearray(pickle.dumps((said, said), protocol=protocol))
    for _ in range(data.draw(st.integers(0, 2))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    try:
        found, _ = brax_pickle.read(bytes(content))
    except Exception:  # Both readers make a refusal of any.
        return
    assert _is_data(found)
