"""Compares the record and the bucket after a disaster, and makes them agree again. For `gaitway recover`.

Either may have been restored to an older moment, or lost. What one of them still has is taken over; what
both have lost is marked as lost, so that nobody waits for it.
"""

from collections.abc import Iterator

from core.jobs.recovery.bucket import jobs_of_the_bucket
from core.jobs.recovery.finding import Finding
from core.jobs.recovery.losses import losses_of_the_record
from core.jobs.recovery.models import models
from core.jobs.store import JobStore
from core.storage.objects import ObjectStore


def findings(*, store: JobStore, objects: ObjectStore) -> Iterator[Finding]:
    """All findings. Act on each before the next is taken, or on none: later ones depend on earlier ones.

    Beside a running service, nothing is reported that is merely in progress.
    """
    yield from models(store, objects)
    yield from jobs_of_the_bucket(store, objects)
    yield from losses_of_the_record(store, objects)
