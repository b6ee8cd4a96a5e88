"""The policy of a training for programs elsewhere, as `policy.npz` and `policy.onnx`."""

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

from core.algorithms.catalog import ALGORITHMS
from core.algorithms.export.contract import Origin, contract
from core.algorithms.export.network import Network, NotExportable, network_of
from core.algorithms.export.numpy_file import numpy_file
from worker.protocol import Noted
from worker.training.built_environment import BuiltEnvironment
from worker.training.event_writer import EventWriter

_Writer = Callable[[Network, Mapping[str, Any]], bytes]


def keep_exports(
    policy: bytes, algorithm: str, step: int, built: BuiltEnvironment, events: EventWriter
) -> None:
    """Keep both files; nothing for an algorithm whose policies have no such form.

    policy: the algorithm's own file. A file that cannot be written is a note: the job has its policy.
    """
    if ALGORITHMS[algorithm].no_export is not None:
        return
    # Its import takes 0.3 s, which no start waits for.
    from core.algorithms.export.onnx_file import onnx_file

    origin = Origin(
        algorithm=algorithm,
        environment=built.info.id,
        options=built.info.option_values.model_dump(mode="json"),
        step_s=built.environment.dt,
        trained_steps=step,
        observation_parts=[asdict(part) for part in built.info.spaces.observation],
        action_parts=[asdict(part) for part in built.info.spaces.action],
    )
    writers: Mapping[str, tuple[_Writer, str]] = {
        "policy.npz": (numpy_file, "application/x-npz"),
        "policy.onnx": (onnx_file, "application/octet-stream"),
    }
    for name, (write, media_type) in writers.items():
        try:
            network = network_of(policy)
            events.keep(name, write(network, contract(network, origin)), "export", media_type, step=step)
        except NotExportable as error:
            events.send(Noted(text=f"There is no {name}: {error}."))
