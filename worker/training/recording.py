"""A rollout's `recording.h5`: its episodes with the activations of the policy's layers, and its picture."""

import json
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from typing import Any

import jax
import numpy as np

from core.algorithms.activations import ActivationReader
from core.algorithms.export.network import NotExportable
from core.algorithms.latent import LatentPoints, plotted_layer
from core.environments.environment import Environment
from core.environments.info import POLICY_GROUP
from core.environments.recording import RecordingWriter
from core.environments.rollout import action_keys, clips_of
from core.environments.trajectory import Episode
from core.errors import JobFailed, Rejected
from core.jobs.recording import chosen_layers
from core.jobs.spec import RecordingSpec, RolloutSpec
from core.reasons import Reason
from worker.protocol import Task
from worker.training.built_environment import BuiltEnvironment
from worker.training.event_writer import EventWriter

NAME = "recording.h5"
# Its layer that is looked at first, in two dimensions; of the same role, so that it goes with it.
LATENT = "latent.json"


@contextmanager
def recorded(
    task: Task,
    spec: RolloutSpec,
    built: BuiltEnvironment,
    activations: Callable[[], ActivationReader] | None,
    events: EventWriter,
) -> Generator[Callable[[Episode], None]]:
    """A function that records the job's next episode; the file is kept when the block is over.

    activations: see `TrainedPolicy`. Without a recording to make, the function does nothing. Raises JobFailed
    where the layers cannot be recorded.
    """
    if spec.recording is None:
        yield lambda _: None
        return
    reader = _reader(activations, built.environment)
    chosen = _chosen(spec.recording, reader)
    key = jax.random.PRNGKey(spec.seed)
    writer = RecordingWriter(
        events.spool / NAME,
        built.environment.model,
        built.info.spaces,
        clips_of(built.environment),
        _about(task, spec, built, reader),
    )
    layers = [] if reader is None else list(reader.sizes)
    layer = plotted_layer(chosen, layers)
    num_steps = spec.num_steps * spec.num_episodes
    points = None if layer is None else LatentPoints(layer, num_steps, clips_of(built.environment))
    with writer:

        def record(episode: Episode) -> None:
            values = {}
            if reader is not None and chosen:
                keys = np.asarray(action_keys(key, writer.num_episodes, spec.num_steps))
                values = reader.read(episode.observation[:-1], keys[: episode.num_steps], chosen)
            if points is not None:
                points.add(episode, values[points.layer])
            writer.add(episode, values)

        yield record
    facts: dict[str, Any] = {"episodes": writer.num_episodes, "layers": chosen}
    events.hand_over(NAME, "recording", "application/x-hdf5", metadata=facts)
    if points is not None and (found := points.document()) is not None:
        events.keep(LATENT, json.dumps(found, allow_nan=False).encode(), "recording", "application/json")


def _reader(
    activations: Callable[[], ActivationReader] | None, environment: Environment
) -> ActivationReader | None:
    """None for a policy without layers, and for one that sees another observation than the one recorded.

    Raises JobFailed.
    """
    if activations is None:
        return None
    try:
        reader = activations()
    except NotExportable as error:
        raise JobFailed(Reason.BAD_CHECKPOINT, f"Its layers cannot be recorded: {error}.") from error
    has_names = isinstance(environment.observation_size, Mapping)
    return None if has_names and reader.network.observation_name != POLICY_GROUP else reader


def _chosen(recording: RecordingSpec, reader: ActivationReader | None) -> list[str]:
    """The layers to record. Raises JobFailed."""
    try:
        return chosen_layers(recording.layers, [] if reader is None else list(reader.sizes))
    except Rejected as error:
        raise JobFailed(Reason.BAD_CHECKPOINT, error.detail) from error


def _about(
    task: Task, spec: RolloutSpec, built: BuiltEnvironment, reader: ActivationReader | None
) -> dict[str, Any]:
    """The attributes of the file."""
    about: dict[str, Any] = {
        "job": task.job_id,
        "environment": spec.environment.model_dump(mode="json"),
        "policy": spec.policy.model_dump(mode="json"),
        "seed": spec.seed,
        "deterministic": spec.deterministic,
        "step_s": built.environment.dt,
        "engine": built.engine,
        "versions": built.versions,
    }
    if reader is not None:
        network = reader.network
        about |= {"activation": network.activation, "action_repeat": network.action_repeat}
    return about
