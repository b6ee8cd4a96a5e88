"""The catalog's bodies that imitate: each follows a clip of its own rest, and says what it lacks."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.clips.archive import to_bytes
from core.clips.clip import Clip
from core.environments import catalog
from core.environments.robots.model import robot
from core.environments.task import TaskEnv
from core.environments.terms.metrics import UNITS
from core.errors import Rejected
from core.jobs.resolved import resolve_job
from core.jobs.spec import TrainSpec
from core.physics.choose import engine_builder
from core.physics.model import initial_qpos

FILE = "sha256:" + "1" * 64
FOLLOWS: dict[str, Any] = {"task": "imitate", "reference": {"clips": [{"file": FILE}]}}
BODIES = ["g1", "humanoid", "rodent"]


def at_rest(body: str, file: Path) -> dict[str, Path]:
    """A file with a second of the body's initial pose."""
    info = catalog.find(body)
    if body == "g1":
        model = robot("g1", info.option_values)[0].compile()  # pyright: ignore[reportArgumentType]
    else:
        model = catalog.make(info, info.option_values, engine_builder("native")).model
    pose = np.tile(initial_qpos(model), (51, 1))
    joints = tuple(str(model.joint(number).name) for number in range(1, model.njnt))
    file.write_bytes(to_bytes([Clip("rest", 50.0, pose[:, :3], pose[:, 3:7], joints, pose[:, 7:])]))
    return {FILE: file}


@pytest.mark.parametrize("body", BODIES)
def test_a_body_follows_its_own_rest(body: str, tmp_path: Path) -> None:
    row, options = catalog.resolve(body, FOLLOWS)
    environment = catalog.make(
        row, options, engine_builder("native"), clips=at_rest(body, tmp_path / "clips.npz")
    )
    assert isinstance(environment, TaskEnv)
    assert environment.observation_size == row.observation_size
    # A clip of a second is resampled to the control steps of the body.
    assert environment.playback is not None
    assert environment.playback.frames.lengths.tolist() == [1 + int(1 / environment.dt + 1e-6)]
    state = jax.jit(environment.reset)(jax.random.key(0))
    after = jax.jit(environment.step)(state, jnp.zeros(environment.action_size))
    assert float(after.done) == 0.0
    assert float(after.metrics["root_error"]) < 0.06
    # A recording says their units.
    assert {name for name in after.metrics if not name.startswith("reward_")} <= {*UNITS, "lost_body"}
    assert float(after.reward) > 3.0  # Of 5.5.


@pytest.mark.parametrize("body", BODIES)
def test_the_task_is_refused_without_clips(body: str) -> None:
    with pytest.raises(Rejected, match="The task imitate needs `reference`, with the clips to follow"):
        catalog.resolve(body, {"task": "imitate"})


@pytest.mark.parametrize("body", ["humanoid", "rodent"])
def test_a_reference_that_nothing_follows_is_refused(body: str) -> None:
    with pytest.raises(Rejected, match="followed by the task imitate alone"):
        catalog.resolve(body, {"reference": FOLLOWS["reference"]})
    with pytest.raises(Rejected, match="did you mean 'torso'"):
        catalog.resolve(body, {**FOLLOWS, "reference": {**FOLLOWS["reference"], "anchor": "torsoo"}})


@pytest.mark.parametrize(
    ("body", "unread"),
    [
        ("humanoid", {"healthy_z_range": [0.9, 2.0]}),
        ("humanoid", {"healthy_reward": 1.0}),
        ("rodent", {"healthy_z_range": [0.1, 0.3]}),
        ("rodent", {"reset_noise_scale": 0.02}),
        ("rodent", {"exclude_current_positions_from_observation": True}),
    ],
)
def test_options_that_imitation_does_not_read_are_refused(body: str, unread: dict[str, Any]) -> None:
    with pytest.raises(Rejected, match=f"`{next(iter(unread))}` is not read by the task imitate: leave it"):
        catalog.resolve(body, {**FOLLOWS, **unread})


def test_options_that_say_their_defaults_go_with_imitation() -> None:
    catalog.resolve("rodent", {**FOLLOWS, "healthy_z_range": [0.03, 0.3], "healthy_reward": 0.5})
    # The start of the humanoid that imitates has this noise.
    catalog.resolve("humanoid", {**FOLLOWS, "reset_noise_scale": 0.02})


@pytest.mark.parametrize("body", BODIES)
def test_starts_that_follow_from_failures_need_fresh_starts(body: str) -> None:
    settings = {"kind": "ppo", "reset_pool_size": 0}
    job = {"environment": {"id": body, "options": FOLLOWS}, "algorithm": settings}
    with pytest.raises(Rejected, match=r"reset_pool_size = 0 .* give up that of `reference.sampling`"):
        resolve_job(TrainSpec.model_validate(job)).settings_on("cpu")
