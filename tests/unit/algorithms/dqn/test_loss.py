"""The network's loss, against numbers worked out by hand."""

import jax
import jax.numpy as jnp
import pytest

from core.algorithms.dqn.network import QNetwork, td_loss
from core.algorithms.off_policy.replay import Sample

# Without hidden layers, values are kernel and bias alone: of one number seen, two parts' three choices each.
NETWORK = QNetwork(2, 3, (), "relu")


def params(kernel: list[float], bias: list[float]) -> dict[str, dict[str, dict[str, jax.Array]]]:
    return {"params": {"hidden_0": {"kernel": jnp.array([kernel]), "bias": jnp.array(bias)}}}


def batch(*, discount: float, weight: float = 1.0, reward: float = 1.0) -> Sample:
    """From 0 to 1; part 0 has chosen 2, and part 1 has chosen 0."""
    one = [jnp.array([value]) for value in (reward, discount, weight)]
    return Sample(jnp.zeros((1, 1)), jnp.array([[2.0, 0.0]]), one[0], one[1], jnp.ones((1, 1)), one[2])


# At 0 the values are 0.5 for part 0's choice 2 and 1 for part 1's choice 0.
LEARNT = params([0.0, 3.0, 0.0, 2.0, 0.0, 0.0], [0.0, 0.0, 0.5, 1.0, 0.0, 0.0])
# At 1 LEARNT takes choice 1 of part 0, and choice 0 of part 1; FOLLOWS says 4 and 6 of these.
FOLLOWS = params([0.0] * 6, [9.0, 4.0, 9.0, 6.0, 9.0, 9.0])


def test_the_learnt_network_chooses_and_the_one_that_follows_says_what_it_is_worth() -> None:
    # Errors 1 + 0.25 · 4 - 0.5 = 1.5 and 1 + 0.25 · 6 - 1 = 1.5; Huber's loss of 1.5 is 1.5 - 0.5.
    loss, seen = td_loss(LEARNT, FOLLOWS, NETWORK, batch(discount=0.25))
    assert float(loss) == pytest.approx(1.0)
    assert float(seen["td_error"]) == pytest.approx(1.5)
    assert float(seen["q_value"]) == pytest.approx(0.75)


def test_nothing_follows_an_end_and_nothing_is_learnt_of_a_cut() -> None:
    # Errors 1 - 0.5 and 1 - 1: half of 0.5², and 0.
    assert float(td_loss(LEARNT, FOLLOWS, NETWORK, batch(discount=0.0))[0]) == pytest.approx(0.0625)
    assert float(td_loss(LEARNT, FOLLOWS, NETWORK, batch(discount=0.25, weight=0.0))[0]) == 0.0


def test_only_what_was_chosen_is_moved_and_by_no_more_than_an_error_of_one() -> None:
    gradient, _ = jax.grad(td_loss, has_aux=True)(LEARNT, FOLLOWS, NETWORK, batch(discount=0.25, reward=50.0))
    moved = gradient["params"]["hidden_0"]["bias"]
    # The mean over two parts of gradients of -1.
    assert moved.tolist() == [0.0, 0.0, -0.5, -0.5, 0.0, 0.0]
