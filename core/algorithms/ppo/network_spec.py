"""The networks that PPO's policy may be, besides a plain perceptron."""

from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import Field

from core.documents import Strict
from core.environments.info import EnvironmentInfo
from core.errors import Problem, Rejected
from core.patterns import PATTERNS, Patterns, matching

LayerSizes = Annotated[list[Annotated[int, Field(ge=1, le=8192)]], Field(min_length=1, max_length=16)]
# [start, size] of neighbouring numbers of an observation.
Place = Annotated[
    tuple[Annotated[int, Field(ge=0, le=10**6)], Annotated[int, Field(ge=1, le=10**6)]], Field(strict=False)
]

REFERENCE = "reference.*"
_POINTER = "/algorithm/network"


class IntentionNetwork(Strict):
    """An encoder of what is to be done, and a decoder that moves the body (docs/training.md).

    The encoder turns its part of the observation into a normal distribution of a latent z, an intention. The
    decoder sees z and the rest of the observation, the body alone, and gives the action's distribution. In
    training z is sampled; in evaluations and videos it is the mean.
    """

    kind: Literal["intention"]
    latent: int = Field(default=60, ge=1, le=1024, description="How many numbers an intention has.")
    encoder: LayerSizes = [256, 256]
    decoder: LayerSizes = [256, 256]
    encoder_sees: Patterns | None = Field(
        default=None,
        description="The parts of the observation that the encoder sees, by the names of "
        "`GET /environments/{id}`; the decoder sees the others. null: those that begin with `reference`, or "
        f"`places` where these are given. {PATTERNS}",
    )
    places: Annotated[list[Place], Field(min_length=1, max_length=1000)] | None = Field(
        default=None,
        description="[start, size] of each of these parts in the observation; null: found by `encoder_sees`.",
    )
    kl_weight: float = Field(
        default=1e-3,
        ge=0,
        le=1e3,
        description="Weight in the loss of the divergence of z from a standard normal distribution, the mean "
        "over its numbers, in nats.",
    )
    kl_ramp_steps: int = Field(
        default=0,
        ge=0,
        le=10**12,
        description="Environment steps over which kl_weight rises from 0; 0: it is there from the first.",
    )
    smoothness_weight: float = Field(
        default=0.0,
        ge=0,
        le=1e3,
        description="Weight in the loss of the mean square by which z's mean moves from one action to the "
        "next within an episode.",
    )

    def placed(self, environment: EnvironmentInfo, group: str) -> Self:
        """The same with `places` in the environment's observation of this name; unchanged where its parts
        are not known.

        Raises Rejected where a pattern matches no part, where encoder or decoder would see nothing, and where
        `places` contradict the patterns.
        """
        parts = environment.spaces.group(group)
        if not parts:
            return self
        size = sum(part.size for part in parts)
        if self.encoder_sees is None and self.places is not None:
            return self.checked(self.places, size)
        names = list(dict.fromkeys(part.name for part in parts))
        patterns = self.encoder_sees or [REFERENCE]
        for number, pattern in enumerate(patterns):
            if not matching([pattern], names):
                place = "encoder_sees" if self.encoder_sees is None else f"encoder_sees/{number}"
                raise _refusal(
                    f"The encoder is to see {pattern!r}, and no part of the observation of {environment.id} "
                    f"is called so. There are: {', '.join(names)}.",
                    place,
                )
        seen = set(matching(patterns, names))
        found = _joined([(part.start, part.size) for part in parts if part.name in seen])
        if self.places is not None and _joined(self.places) != found:
            raise _refusal(
                f"`places` are {_shown(self.places)}, and `encoder_sees` has {_shown(found)} of the "
                "observation: leave `places` out.",
                "places",
            )
        return self.model_copy(update={"encoder_sees": patterns, "places": found}).checked(found, size)

    def checked(self, places: Sequence[tuple[int, int]], size: int) -> Self:
        """Itself. Raises Rejected where the places are not those of a part of an observation of this size."""
        ends = [0, *(start + length for start, length in sorted(places))]
        overlap = any(start < end for (start, _), end in zip(sorted(places), ends, strict=False))
        if overlap or ends[-1] > size:
            raise _refusal(
                f"The encoder's places {_shown(places)} overlap, or go beyond the {size} numbers of the "
                "observation.",
                "places",
            )
        if sum(length for _, length in places) == size:
            raise _refusal(
                "The encoder would see the whole observation, and the decoder nothing of the body: add terms "
                "of the body to the observation, or let the encoder see less.",
                "encoder_sees",
            )
        return self


def _joined(places: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """The same numbers in the fewest places, in their order."""
    joined = list[tuple[int, int]]()
    for start, size in sorted(places):
        if joined and sum(joined[-1]) == start:
            joined[-1] = (joined[-1][0], joined[-1][1] + size)
        else:
            joined.append((start, size))
    return joined


def _shown(places: Sequence[tuple[int, int]]) -> str:
    return ", ".join(f"{start} to {start + size - 1}" for start, size in places)


def _refusal(detail: str, place: str) -> Rejected:
    return Rejected(detail, [Problem(f"{_POINTER}/{place}", detail)])
