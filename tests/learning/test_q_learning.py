"""What tables learn, where the right answer is known."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.events import CheckpointReady, Evaluated, Event, Phase, TrainingProgress
from core.algorithms.q_learning.learner import Learner
from core.algorithms.q_learning.table import FORMAT, LearntTable, read_policy, table_from_checkpoint
from core.algorithms.trained_policy import policy_from_checkpoint
from core.environments.brittle_star.environment import towards_target
from core.environments.environment import Discretization, Environment
from core.environments.rollout import Roller
from core.errors import JobFailed
from gaitway import policy as client_policy
from tests.learning.q_probes import STAR, PlanarStar, q_run, q_settings, two_rooms
from tests.learning.runs import last_evaluation
from tests.overflowing import Overflowing

# Two rooms, γ = 0.5. In room 1 the end brings 2, in room 0 the way there 0.5 · 2 = 1; so staying is worth
# 0.4 + 0.5 · 1 = 0.9, and going back 0.5 · 1.
OPTIMUM = [[0.9, 1.0], [0.5, 2.0]]
KEY = jax.random.PRNGKey(0)


def learnt(environment: Environment, settings: Any, **options: Any) -> LearntTable:
    run = q_run(environment, settings, **options)
    list(run.events())
    return read_policy(run.policy())


@pytest.mark.parametrize(
    "options",
    [
        {},
        {
            "replay": {"buffer_size": 100, "batch_size": 16},
            "world_updates": "compound",
            "initial_table": "constant",
            "initial_value": 5.0,
        },
    ],
    ids=["mean", "replay-compound-optimistic"],
)
def test_a_known_optimum_is_found(options: dict[str, Any]) -> None:
    np.testing.assert_allclose(two_rooms().values(0.5), OPTIMUM)
    found = learnt(two_rooms(), q_settings(**{"num_episodes": 160, **options}))
    np.testing.assert_allclose(found.table, OPTIMUM, atol=0.01)
    assert found.visits.min() > 0


@pytest.mark.extra
def test_agents_side_by_side_learn_what_each_learns_alone_and_the_best_is_the_policy() -> None:
    # The second learns nothing: with a table of equal cells it stays in room 0 for 6 · 0.4 = 2.4; the first
    # learns that 1 and then 2 are worth more than 0.4 a time under γ = 0.5, and gets 2.
    agents = [{"seed": 3, "learning_rate": 0.25}, {"seed": 4, "learning_rate": 0.0}]
    common = {"num_episodes": 80, "initial_table": "constant"}
    run = q_run(two_rooms(), q_settings(agents=agents, **common))
    events = list(run.events())
    evaluated = last_evaluation(iter(events))
    assert evaluated["eval/agent_0/episode_reward"] == pytest.approx(2.0)
    assert evaluated["eval/agent_1/episode_reward"] == pytest.approx(2.4)
    assert evaluated["eval/episode_reward"] == pytest.approx(2.4)
    progress = [event.metrics for event in events if isinstance(event, TrainingProgress)][-1]
    assert progress["training/agent_0/q_max"] == pytest.approx(2.0, abs=0.01)
    assert progress["training/agent_1/q_max"] == 0.0
    tables = FORMAT.read(run.checkpoint())[1]["table"]
    np.testing.assert_array_equal(table_from_checkpoint(run.checkpoint()).table, tables[1])
    alone = learnt(two_rooms(), q_settings(learning_rate=0.25, **common), seed=3)
    np.testing.assert_array_equal(tables[0], alone.table)


@pytest.mark.extra
def test_a_policy_with_noise_chooses_at_random_as_often_as_its_own_agent_did() -> None:
    agents = [{"epsilon_end": 0.25}, {"epsilon_end": 0.5}, {}]
    settings = q_settings(
        num_episodes=1, agents=agents, policy_agent="first", epsilon={"start": 1.0, "end": 0.125}
    )
    run = q_run(two_rooms(), settings)
    list(run.events())
    assert FORMAT.read(run.checkpoint())[0]["epsilon"] == [0.25, 0.5, 0.125]
    for learnt_table in (table_from_checkpoint(run.checkpoint()), read_policy(run.policy())):
        assert learnt_table.facts["epsilon"] == 0.25


@pytest.mark.extra
def test_a_star_learns_to_be_led_by_the_arm_towards_its_target() -> None:
    run = q_run(PlanarStar(), q_settings(STAR, num_episodes=300, discounting=0.5))
    evaluated = last_evaluation(run.events())
    np.testing.assert_array_equal(read_policy(run.policy()).table.argmax(axis=1), np.arange(5))
    # From 1 m to within 0.2 m, a decision is 0.25 m: of 20 steps, all of them arrive in at most 30.
    assert evaluated["eval/episode_reward"] >= 0.8
    assert evaluated["eval/avg_episode_length"] <= 30


def test_an_identity_table_steers_without_any_learning() -> None:
    settings = q_settings(STAR, learning_rate=0.0, initial_table="identity", num_episodes=10)
    run = q_run(PlanarStar(), settings)
    assert last_evaluation(run.events())["eval/episode_reward"] >= 0.8
    np.testing.assert_array_equal(read_policy(run.policy()).table, np.eye(5))


@pytest.mark.extra
def test_arms_that_read_and_choose_for_themselves_bring_the_star_to_its_target() -> None:
    options = {
        "state_discretizer": {"kind": "arm_role"},
        "action_set": {"kind": "arm_actions", "actions": [[0.0], [1.0]]},
        "num_episodes": 300,
        "learning_rate": 0.05,
        "discounting": 0.5,
        "epsilon": {"start": 1.0, "end": 0.5},
    }
    run = q_run(PlanarStar(speed=0.5), q_settings(STAR, **options))
    assert last_evaluation(run.events())["eval/episode_reward"] >= 0.75
    # One table for all arms: the one towards the target pulls, those that look away do not.
    np.testing.assert_array_equal(read_policy(run.policy()).table.argmax(axis=1), [1, 1, 0, 0, 1])


@pytest.mark.extra
def test_a_learnt_table_acts_step_by_step_and_holds_each_action_for_a_decision(tmp_path: Path) -> None:
    star, settings = (
        PlanarStar(),
        q_settings(STAR, learning_rate=0.0, initial_table="identity", num_episodes=10),
    )
    run = q_run(star, settings)
    list(run.events())
    policy = policy_from_checkpoint(run.checkpoint())
    env, act = policy.acting(star)
    [episode] = Roller(env, act).episodes(policy.parameters, KEY, num_steps=100, num_episodes=1)
    assert episode.terminated
    assert episode.action.shape[1] == 5
    np.testing.assert_array_equal(episode.action.sum(axis=1), 1.0)  # one arm at a time
    changes = np.flatnonzero((episode.action[1:] != episode.action[:-1]).any(axis=1)) + 1
    assert (changes % 5 == 0).all()
    # Without an environment, the client says which arm is to lead.
    (tmp_path / "policy").write_bytes(run.policy())
    choose = client_policy.load(tmp_path / "policy", "q_learning", is_checkpoint=False)
    seen = {"xy_direction_to_target": jnp.array([-1.0, -0.1]), "disk_rotation": jnp.zeros(3)}
    assert choose(seen).tolist() == [3]
    with pytest.raises(JobFailed, match=r"The table is \[5, 5\], and this environment needs \[7, 5\]"):
        policy.acting(SevenSectors())


class SevenSectors(PlanarStar):
    """Five actuators, and seven directions of the target."""

    @property
    def discretization(self) -> Discretization:
        return towards_target(7)

    @property
    def action_size(self) -> int:
        return 5


def test_events_come_in_their_order_and_nothing_compiles_after_the_start() -> None:
    compilations = list[str]()

    def note(event: str, duration: float, **_: object) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            compilations.append(event)

    jax.monitoring.register_event_duration_secs_listener(note)
    # Five rounds of 48 steps; evaluations after 3 and 5, checkpoints at 100 (round 3) and 200 (round 5).
    run = q_run(two_rooms(), q_settings(num_evals=2), checkpoint_every_steps=100, epoch_s=1000.0)
    events, compiled = list[Event](), 0
    for event in run.events():
        if isinstance(event, Phase) and event.name == "compile":
            compiled = len(compilations)
        if isinstance(event, CheckpointReady):
            run.checkpoint()
            run.policy()
        events.append(event)
    assert len(compilations) == compiled
    told = [(type(event).__name__, event.step) for event in events if not isinstance(event, Phase)]
    assert told == [
        ("TrainingProgress", 48),
        ("TrainingProgress", 144), ("Evaluating", 144), ("Evaluated", 144), ("CheckpointReady", 144),
        ("TrainingProgress", 240), ("Evaluating", 240), ("Evaluated", 240), ("CheckpointReady", 240),
    ]  # fmt: skip
    last = [event for event in events if isinstance(event, TrainingProgress)][-1]
    assert (last.total, run.total) == (240, 240)
    assert last.metrics["training/episodes"] == last.metrics["training/num_episodes"] == 40
    names = (
        "episode_reward",
        "episode_length",
        "epsilon",
        "td_error",
        "q_max",
        "visits",
        "cells_visited",
        "sps",
    )
    assert {f"training/{name}" for name in names} <= last.metrics.keys()
    evaluation = [event.metrics for event in events if isinstance(event, Evaluated)][-1]
    assert {"eval/episode_reward", "eval/avg_episode_length", "eval/walltime"} <= evaluation.keys()


@pytest.mark.extra
def test_contacts_that_the_engine_lost_are_told_as_the_share_of_decisions_that_lost_some() -> None:
    # All stay in room 0. The second of an episode's 8 steps is in the first of its 4 decisions.
    settings = q_settings(
        decisions_per_episode=4,
        decision_steps=2,
        num_episodes=8,
        num_evals=0,
        initial_table="constant",
        epsilon={"start": 0.0, "end": 0.0},
    )
    events = q_run(Overflowing(two_rooms()), settings).events()
    told = [
        event.metrics["training/physics_overflow"] for event in events if isinstance(event, TrainingProgress)
    ]
    assert told == [0.25]


def test_a_reward_that_is_no_number_ends_the_run_with_the_last_good_table() -> None:
    # With epsilon 1, one of 8 environments takes the end of room 1 in the first round.
    run = q_run(two_rooms(breaks=True), q_settings())
    with pytest.raises(JobFailed, match="reward became non-finite at environment step") as failure:
        list(run.events())
    assert failure.value.reason == "diverged"
    assert failure.value.facts["quantity"] == "reward"
    assert run.step == 0
    assert np.isfinite(FORMAT.read(run.checkpoint())[1]["table"]).all()


def test_a_checkpoint_of_another_table_is_refused_with_both_shapes() -> None:
    run = q_run(two_rooms(), q_settings())
    next(event for event in run.events() if isinstance(event, TrainingProgress))
    finer = {"kind": "observation_grid", "components": [{"index": 0, "range": [-0.5, 1.5], "cells": 4}]}
    with pytest.raises(JobFailed, match=r"state_discretizer is .*'cells': 2.* and .*'cells': 4") as failure:
        q_run(two_rooms(), q_settings(state_discretizer=finer), resume=run.checkpoint())
    assert failure.value.reason == "bad_checkpoint"


@pytest.mark.extra
def test_l1_evaluations_are_drawn_apart_from_rounds() -> None:
    """As the audit's keys.py compares them: the evaluations' key was the first round's."""
    environment: Any = SimpleNamespace(table=SimpleNamespace(shape=(3, 2)))
    state = Learner(environment, q_settings()).init(KEY[None])
    rounds, evaluations = state.key[0], state.eval_key
    for number in range(4):
        drawn = jax.random.split(rounds, 3)
        of_evaluation = jax.random.split(jax.random.fold_in(evaluations, number))
        keys = np.asarray([evaluations, *of_evaluation, rounds, *drawn])
        assert len(np.unique(keys, axis=0)) == len(keys)
        rounds = drawn[0]
