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


def test_forward_velocity_is_the_way_along_the_direction_by_the_time() -> None:
    # (0.03, 0.04, 0) m in 0.1 s is (0.3, 0.4, 0) m/s; along (0.6, 0.8, 0): 0.18 + 0.32.
    before, after = jnp.array([1.0, 2.0, 3.0]), jnp.array([1.03, 2.04, 3.0])
    speed = rewards.forward_velocity(before, after, jnp.array([0.6, 0.8, 0.0]), 0.1)
    assert value(speed) == pytest.approx(0.5, rel=1e-4)


@pytest.mark.parametrize(
    ("healthy", "terminates", "earns", "ends"),
    [(1.0, True, 1, 0), (0.0, True, 1, 1), (1.0, False, 1, 0), (0.0, False, 0, 0)],
)
def test_being_unhealthy_ends_the_episode_or_costs_the_reward(
    healthy: float, terminates: bool, earns: int, ends: int
) -> None:
    earned, ended = rewards.survival(jnp.float32(healthy), terminates=terminates)
    assert (value(earned), value(ended)) == (earns, ends)


def test_velocity_tracking_is_one_at_the_target_and_1_over_e_a_tolerance_away() -> None:
    wanted = jnp.array([1.0, 0.0])
    assert value(rewards.velocity_tracking(wanted, wanted, 0.5)) == 1.0
    # (0.3, 0.4) away is 0.5 away.
    assert value(rewards.velocity_tracking(jnp.array([1.3, 0.4]), wanted, 0.5)) == pytest.approx(
        0.367879, rel=1e-5
    )


def test_upright_is_the_cosine_of_the_tilt() -> None:
    # A turn by 60° about x takes z to (0, -sin 60°, cos 60°), and y to (0, cos 60°, sin 60°).
    turned = jnp.array([[1, 0, 0], [0, 0.5, -0.8660254], [0, 0.8660254, 0.5]])
    assert value(rewards.upright(turned, jnp.array([0.0, 0.0, 1.0]))) == pytest.approx(0.5)
    assert value(rewards.upright(turned, jnp.array([0.0, 1.0, 0.0]))) == pytest.approx(0.8660254)


@pytest.mark.parametrize(("height", "worth"), [(0.19, 0), (0.2, 1), (0.7, 1), (1.0, 1), (1.01, 0)])
def test_a_height_range_holds_its_ends(height: float, worth: int) -> None:
    assert value(rewards.height_range(jnp.float32(height), (0.2, 1.0))) == worth


def test_costs_of_actions_are_sums_of_squares() -> None:
    action, before = jnp.array([0.5, -1.0]), jnp.array([0.0, 1.0])
    assert value(rewards.control_cost(action)) == 1.25
    assert value(rewards.action_rate(action, before)) == 4.25  # 0.5² + 2²


def test_energy_counts_what_is_given_and_what_is_taken() -> None:
    # |2 × 3| + |-1 × 4| W
    assert value(rewards.energy(jnp.array([2.0, -1.0]), jnp.array([3.0, 4.0]))) == 10.0


def test_distance_is_euclids() -> None:
    assert value(rewards.distance(jnp.array([1.0, 2.0, 2.0]), jnp.zeros(3))) == 3.0


def test_joint_limits_cost_what_lies_beyond_the_free_share() -> None:
    # Ranges [-1, 1] and [0, 2]: of 0.8 of them, [-0.8, 0.8] and [0.2, 1.8] are free.
    low, high = jnp.array([-1.0, 0.0]), jnp.array([1.0, 2.0])
    assert value(rewards.joint_limits(jnp.array([-0.9, 1.0]), low, high, 0.8)) == pytest.approx(0.1)
    assert value(rewards.joint_limits(jnp.array([0.5, 0.1]), low, high, 0.8)) == pytest.approx(0.1)


def test_contact_counts_geoms_and_not_contacts() -> None:
    assert value(rewards.contact(jnp.array([0.0, 4.0, 1.0]))) == 2.0
