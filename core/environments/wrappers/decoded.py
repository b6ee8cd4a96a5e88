"""A body that is moved by intentions: a trained policy's decoder stands between an action and the body."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np

from core.environments.environment import Environment, State, Wrapped, innermost
from core.environments.info import POLICY_GROUP
from core.environments.terms.actions import DecoderAction
from core.environments.terms.lent import seen_by
from core.environments.terms.observations import ObservationTerm
from core.errors import JobFailed
from core.physics.engine import NOMINAL, ModelFields
from core.reasons import Reason

Layer = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Decoder:
    """(intention [latent], body [n]) -> action [action_size]. The mode of the action's distribution.

    mean, std: of what is seen of the body, [n]. max_abs: bound on that once it is normalised. layers: (kernel
    [inputs, outputs], bias [outputs]), with the activation after each but the last, whose outputs are means
    and deviations.
    """

    mean: np.ndarray
    std: np.ndarray
    max_abs: float
    layers: tuple[Layer, ...]
    activation: Callable[[jax.Array], jax.Array]

    @property
    def latent(self) -> int:
        return self.layers[0][0].shape[0] - len(self.mean)

    @property
    def action_size(self) -> int:
        return len(self.layers[-1][1]) // 2

    def __call__(self, intention: jax.Array, body: jax.Array) -> jax.Array:
        normalized = jnp.clip((body - self.mean) / self.std, -self.max_abs, self.max_abs)
        values = jnp.concatenate([intention, normalized])
        for kernel, bias in self.layers[:-1]:
            values = self.activation(values @ kernel + bias)
        kernel, bias = self.layers[-1]
        half = self.action_size
        return jnp.tanh(values @ kernel[:, :half] + bias[:half])


def read_decoder(path: Path) -> Decoder:
    """The decoder in a `policy.npz` (docs/export.md). Raises JobFailed for another file."""
    try:
        with np.load(path, allow_pickle=False) as file:
            network = json.loads(str(file["about"]))["network"]
            mean = file["observation_mean"]
            seen = np.setdiff1d(np.arange(len(mean)), network["encoder"]["encoded"])
            bound = network["normalized_max_abs"]
            return Decoder(
                mean[seen],
                file["observation_std"][seen],
                math.inf if bound is None else bound,
                tuple((file[f"kernel_{i}"], file[f"bias_{i}"]) for i in range(network["num_layers"])),
                getattr(jax.nn, network["activation"]),
            )
    except Exception as error:  # A damaged file may make a reader raise anything.
        detail = "The policy whose decoder is to act is damaged, or has no decoder."
        raise JobFailed(Reason.BAD_CHECKPOINT, detail) from error


@dataclass(frozen=True)
class Decoded(Wrapped):
    """The environment, of which the decoder sees these places of the observation. An action of ±1 is an
    intention of ±`reach`."""

    decoder: Decoder
    places: np.ndarray
    reach: float

    @property
    def action_size(self) -> int:
        return self.decoder.latent

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        return self.environment.reset(key, model)

    def step(self, state: State, action: jax.Array) -> State:
        seen: Any = state.obs
        if isinstance(seen, Mapping):
            seen = seen[POLICY_GROUP]
        return self.environment.step(state, self.decoder(self.reach * action, seen[self.places]))


@runtime_checkable
class SeesForDecoder(Protocol):
    """An environment whose observation has what a decoder sees."""

    def places_of(self, terms: Sequence[ObservationTerm]) -> np.ndarray:
        """Where the numbers of these terms are in the observation, in the terms' order; those of terms that
        it lacks are left out."""
        ...


def behind_decoder(environment: Environment, action: DecoderAction, file: Path | None) -> Decoded:
    """The environment behind the decoder in the file. Raises JobFailed."""
    inner = innermost(environment)
    if file is None or action.sees is None or not isinstance(inner, SeesForDecoder):
        raise JobFailed(Reason.BAD_CHECKPOINT, f"The decoder of job {action.job} is missing.")
    decoder = read_decoder(file)
    places = inner.places_of(seen_by(action))
    fits = (len(places), decoder.latent, environment.action_size)
    if fits != (len(decoder.mean), action.latent, decoder.action_size):
        detail = (
            f"The decoder of job {action.job} sees {len(decoder.mean)} numbers and an intention of "
            f"{decoder.latent}, and gives {decoder.action_size}; this task has {', '.join(map(str, fits))}."
        )
        raise JobFailed(Reason.BAD_CHECKPOINT, detail)
    return Decoded(environment, decoder, places, action.reach)


def is_decoded(environment: Environment) -> bool:
    """Whether a decoder stands between actions and the body."""
    while isinstance(environment, Wrapped):
        if isinstance(environment, Decoded):
            return True
        environment = environment.environment
    return False
