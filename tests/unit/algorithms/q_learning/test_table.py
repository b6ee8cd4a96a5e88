"""The table's arithmetic, against numbers worked out by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.q_learning import replay as replays
from core.algorithms.q_learning.spec import QLearningSpec
from core.algorithms.q_learning.table import (
    Exploration,
    Transitions,
    decay_length,
    epsilon_greedy,
    greedy,
    learn,
    td_errors,
)

pytestmark = pytest.mark.usefixtures("without_rank_promotion")
KEY = jax.random.PRNGKey(0)


def steps(*rows: tuple[int, int, float, int, float, float]) -> Transitions:
    """Each: row, choice, reward, next row, ended, weight."""
    row, choice, reward, following, ended, weight = np.array(rows).T
    whole = [np.int32(values) for values in (row, choice, following)]
    numbers = [np.float32(values) for values in (reward, ended, weight)]
    return Transitions(*map(jnp.asarray, (whole[0], whole[1], numbers[0], whole[2], numbers[1], numbers[2])))


def test_an_error_looks_at_the_best_that_may_follow_but_not_beyond_an_end() -> None:
    table = jnp.array([[1.0, 2.0], [10.0, 20.0]])
    # 3 + 0.5 · 20 - 2 = 11; after an end, 3 - 2 = 1.
    given = steps((0, 1, 3.0, 1, 0, 1), (0, 1, 3.0, 1, 1, 1))
    np.testing.assert_allclose(td_errors(table, given, jnp.float32(0.5)), [11.0, 1.0])


@pytest.mark.parametrize(
    ("compound", "expected"),
    [
        # Two transitions of one cell with errors 1 and 3, mean 2, at α = 0.1: 0.1 · 2; or 1 - 0.9² = 0.19 of
        # it. The third has a cell to itself, 0.1 · 5; of the fourth nothing is learnt.
        (False, [[0.2, 0.5], [0.0, 0.0]]),
        (True, [[0.38, 0.5], [0.0, 0.0]]),
    ],
)
def test_environments_that_visit_a_cell_at_once_share_what_it_learns(
    compound: bool, expected: list[list[float]]
) -> None:
    given = steps((0, 0, 1, 0, 1, 1), (0, 0, 3, 0, 1, 1), (0, 1, 5, 0, 1, 1), (1, 0, 7, 0, 1, 0))
    table = jnp.zeros((2, 2))
    errors = td_errors(table, given, jnp.float32(0.9))
    learnt, visits = learn(table, given, errors, jnp.float32(0.1), compound=compound)
    np.testing.assert_allclose(learnt, expected, rtol=1e-5)
    np.testing.assert_array_equal(visits, [[2, 1], [0, 0]])


def test_eight_equal_targets_move_a_cell_as_far_as_one_step_or_as_eight() -> None:
    # What parallel environments cost: after 3 decisions, the mean has gone 1 - 0.9³ = 0.271 of the way, and
    # `compound` 1 - 0.9²⁴ = 0.920, just as 24 steps of one environment.
    given = steps(*[(0, 0, 1.0, 0, 1.0, 1.0)] * 8)

    def after(compound: bool) -> float:
        table = jnp.zeros((1, 1))
        for _ in range(3):
            errors = td_errors(table, given, jnp.float32(0.9))
            table, _ = learn(table, given, errors, jnp.float32(0.1), compound=compound)
        return float(table[0, 0])

    assert after(compound=False) == pytest.approx(1 - 0.9**3)
    assert after(compound=True) == pytest.approx(1 - 0.9**24)


def test_of_equal_columns_the_first_is_the_best_and_epsilon_decides_how_often_any_is_taken() -> None:
    table = jnp.array([[0.0, 1.0, 1.0, 0.0]])
    rows = jnp.zeros(10_000, jnp.int32)
    assert int(greedy(table, rows[0])) == 1
    np.testing.assert_array_equal(epsilon_greedy(table, rows, jnp.float32(0.0), KEY), 1)
    # A quarter of the random ones hit the best, too: 1 - 0.4 · 3/4 = 0.7.
    chosen = epsilon_greedy(table, rows, jnp.float32(0.4), KEY)
    assert float(jnp.mean(chosen == 1)) == pytest.approx(0.7, abs=0.02)
    assert float(jnp.mean(chosen == 3)) == pytest.approx(0.1, abs=0.02)


def epsilon(rounds: int, decision: int, **schedule: object) -> float:
    """In 4 environments with 5 decisions an episode; 8 episodes in the run."""
    settings = QLearningSpec.model_validate(
        {"num_envs": 4, "decisions_per_episode": 5, "num_episodes": 8, "epsilon": schedule}
    )
    exploration = Exploration.of(settings)
    start, end, length = settings.epsilon.start, settings.epsilon.end, decay_length(settings)
    given = [jnp.float32(value) for value in (start, end, length)]
    return float(exploration.epsilon(*given, jnp.int32(rounds), jnp.int32(decision)))


def test_epsilon_falls_over_decisions_or_by_whole_episodes() -> None:
    # A round has 20 decisions. By default all 40 of the run count: half-way is the beginning of round 1.
    ends = {"start": 0.8, "end": 0.2}
    assert epsilon(0, 0, **ends) == pytest.approx(0.8)
    assert epsilon(1, 0, **ends) == pytest.approx(0.5)
    # Decision 2 of round 0 comes after 8 decisions: 0.8 - 0.6 · 8 / 16.
    assert epsilon(0, 2, decay_decisions=16, **ends) == pytest.approx(0.5)
    assert epsilon(1, 0, decay_decisions=16, **ends) == pytest.approx(0.2)
    # After 4 of 8 episodes, throughout the next.
    assert epsilon(1, 4, decay_episodes=8, **ends) == pytest.approx(0.5)
    assert epsilon(1, 0, shape="exponential", **ends) == pytest.approx(0.4)  # the geometric mean


def test_a_buffer_keeps_the_newest_and_draws_only_what_it_holds() -> None:
    def of(*rewards: float) -> Transitions:
        return steps(*[(0, 0, reward, 0, 0, 1) for reward in rewards])

    empty = replays.empty(5)
    np.testing.assert_array_equal(replays.draw(empty, KEY, 3).weight, 0)
    two = replays.add(empty, of(1, 2))
    assert set(np.asarray(replays.draw(two, KEY, 100).reward).tolist()) == {1.0, 2.0}
    six = replays.add(replays.add(two, of(3, 4)), of(5, 6))
    assert sorted(np.asarray(six.steps.reward).tolist()) == [2, 3, 4, 5, 6]
    assert (int(six.count), int(six.head)) == (5, 1)
    assert sorted(np.asarray(replays.add(six, of(*range(10, 20))).steps.reward)) == [15, 16, 17, 18, 19]
