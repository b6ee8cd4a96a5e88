"""What becomes of a model that was refused after its upload had been answered, in each of the stores."""

from datetime import timedelta

import pytest

from core.adapters.memory_queue import MemoryJobQueue
from core.errors import ModelNotFound
from core.models import library
from core.models.record import ModelRecord, ModelStatus
from core.storage import keys
from core.storage.objects import ObjectStore
from tests.unit.environments.mjcf.probe import XML
from tests.unit.jobs.making import NOON

DAY = timedelta(days=1)


def kept(objects: ObjectStore, status: ModelStatus, body: bytes) -> ModelRecord:
    """A model that was uploaded at noon, and refused an hour later if it was."""
    record = ModelRecord(
        id=library.identity(body), status=status, media_type="", size=len(body), created_at=NOON
    )
    if status == "refused":
        told = {"message": "It has no actuators.", "refused_at": NOON + timedelta(hours=1)}
        record = record.model_copy(update=told)
    else:
        objects.put(keys.model_source(record.id), body)
    library.keep(record, objects)
    return record


def tidied(objects: ObjectStore, after: timedelta, queue: MemoryJobQueue | None = None) -> int:
    return library.tidy(objects=objects, queue=queue or MemoryJobQueue(), now=NOON + after)


def test_a_refusal_can_be_asked_for_for_a_day_and_is_then_forgotten(objects: ObjectStore) -> None:
    refused = kept(objects, "refused", XML)
    assert tidied(objects, DAY + timedelta(minutes=59)) == 0
    assert library.find(refused.id, objects).message == "It has no actuators."
    assert tidied(objects, DAY + timedelta(minutes=61)) == 1
    with pytest.raises(ModelNotFound):
        library.find(refused.id, objects)
    assert list(objects.list("")) == []


def test_nothing_of_a_model_that_was_not_refused_is_ever_removed(objects: ObjectStore) -> None:
    for status in ("ready", "validating"):
        kept(objects, status, status.encode())
    before = {info.key: objects.get(info.key) for info in objects.list("")}
    assert tidied(objects, 1000 * DAY) == 0
    assert {info.key: objects.get(info.key) for info in objects.list("")} == before


def test_a_refused_model_that_was_sent_again_is_none(objects: ObjectStore) -> None:
    refused, queue = kept(objects, "refused", XML), MemoryJobQueue()
    library.add(XML, "application/xml", objects=objects, queue=queue, now=NOON + DAY)
    assert queue.take_model() == refused.id
    assert tidied(objects, 1000 * DAY, queue) == 0
    assert library.find(refused.id, objects).status == "validating"
    assert objects.get(keys.model_source(refused.id)) == XML


def test_a_model_that_waits_and_was_lost_is_queued_again(objects: ObjectStore) -> None:
    waiting, queue = kept(objects, "validating", XML), MemoryJobQueue()
    kept(objects, "ready", b"another")
    tidied(objects, DAY, queue)
    assert (queue.take_model(), queue.take_model()) == (waiting.id, None)


def test_a_record_that_cannot_be_read_hides_no_other(objects: ObjectStore) -> None:
    objects.put(keys.model_record(f"sha256:{'0' * 64}"), b'{"status": "of another version"}')
    kept(objects, "refused", XML)
    assert tidied(objects, 2 * DAY) == 1
