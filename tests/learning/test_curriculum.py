"""Curricula in training: which progress fresh starts have, and that runs stay what they are."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import pytest

from core.algorithms.catalog import resolve
from core.algorithms.checkpoint import kind_of
from core.algorithms.dqn.spec import DQNSpec
from core.algorithms.events import TrainingProgress
from core.algorithms.ppo.learner import FORMAT as PPO_FORMAT
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.q_learning.spec import ActionList
from core.algorithms.run import Run
from core.algorithms.sac.policy import FORMAT as SAC_FORMAT
from core.algorithms.sac.spec import SACSpec
from core.environments import catalog
from core.environments.wrappers.curriculum import progress_at
from core.errors import Rejected
from tests import probes
from tests.learning.runs import STEPS_PER_UPDATE, checkpoints, small_run
from tests.learning.sac_runs import STEPS_PER_UPDATE as SAC_STEPS_PER_UPDATE
from tests.learning.sac_runs import sac_run

pytestmark = pytest.mark.extra

STILL = ActionList(kind="actions", actions=[[0.0] * 8])


def begun_at(checkpoint: bytes) -> set[float]:
    """The progress at which the environments' episodes began."""
    format_of = {"ppo": PPO_FORMAT, "sac": SAC_FORMAT}[kind_of(checkpoint)]
    state = format_of.read(checkpoint)[1]["episodes"]["state"]
    return set(np.asarray(state["info"]["begun_at"]).tolist())


@dataclass(frozen=True)
class Straight:
    """Six updates of a run whose curriculum takes four. seen: after each, the metric and the progress at
    which the episodes began; checkpoints: after each; compiled: how often, after the first update."""

    begin: Callable[..., Run[Any]]
    update: int
    given: dict[str, Any]
    seen: list[tuple[float, set[float]]]
    checkpoints: list[bytes]
    compiled: int


@pytest.fixture(scope="module", params=["ppo", pytest.param("sac", marks=pytest.mark.slow)])
def straight(request: pytest.FixtureRequest) -> Straight:
    # An episode ends with each update: PPO acts 16 times in one, SAC 4 times.
    begin, update, length = {
        "ppo": (small_run, STEPS_PER_UPDATE, 16),
        "sac": (sac_run, SAC_STEPS_PER_UPDATE, 4),
    }[request.param]
    given = {"num_timesteps": 6 * update, "episode_length": length, "num_evals": 0, "epoch_s": 0.0}
    run = begin(probes.growing(4 * update), **given)
    seen, kept = list[tuple[float, set[float]]](), list[bytes]()
    with compilations_heard() as compiled:
        for event in run.events():
            if isinstance(event, TrainingProgress):
                kept.append(run.checkpoint())
                seen.append((event.metrics["training/curriculum"], begun_at(kept[-1])))
            if len(seen) == 1:
                compiled.clear()
    return Straight(begin, update, given, seen, kept, len(compiled))


@contextmanager
def compilations_heard() -> Iterator[list[str]]:
    """A list that grows by one with each compilation."""
    heard = list[str]()

    def note(event: str, duration: float, **_: Any) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            heard.append(event)

    jax.monitoring.register_event_duration_secs_listener(note)
    try:
        yield heard
    finally:
        jax.monitoring.unregister_event_duration_listener(note)


def test_fresh_starts_have_the_progress_of_the_update_in_which_they_begin(straight: Straight) -> None:
    # The n-th update's are at n - 1 of the 4 updates.
    assert straight.seen == [(part, {part}) for part in (0.0, 0.25, 0.5, 0.75, 1.0, 1.0)]


def test_nothing_is_compiled_while_it_grows(straight: Straight) -> None:
    with compilations_heard() as heard:
        jax.jit(lambda x: x + straight.update)(np.float32(1))
    assert heard  # One would have been heard.
    assert straight.compiled == 0


def test_a_resumed_run_equals_an_uninterrupted_one(straight: Straight) -> None:
    half = straight.checkpoints[2]
    resumed = straight.begin(probes.growing(4 * straight.update), resume=half, **straight.given)
    assert checkpoints(resumed) == {6 * straight.update: straight.checkpoints[-1]}


def test_without_a_run_fresh_starts_are_those_of_the_end() -> None:
    # As evaluations, rollouts and videos have them.
    assert float(probes.growing(10**9).reset(jax.random.key(0)).info["begun_at"]) == 1.0


def test_the_progress_of_more_steps_than_an_int32_holds() -> None:
    # 10⁶ updates of 10⁵ steps are half of 2 · 10¹¹.
    progress = progress_at(probes.growing(2 * 10**11), np.int32(10**6), 10**5)
    assert float(progress) == pytest.approx(0.5)
    assert progress_at(probes.endless(), np.int32(1), 1) is None


@pytest.mark.parametrize(
    "spec",
    [PPOSpec(reset_pool_size=0), SACSpec(reset_pool_size=0), DQNSpec(action_set=STILL, reset_pool_size=0)],
    ids=["ppo", "sac", "dqn"],
)
def test_a_curriculum_without_a_pool_of_starts_is_refused(spec: Any) -> None:
    options = {"curriculum": {"start": {"gap_length": [0, 0.1]}, "over_steps": 10}}
    info, _ = catalog.resolve("corridor", options)
    with pytest.raises(Rejected, match="a curriculum would change nothing") as refused:
        resolve(spec, info, "cpu")
    assert [problem.pointer for problem in refused.value.problems] == [
        "/algorithm/reset_pool_size",
        "/environment/options/curriculum",
    ]
    resolve(spec, catalog.find("corridor"), "cpu")
