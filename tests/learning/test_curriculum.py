"""Curricula in training: which progress fresh starts have, and that runs stay what they are."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest

from core.algorithms.catalog import resolve
from core.algorithms.events import Progress
from core.algorithms.checkpoint import kind_of
from core.algorithms.ppo.checkpoint import FORMAT as PPO_FORMAT
from core.algorithms.ppo.spec import PPOSpec
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

OF_SAC = pytest.param(sac_run, SAC_STEPS_PER_UPDATE, marks=pytest.mark.slow, id="sac")
BOTH = pytest.mark.parametrize(
    ("begin", "update"), [pytest.param(small_run, STEPS_PER_UPDATE, id="ppo"), OF_SAC]
)


def begun_at(checkpoint: bytes) -> set[float]:
    """The progress at which the environments' episodes began."""
    format_of = {"ppo": PPO_FORMAT, "sac": SAC_FORMAT}[kind_of(checkpoint)]
    state = format_of.read(checkpoint)[1]["episodes"]["state"]
    return set(np.asarray(state["info"]["begun_at"]).tolist())


@BOTH
def test_fresh_starts_follow_the_steps_without_a_compilation_and_after_a_resumption(
    begin: Callable[..., Run[Any]], update: int
) -> None:
    # An episode ends with each update (PPO acts 16 times in one, SAC 4 times), and the next ones begin at the
    # progress that the update had: n - 1 of the 4 updates that the curriculum takes.
    length = 16 if begin is small_run else 4
    given = {"num_timesteps": 6 * update, "episode_length": length, "num_evals": 0, "epoch_s": 0.0}
    run = begin(probes.growing(4 * update), **given)
    seen, compiled = list[tuple[float, set[float]]](), list[str]()
    kept = list[bytes]()

    def note(event: str, duration: float, **_: Any) -> None:
        if event == "/jax/core/compile/backend_compile_duration" and seen:
            compiled.append(event)

    jax.monitoring.register_event_duration_secs_listener(note)
    try:
        for event in run.events():
            if isinstance(event, Progress):
                kept.append(run.checkpoint())
                seen.append((event.metrics["training/curriculum"], begun_at(kept[-1])))
        assert not compiled
        jax.jit(lambda x: x + len(seen))(np.float32(1))  # The listener would have heard one.
        assert compiled
    finally:
        jax.monitoring.unregister_event_duration_listener(note)
    assert seen == [(part, {part}) for part in (0.0, 0.25, 0.5, 0.75, 1.0, 1.0)]
    resumed = begin(probes.growing(4 * update), resume=kept[2], **given)
    assert checkpoints(resumed) == {6 * update: kept[-1]}


def test_without_a_run_fresh_starts_are_those_of_the_end() -> None:
    # As evaluations, rollouts and videos have them.
    assert float(probes.growing(10**9).reset(jax.random.key(0)).info["begun_at"]) == 1.0


def test_the_progress_of_more_steps_than_an_int32_holds() -> None:
    # 10⁶ updates of 10⁵ steps are half of 2 · 10¹¹.
    progress = progress_at(probes.growing(2 * 10**11), np.int32(10**6), 10**5)
    assert float(progress) == pytest.approx(0.5)
    assert progress_at(probes.endless(), np.int32(1), 1) is None


@pytest.mark.parametrize("spec", [PPOSpec(reset_pool_size=0), SACSpec(reset_pool_size=0)], ids=["ppo", "sac"])
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
