"""A training whose engine loses a body keeps that body's last states, also as a replay."""

import json
import os
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.environments.environment import State, Wrapped
from core.errors import JobFailed
from core.jobs.spec import JOB_SPEC
from core.physics.engine import NOMINAL, ModelFields
from worker.protocol import MESSAGE, FileReady, Noted, Task
from worker.stopping import StopRequest
from worker.training.built_environment import build_environment
from worker.training.event_writer import EventWriter
from worker.training.train import train

NUM_ENVS, UNROLL, REPEAT = 8, 10, 2


@dataclass(frozen=True)
class Unstable(Wrapped):
    """The positions are no numbers once the body's coordinate `of` is beyond `bound`."""

    bound: float = 0.0

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        return self.environment.reset(key, model)

    def step(self, state: State, action: jax.Array) -> State:
        after = self.environment.step(state, action)
        is_lost = jnp.abs(after.physics.qpos[1]) > self.bound
        qpos = jnp.where(is_lost, jnp.nan, after.physics.qpos)
        return replace(after, physics=replace(after.physics, qpos=qpos))


def spec(**more: Any) -> Any:
    sizes = {"policy_hidden_layer_sizes": [4], "value_hidden_layer_sizes": [4], "num_evals": 0}
    batch = {"num_envs": NUM_ENVS, "unroll_length": UNROLL, "batch_size": NUM_ENVS, "num_minibatches": 1}
    ppo = {"kind": "ppo", "num_timesteps": 4 * NUM_ENVS * UNROLL * REPEAT, "action_repeat": REPEAT}
    document = {"kind": "train", "environment": "inverted_pendulum", "physics": "native", "video": None}
    return JOB_SPEC.validate_python({**document, "algorithm": {**ppo, **batch, **sizes}, **more})


def trained(folder: Path, asked: Any, bound: float) -> tuple[list[FileReady], list[str]]:
    """The files and the notes of a training whose bodies are lost where their pole leans by `bound` rad."""
    task = Task(job_id="j", attempt=1, spec=asked, device="cpu")
    built = build_environment(task)
    built = replace(built, environment=Unstable(built.environment, bound))
    read, write = os.pipe()
    events = EventWriter(folder, write)
    with suppress(JobFailed):  # More than one body that an update loses is a divergence.
        train(task, asked, built, events, StopRequest())
    events._pipe.close()
    with os.fdopen(read, "rb") as pipe:
        said = [MESSAGE.validate_json(line) for line in pipe]
    files = [message for message in said if isinstance(message, FileReady)]
    return files, [message.text for message in said if isinstance(message, Noted)]


@pytest.mark.timeout(300)
def test_the_last_states_of_a_lost_body_are_kept(tmp_path: Path) -> None:
    # Random actions lean the pole by 0.19 rad within some 10 to 20 actions, at which the episode goes on.
    files, notes = trained(tmp_path, spec(), bound=0.19)
    [numbers] = [file for file in files if file.role == "lost_body"]
    [replay] = [file for file in files if file.role == "replay"]
    assert (numbers.name, replay.name) == ("lost-body.npz", "replay-lost.bin")
    assert replay.metadata["lost_body"] is True
    assert replay.step == numbers.step
    assert (tmp_path / replay.path).read_bytes().startswith(b"GWREPLAY")
    assert any(f"the replay of step {numbers.step} and lost-body.npz" in note for note in notes)

    with np.load(tmp_path / numbers.path, allow_pickle=False) as file:
        about, qpos, qvel, action = json.loads(str(file["about"])), file["qpos"], file["qvel"], file["action"]
    assert about["step"] == numbers.step
    assert about["environment"] == "inverted_pendulum"
    assert numbers.metadata == {"states": len(qpos), "env": about["env"]}
    assert np.isfinite(qpos).all()
    assert 1 <= len(qpos) == len(qvel) == len(action) <= UNROLL

    # The environment itself goes from each row to the next one, and from the last one beyond the bound.
    environment = build_environment(Task(job_id="j", attempt=1, spec=spec(), device="cpu")).environment
    state, step = environment.reset(jax.random.key(0)), jax.jit(environment.step)
    assert about["dt_s"] == pytest.approx(REPEAT * environment.dt)
    for row in range(len(qpos)):
        state = replace(state, physics=replace(state.physics, qpos=qpos[row], qvel=qvel[row]))
        for _ in range(REPEAT):
            state = step(state, action[row])
        if row + 1 < len(qpos):
            np.testing.assert_allclose(state.physics.qpos, qpos[row + 1], atol=1e-5)
    assert abs(state.physics.qpos[1]) > 0.19


@pytest.mark.timeout(300)
def test_a_healthy_training_keeps_none(tmp_path: Path) -> None:
    files, notes = trained(tmp_path, spec(), bound=100.0)
    assert not [file for file in files if file.role in ("lost_body", "replay", "scene")]
    assert not [note for note in notes if "lost" in note]


@pytest.mark.timeout(300)
def test_of_several_seeds_the_first_one_that_lost_a_body_keeps_it(tmp_path: Path) -> None:
    files, _ = trained(tmp_path, spec(seeds=[3, 5]), bound=0.19)
    [numbers] = [file for file in files if file.role == "lost_body"]
    assert numbers.metadata["seed"] in (3, 5)
    assert numbers.name == f"lost-body-seed-{numbers.metadata['seed']}.npz"
