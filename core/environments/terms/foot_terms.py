"""Terms of feet: their height, their speed, when they touch, how hard they land.

Names and forms are those of legged_gym, Isaac Lab, mjlab and Playground. A foot's place is its sole's
(`feet.Foot`); it is on the ground while one of its geoms touches anything. `Step.foot_times` has what is
remembered of swings.
"""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from core.environments.info import Slice, named
from core.environments.terms.inventory import ModelParts
from core.environments.terms.observations import ObservationTerm
from core.environments.terms.readings import ContactCount, ContactForce, ContactNetForce, Reading
from core.environments.terms.term import Array, CostTerm, Need, RewardTerm, Term
from core.physics.availability import EngineName

if TYPE_CHECKING:
    from core.environments.terms.step import ModelIndex, Step

_AXES = ("x", "y", "z")


class _OfContacts(Term):
    """It reads whether feet touch something."""

    needs = frozenset({"feet", "foot_colliders"})

    def readings(self, parts: ModelParts) -> Iterable[Reading]:
        return [ContactCount(geom) for geoms in parts.feet_colliders.values() for geom in geoms]


class _OfTimes(_OfContacts):
    """It reads how long feet have been in the air or on the ground."""

    remembers = frozenset({"foot_times"})


class _OfForces(Term):
    """It reads how hard feet touch something."""

    needs = frozenset({"feet", "foot_colliders"})

    def readings(self, parts: ModelParts) -> Iterable[Reading]:
        return _forces(parts)


class _OneForEachFoot(ObservationTerm):
    def size(self, parts: ModelParts) -> int:
        return len(parts.feet)


class FootHeight(_OneForEachFoot):
    """How far the sole of each foot is above the ground, in m."""

    needs = frozenset({"feet"})

    kind: Literal["foot_height"] = "foot_height"

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        yield named("foot_height", parts.feet, "m")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return model.foot_heights(step)


class FootVelocity(ObservationTerm):
    """The velocity of the lowest point of each foot, along the world's axes, in m/s."""

    needs = frozenset({"feet"})

    kind: Literal["foot_velocity"] = "foot_velocity"

    def size(self, parts: ModelParts) -> int:
        return 3 * len(parts.feet)

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        yield named("foot_velocity", (f"{foot} {axis}" for foot in parts.feet for axis in _AXES), "m/s")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return model.foot_velocities(step).ravel()


class FootContact(_OfContacts, _OneForEachFoot):
    """1 for each foot that touches something, otherwise 0."""

    kind: Literal["foot_contact"] = "foot_contact"

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        yield named("foot_contact", parts.feet, "1", 0.0, 1.0)

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return model.foot_contacts(step)


class FootContactForce(_OfForces, _OneForEachFoot):
    """The sum of the normal forces on each foot in the last physics step, in N."""

    kind: Literal["foot_contact_force"] = "foot_contact_force"

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        yield named("foot_contact_force", parts.feet, "N")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return model.foot_forces(step)


class FootAirTime(_OfTimes, _OneForEachFoot):
    """How long each foot has been in the air, 0 for one on the ground, in s."""

    kind: Literal["foot_air_time"] = "foot_air_time"

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        yield named("foot_air_time", parts.feet, "s")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return (1.0 - step.times.touches) * step.times.air_time


