"""Starts in clips that follow from where episodes failed.

Unlike a terrain's level, where an episode begins follows from those of all environments, so a training state
holds a record of them: how often steps failed in each part of the clips.
"""

from typing import Protocol, cast, runtime_checkable

import jax
import jax.numpy as jnp

from core.environments.environment import Environment, State, innermost, with_innermost
from core.environments.reference.parts import Parts, Record
from core.environments.reference.playback import FRAME


@runtime_checkable
class HasClipParts(Protocol):
    """The attributes of an environment besides its own methods."""

    @property
    def adaptive_parts(self) -> Parts | None:
        """None: no start depends on where episodes failed."""
        ...

    def under_record(self, record: Record) -> Environment:
        """The environment whose fresh starts follow from this record; without this call, they are uniform."""
        ...


def first_record(environment: Environment) -> Record | None:
    """That of a run that begins; None if no start depends on where episodes failed."""
    parts = _parts(environment)
    return None if parts is None else jnp.zeros((2, parts.number))


def under_record(environment: Environment, record: Record | None) -> Environment:
    """The environment whose fresh starts follow from this record; unchanged if it is None."""
    if record is None:
        return environment
    return with_innermost(environment, lambda inner: cast("HasClipParts", inner).under_record(record))


def parts_reached(environment: Environment, reached: State) -> jax.Array | None:
    """The parts [...] int32 that these states [...] are in; None if no start depends on them."""
    parts = _parts(environment)
    return None if parts is None else jnp.asarray(parts.of_frame)[reached.info[FRAME]]


def counted(
    environment: Environment, record: Record | None, reached: jax.Array | None, failed: jax.Array
) -> Record | None:
    """The record after an update. reached: of each step, by `parts_reached`; failed: 1 where it failed."""
    parts = _parts(environment)
    if parts is None or record is None or reached is None:
        return record
    return parts.counted(record, reached, failed)


def _parts(environment: Environment) -> Parts | None:
    inner = innermost(environment)
    return inner.adaptive_parts if isinstance(inner, HasClipParts) else None
