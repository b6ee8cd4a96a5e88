"""What both algorithms learn on the real star; a small one, so that it takes minutes and not hours."""

from typing import Any

import pytest

from core.algorithms.catalog import resolve
from core.algorithms.events import CheckpointReady, Evaluated
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.q_learning.spec import QLearningSpec
from core.algorithms.run import Run, make_run
from core.environments import catalog
from core.environments.environment import Environment
from core.environments.info import EnvironmentInfo
from core.physics.choose import engine_builder

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


def star(**options: Any) -> tuple[Environment, EnvironmentInfo]:
    """The environment and its row, under these options."""
    row = catalog.find("brittle_star")
    given = catalog.parse_options(row, options)
    return catalog.make(row, given, engine_builder("native")), row.under(given)


def test_a_resumed_table_equals_an_uninterrupted_one_on_the_real_star() -> None:
    environment, row = star(control="cpg", num_arms=3, num_segments_per_arm=1, simulation_time=4.0)
    wanted = QLearningSpec(num_episodes=16, num_envs=4, num_eval_envs=2, replay=None)
    settings = resolve(wanted, row, "cpu")

    def run(resume: bytes | None = None) -> Run[Any]:
        return make_run(
            environment, settings, seed=3, checkpoint_every_steps=settings.env_steps_per_update, resume=resume
        )

    undisturbed = run()
    list(undisturbed.events())
    stopped = run()
    next(event for event in stopped.events() if isinstance(event, CheckpointReady))
    assert 0 < stopped.step < stopped.total
    resumed = run(stopped.checkpoint())
    list(resumed.events())
    assert resumed.checkpoint() == undisturbed.checkpoint()
    assert resumed.policy() == undisturbed.policy()


@pytest.mark.parametrize(
    ("control", "num_segments", "settings"),
    [
        ("joints", 1, {"num_timesteps": 60_000, "num_envs": 64, "batch_size": 64}),
        ("cpg", 2, {"num_timesteps": 128_000}),
    ],
)
def test_ppo_learns_to_go_to_a_target(control: str, num_segments: int, settings: dict[str, Any]) -> None:
    # The target is always in +x, and an episode is of 4 s: what is to be learnt is a gait. The first
    # evaluation is after a third of the run. Seen: 0.00 and then 0.08 m by joints, 0.05 and 0.35 m by the
    # generator.
    environment, row = star(
        control=control,
        num_segments_per_arm=num_segments,
        target_position=[3.0, 0.0],
        simulation_time=4.0,
    )
    resolved = resolve(PPOSpec(**settings, num_evals=3, num_eval_envs=8), row, "cpu")
    run = make_run(environment, resolved, seed=0, checkpoint_every_steps=None)
    returns = [event.metrics["eval/episode_reward"] for event in run.events() if isinstance(event, Evaluated)]
    assert returns[-1] > returns[0] + 0.04
