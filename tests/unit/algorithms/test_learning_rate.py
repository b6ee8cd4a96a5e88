from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from brax.training.agents.ppo.optimizer import adaptive_kl_learning_rate

from core.algorithms.ppo.loss import adapt_to_kl

BOUNDS = (jnp.float32(1e-4), jnp.float32(1e-2))


def adapted(learning_rate: float, kl_mean: float) -> float:
    return float(adapt_to_kl(jnp.float32(learning_rate), jnp.float32(kl_mean), jnp.float32(0.01), BOUNDS))


@pytest.mark.parametrize(
    ("learning_rate", "kl_mean", "expected"),
    [
        (3e-3, 0.021, 2e-3),  # more than twice 0.01: divided by 1.5
        (3e-3, 0.019, 3e-3),  # between half and twice: left alone
        (3e-3, 0.006, 3e-3),
        (3e-3, 0.004, 4.5e-3),  # less than half: times 1.5
        (3e-3, 0.0, 3e-3),  # nothing has moved yet: nothing is known
        (1.2e-4, 0.1, 1e-4),  # 0.8e-4 would be below the bound
        (9e-3, 0.001, 1e-2),  # 13.5e-3 would be above it
    ],
)
def test_it_falls_where_the_policy_moves_too_far_and_rises_where_it_hardly_moves(
    learning_rate: float, kl_mean: float, expected: float
) -> None:
    assert adapted(learning_rate, kl_mean) == pytest.approx(expected, rel=1e-6)


def test_it_is_brax_s() -> None:
    for kl_mean in np.geomspace(1e-4, 1, 20):
        state = SimpleNamespace(hyperparams={"learning_rate": jnp.float32(1e-3)})
        _, brax = adaptive_kl_learning_rate(state, jnp.float32(kl_mean), 0.01, 1e-4, 1e-2)
        assert adapted(1e-3, kl_mean) == float(brax)
