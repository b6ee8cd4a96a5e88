"""MuJoCo's fields that the notebook has commented out of its observation."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from core.environments.bodies import Body
from core.environments.body_slices import CINERT, CVEL, qfrc_actuator, rows
from core.environments.spaces import Slice

if TYPE_CHECKING:  # The API reads sizes and loads no JAX.
    import jax

    from core.physics.engine import PhysicsState

Observable = Literal["cinert", "cvel", "qfrc_actuator"]
# In the notebook's order, whichever order a job names them in.
OBSERVABLES: tuple[Observable, ...] = ("cinert", "cvel", "qfrc_actuator")


def in_order(chosen: Sequence[Observable]) -> tuple[Observable, ...]:
    """The chosen ones, each once."""
    return tuple(name for name in OBSERVABLES if name in chosen)


def slices(chosen: Sequence[Observable], walker: Body) -> list[Slice]:
    """Their numbers by name, of a walker's bodies and joints."""
    named = {
        "cinert": [rows("cinert", walker.bodies, CINERT, "kg m², kg m, kg")],
        "cvel": [rows("cvel", walker.bodies, CVEL, "rad/s, m/s")],
        "qfrc_actuator": qfrc_actuator(walker),
    }
    return [one for name in in_order(chosen) for one in named[name]]


def values(chosen: Sequence[Observable], physics: "PhysicsState", bodies: slice) -> "list[jax.Array]":
    """Each one as a vector: of these bodies `cinert` [10 each] and `cvel` [6 each], and `qfrc_actuator` [nv],
    the actuators' forces on all joints in the last physics step."""
    return [
        physics.derived[name] if name == "qfrc_actuator" else physics.derived[name][bodies].ravel()
        for name in in_order(chosen)
    ]
