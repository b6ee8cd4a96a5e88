"""How often a choice is made at random, for algorithms that choose among a few actions."""

from typing import Annotated, Literal

from pydantic import Field

from core.documents import Strict
from core.errors import Problem

Share = Annotated[float, Field(ge=0, le=1)]
Shape = Literal["linear", "exponential"]
# The place in a job.
WHERE = "/algorithm/epsilon"


class EpsilonSchedule(Strict):
    """The share of choices that are made at random: from `start` to `end`, and then it stays."""

    start: Share = 0.5
    end: Share = 0.05
    decay_decisions: int | None = Field(
        default=None,
        ge=1,
        le=10**12,
        description="Decisions until `end`, those of a learner in all of its environments. By default: all "
        "of the run's.",
    )
    shape: Shape = "linear"

    def problems(self, num_decisions: int, *ends: float | None) -> list[Problem]:
        """What is wrong with it in a run of this number of decisions; ends: other values of start and end
        that a part of the run takes."""
        problems = list[Problem]()
        if self.decay_decisions is not None and self.decay_decisions > num_decisions:
            detail = (
                f"decay_decisions = {self.decay_decisions:,}, and the run has {num_decisions:,} decisions "
                "of an agent."
            )
            problems.append(Problem(f"{WHERE}/decay_decisions", detail))
        if self.shape == "exponential" and 0.0 in (self.start, self.end, *ends):
            detail = "An exponential schedule of epsilon never comes from or to 0; take a small number."
            problems.append(Problem(f"{WHERE}/shape", detail))
        return problems
