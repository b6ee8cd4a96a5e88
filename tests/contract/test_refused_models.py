"""What becomes of a model that was refused after its upload had been answered, with each object store."""

from datetime import timedelta

import pytest
from sqlalchemy import update

from core.adapters.postgres.engine import connect_postgres
from core.adapters.postgres.tables import models
from core.errors import ModelNotFound
from core.jobs.reconciliation import Reconciler
from core.jobs.store import JobStore
from core.storage import keys
from core.storage.objects import ObjectStore
from core.uploads import library
from core.uploads.record import UploadStatus
from core.user_models.record import ModelRecord
from tests.in_memory import MemoryJobQueue
from tests.models import add, identity
from tests.unit.environments.mjcf.probe import XML
from tests.unit.jobs.making import NOON

DAY = timedelta(days=1)


def kept(jobs: JobStore, objects: ObjectStore, status: UploadStatus, body: bytes) -> ModelRecord:
    """A model that was uploaded at noon, and refused an hour later if it was."""
    record = ModelRecord(id=identity(body), status=status, media_type="", size=len(body), created_at=NOON)
    if status == "refused":
        told = {"message": "It has no actuators.", "refused_at": NOON + timedelta(hours=1)}
        record = record.model_copy(update=told)
    else:
        objects.put(keys.model_source(record.id), body)
    jobs.models.add(record)
    return record


def tidied(jobs: JobStore, objects: ObjectStore, after: timedelta) -> int:
    return library.tidy(store=jobs.models, objects=objects, now=NOON + after)


def test_a_refusal_can_be_asked_for_for_a_day_and_is_then_forgotten(
    jobs: JobStore, objects: ObjectStore
) -> None:
    refused = kept(jobs, objects, "refused", XML)
    assert tidied(jobs, objects, DAY + timedelta(minutes=59)) == 0
    assert library.find(refused.id, jobs.models).message == "It has no actuators."
    assert tidied(jobs, objects, DAY + timedelta(minutes=61)) == 1
    with pytest.raises(ModelNotFound):
        library.find(refused.id, jobs.models)
    assert list(objects.list("")) == []


def test_nothing_of_a_model_that_was_not_refused_is_ever_removed(
    jobs: JobStore, objects: ObjectStore
) -> None:
    for status in ("ready", "validating"):
        kept(jobs, objects, status, status.encode())
    before = {info.key: objects.get(info.key) for info in objects.list("")}, jobs.models.all()
    assert tidied(jobs, objects, 1000 * DAY) == 0
    assert ({info.key: objects.get(info.key) for info in objects.list("")}, jobs.models.all()) == before


def test_a_refused_model_that_was_sent_again_is_none(jobs: JobStore, objects: ObjectStore) -> None:
    refused, queue = kept(jobs, objects, "refused", XML), MemoryJobQueue()
    add(XML, store=jobs.models, objects=objects, queue=queue, now=NOON + DAY)
    assert queue.take_upload() == ("model", refused.id)
    assert tidied(jobs, objects, 1000 * DAY) == 0
    assert library.find(refused.id, jobs.models).status == "validating"
    assert objects.get(keys.model_source(refused.id)) == XML


def test_a_model_that_waits_and_was_lost_is_queued_again(jobs: JobStore, objects: ObjectStore) -> None:
    waiting, queue = kept(jobs, objects, "validating", XML), MemoryJobQueue()
    kept(jobs, objects, "ready", b"another")
    reconciler = Reconciler(jobs, queue, timedelta(seconds=15))
    reconciler.run_once()  # The queue had never heard of it.
    assert (queue.take_upload(), queue.take_upload()) == (("model", waiting.id), None)
    # A worker that took it was killed: the queue does not know it any more.
    for _ in range(2):
        reconciler.run_once()
    assert (queue.take_upload(), queue.take_upload()) == (("model", waiting.id), None)


def test_a_record_that_cannot_be_read_is_shown_as_refused_and_not_forgotten(
    jobs: JobStore, database_url: str, objects: ObjectStore
) -> None:
    other = kept(jobs, objects, "ready", b"of another version")
    refused = kept(jobs, objects, "refused", XML)
    with connect_postgres(database_url, pool_size=0).begin() as connection:
        connection.execute(update(models).where(models.c.id == other.id).values(status="glowing"))
    assert {record.id: record.status for record in jobs.models.all()} == {
        refused.id: "refused",
        other.id: "refused",
    }
    assert tidied(jobs, objects, 2 * DAY) == 1
    assert [record.id for record in jobs.models.all()] == [other.id]
