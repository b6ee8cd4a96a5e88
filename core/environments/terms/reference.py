"""What a body is to follow: clips, where in them an episode begins, and how far the policy sees ahead."""

from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from core.clips.options import ClipChoice
from core.documents import Strict
from core.environments.terms.inventory import Inventory
from core.environments.terms.term import Array, Name
from core.patterns import PATTERNS, Patterns, matching

MOST_AHEAD = 50
_MOST_CHOICES = 256
# Every compiled program holds the frames of its job: float32, and of each body a position, an orientation and
# two velocities.
_MOST_BYTES, _NUMBER_BYTES, _OF_A_BODY = 256 * 10**6, 4, 3 + 4 + 3 + 3


class Ahead(Strict):
    """The frames that the term `reference` shows: the next one, and others after it."""

    frames: int = Field(default=3, ge=1, le=MOST_AHEAD, description="How many, with the next one.")
    every_s: float = Field(default=0.1, gt=0, le=10, description="From one to the following, in s.")

    def steps(self, control_step_s: float) -> list[int]:
        """Of each frame how many control steps it is ahead."""
        apart = max(1, round(self.every_s / control_step_s))
        return [1 + apart * number for number in range(self.frames)]


class Uniform(Strict):
    """Every moment of every clip is as likely, times the weight of the clip's choice."""

    kind: Literal["uniform"] = "uniform"


class Adaptive(Strict):
    """Moments before those at which episodes fail are likelier.

    A clip is cut into parts. The level of a part is how often a step in it fails, and counts for the parts
    before it, too: p_i ∝ Σ_k decay^k level_(i+k), mixed with the uniform distribution.
    Source: Liao et al., BeyondMimic (2025), section "adaptive sampling".
    """

    kind: Literal["adaptive"] = "adaptive"
    part_s: float = Field(default=1.0, ge=0.1, le=60, description="The length of a part, in s.")
    uniform: float = Field(
        default=0.2, gt=0, le=1, description="The share of starts that are uniform, whatever has failed."
    )
    decay: float = Field(
        default=0.5, ge=0, lt=1, description="What a failure counts for the part before, beside its own."
    )
    memory: float = Field(
        default=0.9, ge=0, lt=1, description="The share of the counts that an update keeps of those before."
    )


AnySampling = Annotated[Uniform | Adaptive, Field(discriminator="kind")]


class Reference(Strict):
    """What the body follows. An episode begins where a clip is at some moment, moves on with that clip, and
    is cut off at the clip's end, which is no failure. The noise of its start is that of `reset`.
    """

    clips: Annotated[list[ClipChoice], Field(min_length=1, max_length=_MOST_CHOICES)] = Field(
        description="Clips of the body: recordings that `POST /clips` took."
    )
    ahead: Ahead = Field(default=Ahead(), description="What the policy sees of the reference.")
    random_phase: float = Field(
        default=1.0,
        ge=0,
        le=1,
        description="The share of the episodes that begin at any moment of a clip; the others begin at its "
        "beginning.",
    )
    sampling: AnySampling = Field(default=Adaptive(), description="How these moments are drawn.")
    bodies: Patterns | None = Field(
        default=None, description=f"The bodies that are compared; null: all that joints move. {PATTERNS}"
    )
    anchor: Name | None = Field(
        default=None,
        description="The body about which others are compared: where it is on the ground, and where it "
        "heads, does not count for them. null: the root.",
    )
    end_effectors: Patterns | None = Field(
        default=None,
        description=f"Such as hands and feet; null: the compared bodies that carry no other. {PATTERNS}",
    )


class Frame(NamedTuple):
    """The body in one frame of a reference, or in several, which are the first axis.

    qpos: [nq]. qvel: [nv]. Of the bodies that `ModelIndex.followed` names: positions [bodies, 3] in m,
    orientations [bodies, 4] as unit quaternions, linear_velocities [bodies, 3] in m/s and angular_velocities
    [bodies, 3] in rad/s, all in the world's frame.
    """

    qpos: Array
    qvel: Array
    positions: Array
    orientations: Array
    linear_velocities: Array
    angular_velocities: Array


class Following(NamedTuple):
    """The reference in a step. now: the frame that the body is to be in after it. ahead: those that the
    policy sees next. share: which part of the way from the episode's start to the clip's end it is, []."""

    now: Frame
    ahead: Frame
    share: Array


def compared_bodies(reference: Reference, model: Inventory) -> list[str]:
    """The names of the bodies that are compared, in the model's order."""
    if reference.bodies is not None:
        return matching(reference.bodies, model.bodies[1:])
    moved = {joint.body for joint in model.joints}
    return [body for body in model.bodies if body in moved]


def too_many_frames(num_frames: int, num_positions: int, num_velocities: int, num_bodies: int) -> str | None:
    """A sentence where a job has no room for so many frames.

    num_positions, num_velocities: nq and nv of the model. num_bodies: those that frames hold.
    """
    of_a_frame = (num_positions + num_velocities + num_bodies * _OF_A_BODY) * _NUMBER_BYTES
    if num_frames * of_a_frame <= _MOST_BYTES:
        return None
    return (
        f"The clips have {num_frames:,} frames at the rate of the control steps, and a job has room for "
        f"{_MOST_BYTES // of_a_frame:,} ({_MOST_BYTES / 1e6:,.0f} MB): choose fewer by `names`, cut them by "
        "`from_s` and `to_s`, compare fewer `bodies`, or make control steps longer (`n_frames`)."
    )
