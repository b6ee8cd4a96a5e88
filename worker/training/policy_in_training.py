"""A policy while it is trained."""

from collections.abc import Callable
from dataclasses import dataclass

from core.jobs.spec import TrainSpec
from worker.training.event_writer import EventWriter


@dataclass(frozen=True)
class PolicyInTraining:
    """The policy of a training, or of one of its seeds.

    spec: of the training, or of the seed's own. events: where its files go. step: the environment steps that
    it has been trained for. content: the algorithm's own file of it as it is. seed: None where the training
    has a single one.
    """

    spec: TrainSpec
    events: EventWriter
    step: Callable[[], int]
    content: Callable[[], bytes]
    seed: int | None = None
