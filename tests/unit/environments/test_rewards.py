"""Each kind of term: what it is worth where one can work it out by hand."""

import jax.numpy as jnp
import pytest

from core.environments import rewards

pytestmark = pytest.mark.usefixtures("without_rank_promotion")


def value(result: object) -> float:
    return float(result)  # type: ignore[arg-type]


def test_a_reward_is_its_terms_added_from_first_to_last() -> None:
    # In float32, 1e8 + 1 is 1e8.
    large, one = jnp.float32(1e8), jnp.float32(1)
    assert value(rewards.total({"gain": large, "alive": one, "cost": -large})) == 0
    assert value(rewards.total({"gain": large, "cost": -large, "alive": one})) == 1


@pytest.mark.parametrize(
    ("healthy", "terminates", "earns", "ends"),
    [(1.0, True, 1, 0), (0.0, True, 1, 1), (1.0, False, 1, 0), (0.0, False, 0, 0)],
)
def test_being_unhealthy_ends_the_episode_or_costs_the_reward(
    healthy: float, terminates: bool, earns: int, ends: int
) -> None:
    earned, ended = rewards.survival(jnp.float32(healthy), terminates=terminates)
    assert (value(earned), value(ended)) == (earns, ends)


def test_upright_is_the_cosine_of_the_tilt() -> None:
    # A turn by 60° about x takes z to (0, -sin 60°, cos 60°), and y to (0, cos 60°, sin 60°).
    turned = jnp.array([[1, 0, 0], [0, 0.5, -0.8660254], [0, 0.8660254, 0.5]])
    assert value(rewards.upright(turned, jnp.array([0.0, 0.0, 1.0]))) == pytest.approx(0.5)
    assert value(rewards.upright(turned, jnp.array([0.0, 1.0, 0.0]))) == pytest.approx(0.8660254)


@pytest.mark.parametrize(("height", "worth"), [(0.19, 0), (0.2, 1), (0.7, 1), (1.0, 1), (1.01, 0)])
def test_a_height_range_holds_its_ends(height: float, worth: int) -> None:
    assert value(rewards.height_range(jnp.float32(height), (0.2, 1.0))) == worth


def test_costs_of_actions_are_sums_of_squares() -> None:
    assert value(rewards.control_cost(jnp.array([0.5, -1.0]))) == 1.25


def test_distance_is_euclids() -> None:
    assert value(rewards.distance(jnp.array([1.0, 2.0, 2.0]), jnp.zeros(3))) == 3.0
