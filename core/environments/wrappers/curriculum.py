"""Curricula: environments whose fresh starts depend on how far a run is.

The progress is a number of the compiled program, so a run compiles once; it follows from the environment
steps alone, so a run that resumes continues where it was.
Source: Bengio et al., Curriculum Learning (2009).
"""

from typing import Protocol, cast, runtime_checkable

import jax
import jax.numpy as jnp

from core.environments.environment import Environment, innermost, with_innermost


@runtime_checkable
class HasCurriculum(Protocol):
    """The attributes of an environment besides its own methods."""

    @property
    def curriculum_steps(self) -> int | None:
        """Environment steps until the curriculum ends; None: it has none."""
        ...

    def at_progress(self, progress: jax.Array) -> Environment:
        """The environment whose fresh starts are those at this progress [], from 0 to 1.

        Without this call, they are those at the end.
        """
        ...


def progress_at(environment: Environment, num_updates: jax.Array, steps_per_update: int) -> jax.Array | None:
    """From 0 to 1, [] float32; None if the environment has no curriculum. num_updates: [] int32."""
    inner = innermost(environment)
    steps = inner.curriculum_steps if isinstance(inner, HasCurriculum) else None
    # As float32, because the steps of a long run pass 2**31.
    return None if steps is None else jnp.minimum(num_updates * jnp.float32(steps_per_update / steps), 1.0)


def at_progress(environment: Environment, progress: jax.Array | None) -> Environment:
    """The environment whose fresh starts are those at this progress; unchanged if it is None."""
    if progress is None:
        return environment
    return with_innermost(environment, lambda inner: cast("HasCurriculum", inner).at_progress(progress))


def progress_metrics(progress: jax.Array | None) -> dict[str, jax.Array]:
    """The metric of an update: `curriculum`, if there is one."""
    return {} if progress is None else {"curriculum": progress}