class AirTime(_OfTimes, RewardTerm):
    """Σ (min(t, t_most) − t_least) over the feet that land in this step, with t the time that a foot was in
    the air, in s; 0 while the command is to stand.

    Source: Rudin et al., Learning to Walk in Minutes (2022), whose threshold of 0.5 s is t_least;
    Playground's `feet_air_time` has t_most.
    """

    kind: Literal["air_time"] = "air_time"
    least: float = Field(default=0.1, ge=0, le=10, description="Shorter swings cost, in s.")
    most: float = Field(default=0.5, gt=0, le=10, description="Longer swings earn no more, in s.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        times = step.times
        over = step.xp.minimum(times.air_time, self.most) - self.least
        return step.while_moving(step.xp.sum(times.landed * over))


class FootClearance(CostTerm):
    """Σ |z − h| ‖v_xy‖: feet that move fast at another height than h, in m²/s; 0 while the command is to
    stand. z: how far a sole is above the ground.

    Source: mjlab's `feet_clearance`; Ji et al., Concurrent Training (2022), with a square of z − h.
    """

    needs = frozenset({"feet"})
    usual_weight = 2.0

    kind: Literal["foot_clearance"] = "foot_clearance"
    height: float = Field(default=0.1, gt=0, le=1, description="The height h of a swing, in m.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        # Slightly above 0, where the norm has no derivative.
        speed = step.xp.sqrt(step.xp.sum(model.foot_velocities(step)[:, :2] ** 2, 1) + 1e-12)
        return step.while_moving(step.xp.sum(abs(model.foot_heights(step) - self.height) * speed))


class FootSwingHeight(_OfTimes, CostTerm):
    """Σ (z_peak / h − 1)² over the feet that land in this step; 0 while the command is to stand. z_peak: the
    highest that a sole was above the ground in its swing.

    Source: mjlab's `feet_swing_height`.
    """

    usual_weight = 0.25

    kind: Literal["foot_swing_height"] = "foot_swing_height"
    height: float = Field(default=0.1, gt=0, le=1, description="The highest point h of a swing, in m.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        error = step.times.peak_height / self.height - 1.0
        return step.while_moving(step.xp.sum(step.times.landed * error**2))


class SwingHeight(RewardTerm):
    """exp(−Σ (z − z*)² / σ²) over the feet: feet follow the gait's clock.

    z: how far a foot's sole is above the ground; z* = h max(0, sin φ) while the command is to move, otherwise
    0. In m.
    """

    needs = frozenset({"command", "feet", "gait"})

    kind: Literal["swing_height"] = "swing_height"
    height: float = Field(default=0.1, gt=0, le=1, description="The highest point h of a swing, in m.")
    tolerance: float = Field(default=0.06, gt=0, le=1, description="Error at which the term is 1/e, in m.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        xp = step.xp
        wanted = xp.where(step.is_moving, self.height * xp.maximum(xp.sin(step.phases), 0.0), 0.0)
        return xp.exp(-xp.sum((model.foot_heights(step) - wanted) ** 2) / self.tolerance**2)


class FootGait(_OfContacts, RewardTerm):
    """The share of feet that touch something as the gait's clock says: on the ground where sin φ ≤ 0, and all
    of them while the command is to stand.

    Source: Siekmann et al., Sim-to-Real Learning of All Common Bipedal Gaits (2021); Unitree's `feet_gait`.
    """

    needs = _OfContacts.needs | {"command", "gait"}
    usual_weight = 0.5

    kind: Literal["foot_gait"] = "foot_gait"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        xp = step.xp
        in_swing = xp.where(step.is_moving & (xp.sin(step.phases) > 0), 1.0, 0.0)
        return xp.mean(abs(model.foot_contacts(step) - in_swing))


class FootSlip(_OfContacts, CostTerm):
    """Σ ‖v_xy‖² of the soles that are on the ground, in m²/s². v: of a sole's lowest point."""

    usual_weight = 0.1

    kind: Literal["foot_slip"] = "foot_slip"
    height: float | None = Field(
        default=0.02,
        gt=0,
        le=1,
        description="A foot is on the ground where its sole is lower than this above it, in m; null: where "
        "it touches something.",
    )

    @property
    def needed(self) -> frozenset[Need]:
        return self.needs if self.height is None else frozenset({"feet"})

    def readings(self, parts: ModelParts) -> Iterable[Reading]:
        return super().readings(parts) if self.height is None else ()

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        speed = step.xp.sum(model.foot_velocities(step)[:, :2] ** 2, 1)
        if self.height is None:
            return step.xp.sum(model.foot_contacts(step) * speed)
        return step.xp.sum(step.xp.where(model.foot_heights(step) < self.height, speed, 0.0))


class SoftLanding(_OfTimes, CostTerm):
    """Σ F over the feet that land in this step, in N; 0 while the command is to stand. F: the sum of the
    normal forces on a foot in the last physics step.

    Source: mjlab's `soft_landing`, whose force is that of all directions.
    """

    usual_weight = 1e-5

    kind: Literal["soft_landing"] = "soft_landing"

    def readings(self, parts: ModelParts) -> Iterable[Reading]:
        return [*super().readings(parts), *_forces(parts)]

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.while_moving(step.xp.sum(step.times.landed * model.foot_forces(step)))


class Stumble(CostTerm):
    """1 if a foot hits something steep, otherwise 0: the contacts' force F on it in the last physics step has
    ‖F_xy‖ > ratio |F_z|. On native and warp, which `auto` then takes.

    Source: Rudin et al., Learning to Walk in Minutes (2022), legged_gym's `stumble`.
    """

    needs = frozenset({"feet", "foot_colliders"})
    beyond = dict[EngineName, str].fromkeys(
        ("compiled", "mjx"),
        "the term `stumble` reads the direction of the contacts' forces, which native and warp alone tell",
    )

    kind: Literal["stumble"] = "stumble"
    ratio: float = Field(default=5.0, gt=0, le=100, description="Of the horizontal force to the vertical.")

    def readings(self, parts: ModelParts) -> Iterable[Reading]:
        return map(ContactNetForce, _feet_bodies(parts))

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        squares = model.foot_net_forces(step) ** 2
        is_steep = step.xp.sum(squares[:, :2], 1) > self.ratio**2 * squares[:, 2]
        return step.xp.where(step.xp.any(is_steep), 1.0, 0.0)


def _forces(parts: ModelParts) -> list[Reading]:
    return [ContactForce(body) for body in _feet_bodies(parts)]


def _feet_bodies(parts: ModelParts) -> Iterable[str]:
    """The bodies whose geoms are the feet's."""
    colliders = parts.model.colliders or {}
    return dict.fromkeys(colliders[geom][0] for geoms in parts.feet_colliders.values() for geom in geoms)


FootObservation = FootHeight | FootVelocity | FootContact | FootContactForce | FootAirTime
FootReward = (
    AirTime | FootClearance | FootSwingHeight | SwingHeight | FootGait | FootSlip | SoftLanding | Stumble
)
