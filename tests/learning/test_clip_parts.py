"""Where episodes begin in clips while PPO trains: before what fails, also in a run that is resumed."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.checkpoint import Format
from core.algorithms.events import CheckpointReady
from core.algorithms.ppo.learner import FORMAT as PPO
from core.algorithms.run import Run, make_run
from core.algorithms.sac.learner import FORMAT as SAC
from core.algorithms.seeds import SeedsRun, make_seeds_run
from core.clips.clip import Clip
from core.environments.reference.frames import Frames
from core.environments.reference.parts import Parts
from core.environments.terms.reference import Adaptive, Frame, Uniform
from core.errors import JobFailed
from tests.extra import extra
from tests.learning.runs import STEPS_PER_UPDATE, checkpoints, small_settings
from tests.learning.sac_runs import STEPS_PER_UPDATE as SAC_STEPS_PER_UPDATE
from tests.learning.sac_runs import sac_settings
from tests.unit.environments.mjcf.test_imitation import flight, follower

NUM_UPDATES = 6


def parts(*lengths: int, weights: tuple[float, ...] = (), sampling: Any = None) -> Parts:
    """Of clips of this many frames, 0.1 s apart."""
    frames = Frames(
        Frame(*[np.zeros((sum(lengths), 1))] * 6),
        np.zeros((sum(lengths), 0)),
        [f"clip {number}" for number in range(len(lengths))],
        np.array(weights or [1.0] * len(lengths)),
        np.concatenate([[0], np.cumsum(lengths)[:-1]]),
        np.array(lengths),
    )
    return Parts.of(sampling or Adaptive(uniform=0.2, decay=0.5, memory=0.5), frames, 0.1)


def test_clips_are_cut_into_parts_of_about_a_second() -> None:
    # 30 steps are three parts; 4 steps are one. A clip's last frame begins no episode.
    cut = parts(31, 5)
    assert cut.starts.tolist() == [0, 10, 20, 31]
    assert cut.lengths.tolist() == [10, 10, 10, 4]
    assert cut.of_frame.tolist() == [0] * 10 + [1] * 10 + [2] * 11 + [3] * 5
    assert cut.is_last.tolist() == [0, 0, 1, 1]


def test_starts_are_likelier_before_what_fails() -> None:
    cut = parts(31, 11)
    # Of 100 steps in each part, four failed in the third: its level is 0.04, and that of those before it is a
    # half and a quarter of this. A fifth is uniform. The other clip's part has that alone.
    record = cut.counted(
        jnp.zeros((2, 4)), jnp.repeat(jnp.arange(4), 100), jnp.zeros(400).at[200:204].set(1.0)
    )
    assert record.tolist() == [[0, 0, 4, 0], [100] * 4]
    adapted = np.array([0.25, 0.5, 1.0, 0.0]) / 1.75
    np.testing.assert_allclose(cut.probabilities(record), 0.2 / 4 + 0.8 * adapted, rtol=1e-5)
    # Half of what was counted is kept.
    again = cut.counted(record, jnp.zeros(0, jnp.int32), jnp.zeros(0))
    assert again.tolist() == [[0, 0, 2, 0], [50] * 4]


def test_starts_are_uniform_where_nothing_failed_or_is_asked() -> None:
    cut = parts(11, 31, weights=(3.0, 1.0))
    for record in (None, jnp.zeros((2, 4)), jnp.array([[0.0] * 4, [50.0] * 4])):
        np.testing.assert_allclose(cut.probabilities(record), [0.5, *[0.5 / 3] * 3], rtol=1e-6)
    assert parts(31, sampling=Uniform()).number == 1


def test_draws_are_rows_of_their_parts() -> None:
    cut = parts(31, 11)
    record = jnp.array([[0.0, 0.0, 0.0, 9.0], [10.0] * 4])
    rows = np.asarray(jax.vmap(lambda key: cut.draw(key, record))(jax.random.split(jax.random.key(0), 500)))
    assert set(rows) <= set(range(30)) | set(range(31, 41))
    assert np.mean(rows >= 31) == pytest.approx(0.85, abs=0.05)  # 0.8 + 0.2 / 4.


BOTH = [flight(), flight(-1.0, name="back")]
RUN: dict[str, Any] = {"num_evals": 0, "reset_pool_size": 20}
PPO_SETTINGS = small_settings(num_timesteps=NUM_UPDATES * STEPS_PER_UPDATE, **RUN)
SAC_SETTINGS = sac_settings(
    num_timesteps=NUM_UPDATES * SAC_STEPS_PER_UPDATE,
    min_replay_size=128,
    max_replay_size=512,
    n_step=3,
    **RUN,
)


def run(
    folder: Path,
    settings: Any = PPO_SETTINGS,
    seeds: tuple[int, ...] = (),
    clips: Sequence[Clip] = BOTH,
    **resuming: Any,
) -> Run[Any] | SeedsRun[Any]:
    # It begins where the clip is, and is pulled away from it, slowly: nothing holds the elbow.
    environment = follower(
        folder,
        clips,
        reference={"sampling": {"kind": "adaptive", "part_s": 0.1}},
        termination=[{"kind": "far_from_reference", "joint_position": 0.001}],
    )
    every = settings.env_steps_per_update * NUM_UPDATES // 2
    resuming |= {"checkpoint_every_steps": every, "epoch_s": 0.0}
    if seeds:
        return make_seeds_run(environment, settings, seeds=seeds, **resuming)
    return make_run(environment, settings, seed=0, **resuming)


@pytest.fixture(scope="module")
def by_ppo(tmp_path_factory: pytest.TempPathFactory) -> dict[int, bytes]:
    """The checkpoints of a run with two clips."""
    return checkpoints(run(tmp_path_factory.mktemp("both")))


def test_a_resumed_run_has_the_same_record(tmp_path: Path, by_ppo: dict[int, bytes]) -> None:
    half, whole = sorted(by_ppo)
    record = PPO.read(by_ppo[whole])[1]["record"]
    assert record.shape == (2, 2)
    assert (record > 0).all()
    assert checkpoints(run(tmp_path, resume=by_ppo[half])) == {whole: by_ppo[whole]}


@pytest.mark.parametrize(
    ("form", "settings", "seeds"),
    [
        (PPO, PPO_SETTINGS, ()),
        *extra((PPO, PPO_SETTINGS, (0, 3)), (SAC, SAC_SETTINGS, ())),
    ],
    ids=["ppo", "seeds", "sac"],
)
def test_a_run_resumes_with_other_clips_in_fresh_episodes(
    tmp_path: Path, by_ppo: dict[int, bytes], form: Format, settings: Any, seeds: tuple[int, ...]
) -> None:
    is_the_same = settings is PPO_SETTINGS and not seeds
    kept = by_ppo if is_the_same else checkpoints(run(tmp_path, settings, seeds))
    half, whole = sorted(kept)
    three = [flight(0.5, name="slow"), *BOTH]
    with pytest.raises(JobFailed, match=r"record is float32\[.*2, 2\] in the checkpoint"):
        run(tmp_path, settings, seeds, three, resume=kept[half])
    other = run(tmp_path, settings, seeds, three, resume=kept[half], new_clips=True)
    events = other.events()
    next(events)
    had, has = form.read(kept[half])[1], form.read(other.checkpoint())[1]
    if seeds:
        had, has = had["runs"], has["runs"]
    assert has["record"].shape[-2:] == (2, 3)
    assert not has["record"].any()
    if form is SAC:  # Its targets reach over several steps of an environment: none is of two episodes.
        assert had["replay"]["written"] > has["replay"]["written"] == 0
    for name in has.keys() - {"episodes", "record", "replay"}:
        jax.tree.map(np.testing.assert_array_equal, has[name], had[name])
    assert [event.step for event in events if isinstance(event, CheckpointReady)] == [whole]
    assert other.checkpoint() != kept[whole]
