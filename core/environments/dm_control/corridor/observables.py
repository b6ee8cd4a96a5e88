"""MuJoCo's fields that the notebook has commented out of its observation."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:  # The API reads sizes and loads no JAX.
    import jax

    from core.physics.engine import PhysicsState

Observable = Literal["cinert", "cvel", "qfrc_actuator"]
# In the notebook's order, whichever order a job names them in.
OBSERVABLES: tuple[Observable, ...] = ("cinert", "cvel", "qfrc_actuator")
_PER_BODY = {"cinert": 10, "cvel": 6}


def in_order(chosen: Sequence[Observable]) -> tuple[Observable, ...]:
    """The chosen ones, each once."""
    return tuple(name for name in OBSERVABLES if name in chosen)


def size(chosen: Sequence[Observable], *, num_bodies: int, num_velocities: int) -> int:
    """How many numbers they are, of a walker with these many bodies and nv."""
    return sum(
        num_bodies * _PER_BODY[name] if name in _PER_BODY else num_velocities for name in in_order(chosen)
    )


def values(chosen: Sequence[Observable], physics: "PhysicsState", bodies: slice) -> "list[jax.Array]":
    """Each one as a vector: of these bodies `cinert` [10 each] and `cvel` [6 each], and `qfrc_actuator` [nv],
    the actuators' forces on all joints in the last physics step."""
    return [
        physics.derived[name][bodies].ravel() if name in _PER_BODY else physics.derived[name]
        for name in in_order(chosen)
    ]
