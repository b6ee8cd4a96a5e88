"""A checkpoint's bytes: a description of the run's shape, and everything in its state. Never pickle.

MessagePack of {"header", "sha256", "state"}; equal states give equal bytes. The header's `format` is
`gaitway-<kind of algorithm>-<version>`.
"""

import hashlib
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from flax import serialization
from pydantic import BaseModel

from core.algorithms.spec import BaseSpec
from core.environments.environment import Environment
from core.errors import JobFailed
from core.reasons import Reason

_FORMAT_NAME = re.compile(r"gaitway-(?P<kind>.+)-[^-]+")  # A kind may have hyphens itself.
_CANNOT_BE_READ = "The checkpoint cannot be read: it is cut off, or not a checkpoint of this service."


@dataclass(frozen=True)
class Format:
    """The format of one algorithm's checkpoints.

    name: `gaitway-<kind>-<version>`, which is written into each of them; ValueError for any other.
    """

    name: str

    def __post_init__(self) -> None:
        if _FORMAT_NAME.fullmatch(self.name) is None:
            raise ValueError(f"The name of a format must be gaitway-<kind>-<version>, and not {self.name!r}.")

    def pack(self, description: Mapping[str, Any], progress: Mapping[str, int], state: Any) -> bytes:
        """The checkpoint of a state; progress: the counters that live outside it."""
        body = serialization.msgpack_serialize(jax.device_get(serialization.to_state_dict(state)))
        header = {"format": self.name, **description, "progress": dict(progress)}
        parts = {"header": header, "sha256": hashlib.sha256(body).hexdigest(), "state": body}
        return serialization.msgpack_serialize(parts)

    def read(self, content: bytes) -> tuple[dict[str, Any], dict[str, Any]]:
        """The header and the state as nested dicts of arrays. Raises JobFailed where they are damaged."""
        try:
            parts = _decode(content)
            header, body = parts["header"], parts["state"]
            intact = hashlib.sha256(body).hexdigest() == parts["sha256"]
        except Exception as error:  # damaged bytes may make a decoder raise anything
            raise _bad(_CANNOT_BE_READ) from error
        if header["format"] != self.name:
            raise _bad(
                f"The checkpoint has the format {header['format']!r}; this version reads {self.name!r}."
            )
        if not intact:
            raise _bad("The checkpoint is damaged: its content does not have the recorded SHA-256.")
        return header, _decode(body)

    def unpack(
        self,
        content: bytes,
        description: Mapping[str, Any],
        template: Any,
        unread: Collection[str] = (),
    ) -> tuple[dict[str, int], Any]:
        """The counters and the state, in the shape of `template`, a tree of arrays or of their shapes.

        unread: fields of the state that are left out; the template has None there.
        Raises JobFailed("bad_checkpoint"), which names the differences.
        """
        header, saved = self.read(content)
        saved = _without(saved, unread)
        differences = [
            f"{name} is {header.get(name)} in the checkpoint and {wanted} in this job"
            for name, wanted in description.items()
            if header.get(name) != wanted
        ]
        wanted = serialization.to_state_dict(template)
        differences = differences or _differences(saved, wanted)
        if differences:
            raise _bad(f"The checkpoint does not fit this job: {'; '.join(differences)}.")
        return header["progress"], serialization.from_state_dict(template, _completed(saved, wanted))


def describe(environment: Environment, settings: BaseSpec) -> dict[str, Any]:
    """The facts that a checkpoint and the run that resumes from it must have in common."""
    sizes = {"observation_size": environment.observation_size, "action_size": environment.action_size}
    return sizes | {name: _plain(getattr(settings, name)) for name in settings.fixed_by_checkpoint}


def kind_of(content: bytes) -> str:
    """Which algorithm wrote the checkpoint. Raises JobFailed where that cannot be read."""
    return _format_name(content)["kind"]


def of_seed(content: bytes, seed: int) -> bytes:
    """The checkpoint of one seed, as its own run would write it, from that of a run of several seeds.

    Raises JobFailed where it is damaged, or has no such seed.
    """
    form = Format(_format_name(content)[0])
    header, state = form.read(content)
    seeds = header.pop("seeds", None)
    if seeds is None or seed not in seeds:
        raise _bad(f"The checkpoint has no seed {seed}; it has {seeds or 'one seed alone'}.")
    row = seeds.index(seed)
    return form.pack(
        header, header.pop("progress"), jax.tree.map(lambda x: np.asarray(x[row]), state["runs"])
    )


def _format_name(content: bytes) -> re.Match[str]:
    try:
        found = _FORMAT_NAME.fullmatch(_decode(content)["header"]["format"])
    except Exception as error:  # damaged bytes may make a decoder raise anything
        raise _bad(_CANNOT_BE_READ) from error
    if found is None:
        raise _bad(_CANNOT_BE_READ)
    return found


def _differences(saved: Mapping[str, Any], wanted: Mapping[str, Any]) -> list[str]:
    """Where two nested dicts of arrays differ in names, shapes or types."""
    have, need = _forms(saved), _forms(wanted)
    return [
        f"{name} is {have.get(name, 'missing')} in the checkpoint and {need.get(name, 'missing')} in this job"
        for name in sorted(have.keys() | need.keys())
        if have.get(name) != need.get(name)
    ]


def _without(state: Mapping[str, Any], fields: Collection[str]) -> dict[str, Any]:
    """A state, or those of several seeds, without these fields."""
    kept = {name: value for name, value in state.items() if name not in fields}
    return {**kept, "runs": _without(kept["runs"], fields)} if "runs" in kept else kept


def _completed(saved: Mapping[str, Any], wanted: Mapping[str, Any]) -> dict[str, Any]:
    """What was saved, with the fields that this run does not use: checkpoints may be older than these."""
    unused = {name: None for name, value in wanted.items() if value is None}
    inner = {
        name: _completed(value, wanted[name])
        for name, value in saved.items()
        if isinstance(value, Mapping) and isinstance(wanted.get(name), Mapping)
    }
    return {**unused, **saved, **inner}


def _forms(tree: Mapping[str, Any]) -> dict[str, str]:
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {
        jax.tree_util.keystr(
            path, simple=True, separator="."
        ): f"{np.dtype(leaf.dtype).name}{list(leaf.shape)}"
        for path, leaf in leaves
    }


def _plain(value: Any) -> Any:
    return value.model_dump(mode="json") if isinstance(value, BaseModel) else value


def _decode(content: bytes) -> dict[str, Any]:
    decoded: Any = serialization.msgpack_restore(content)
    return decoded


def _bad(detail: str) -> JobFailed:
    return JobFailed(Reason.BAD_CHECKPOINT, detail)
