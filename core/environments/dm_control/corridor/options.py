"""The corridor's options of one kind: bounds of lengths, what a walker observes, rewards and ends."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import AfterValidator, Field

from core.bounds import Real
from core.documents import Strict
from core.environments.dm_control.corridor.walkers import Walker
from core.environments.info import Slice
from core.environments.options import NotDescending, Weight
from core.environments.terms.array_slices import CINERT, CVEL, qfrc_actuator, rows
from core.environments.terms.inventory import Inventory


def _not_negative(bounds: tuple[float, float]) -> tuple[float, float]:
    if bounds[0] < 0:
        raise ValueError(f"must not be negative, but [{bounds[0]:g}, {bounds[1]:g}] is")
    return bounds


Drawn = Annotated[tuple[Real, Real], Field(strict=False), NotDescending, AfterValidator(_not_negative)]
"""[low, high] in metres: each length is drawn uniformly between them."""


if TYPE_CHECKING:  # The API reads sizes and loads no JAX.
    import jax

    from core.physics.engine import PhysicsState

Observable = Literal["cinert", "cvel", "qfrc_actuator"]
# In the notebook's order, whichever order a job names them in.
OBSERVABLES: tuple[Observable, ...] = ("cinert", "cvel", "qfrc_actuator")


def in_order(chosen: Sequence[Observable]) -> tuple[Observable, ...]:
    """The chosen ones, each once."""
    return tuple(name for name in OBSERVABLES if name in chosen)


def slices(chosen: Sequence[Observable], walker: Inventory) -> list[Slice]:
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


Aesthetic = Literal["checkered", "default", "outdoor_natural"]


class TaskOptions(Strict):
    """dm_control's reward, terminations, observables and looks; by default the notebook's stay alone."""

    target_velocity: float | None = Field(
        None,
        gt=0,
        le=100,
        description="Metres per second in +x: adds dm_control's reward, 1 at this velocity and 0 at rest and "
        "at twice this velocity; null: none.",
    )
    target_velocity_weight: Weight = Field(1.0, description="Weight of the reward for `target_velocity`.")
    contact_termination: bool = Field(
        False, description="Whether the episode ends where a part that is no foot touches the ground."
    )
    terminate_at_height: float | None = Field(
        None,
        ge=-10,
        le=0,
        description="The episode ends where an end effector is below this height, in metres; null: none.",
    )
    observables: list[Observable] = Field(
        [],
        max_length=64,
        description="MuJoCo's fields that follow positions and velocities in the observation; `cinert` and "
        "`cvel` of the walker's bodies.",
    )
    egocentric_depth: int = Field(
        0,
        ge=0,
        le=64,
        description="Side, in pixels, of a square image by the walker's own camera, at the observation's "
        "end: how far away the arena is behind each pixel, in metres, 10 at most. 0: no image.",
    )
    aesthetic: Aesthetic = Field(
        "checkered",
        description="How ground and sky are drawn: Gaitway's squares, or dm_control's aesthetic.",
    )


def check_stands_on_its_feet(options: TaskOptions, walker: Walker) -> None:
    """Raises ValueError if contacts would end every episode as it begins."""
    if options.contact_termination and walker == "rodent":
        raise ValueError(
            "contact_termination would end every episode as it begins: the rodent stands on its forearms, "
            "which are no feet in dm_control; use terminate_at_height or healthy_z_range"
        )
