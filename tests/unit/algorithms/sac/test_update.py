from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import pytest

from core.algorithms.sac.learner import Hyperparameters, Learner
from tests import probes
from tests.learning.sac_runs import sac_settings


def test_it_learns_as_soon_as_there_is_enough_and_never_stops() -> None:
    settings = sac_settings(min_replay_size=256)
    learner = Learner(probes.constant_reward(), settings)
    update, begun = jax.jit(learner.update), jax.jit(learner.init)(jnp.uint32(0))
    # Of 16 environments, an update adds 4 actions each, and 16 of each are 256 transitions: enough. Of
    # 2**27 actions of each there are 2**31, which is no int32.
    for written, learns in [(0, False), (11, False), (12, True), (2**27, True)]:
        state: Any = begun.replace(replay=begun.replay.replace(written=jnp.int32(written)))
        after, metrics, _ = update(state, Hyperparameters.of(settings))
        assert (float(metrics["critic_loss"]) > 0) == learns, written
        changed = jax.tree.map(lambda old, new: jnp.any(old != new), state.params, after.params)
        assert any(jax.tree.leaves(changed)) == learns, written


def test_several_observations_by_name_are_refused() -> None:
    probe = replace(probes.constant_reward(), observation_size={"state": 1, "privileged_state": 1})
    learner = Learner(probe, sac_settings())
    with pytest.raises(ValueError, match=r"one observation; there are \['privileged_state', 'state'\]"):
        learner.init(jnp.uint32(0))


@pytest.mark.parametrize(("bound", "seen"), [(None, 200.0), (10.0, 10.0)])
def test_normalised_observations_have_a_bound_where_one_is_set(bound: float | None, seen: float) -> None:
    settings = sac_settings(normalize_observations=True, normalize_observations_max_abs_value=bound)
    learner = Learner(probes.constant_reward(), settings)
    state = jax.jit(learner.init)(jnp.uint32(0))
    # Nothing has been observed yet: the mean is 0, the deviation 1.
    assert float(learner.normalize(state.normalizer)(jnp.array([200.0]))[0]) == pytest.approx(seen)
