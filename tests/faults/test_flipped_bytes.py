"""Bytes that are flipped on the way to the object store and back: seen, and asked for again."""

import hashlib
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path

import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.adapters.s3.connection import connect_s3
from core.adapters.s3.objects import S3ObjectStore
from core.errors import ObjectNotFound, StorageUnavailable
from core.jobs import feeds
from core.jobs.attempts import Claim
from core.jobs.status import JobStatus
from core.reasons import Reason
from core.storage.objects import ObjectStore
from gaitway.service.embedded.processes import free_ports
from gaitway.service.embedded.weed import REGION, Weed
from tests.contract.recording import NOW, artifact, held, queued_job, say
from tests.faults.campaign.proxy import Mode, Proxies, Proxy
from tests.feeds import read_feed
from tests.in_memory import MemoryObjectStore
from worker.supervision.starting_point import write_task

BODY = bytes(range(256)) * 400


@contextmanager
def proxied(weed: Weed) -> Iterator[Proxy]:
    proxies = Proxies()
    [here] = free_ports(1)
    yield proxies.add("weed", here, int(weed.endpoint.rpartition(":")[2]))
    proxies.close()


def behind(proxy: Proxy, weed: Weed) -> S3ObjectStore:
    address = f"127.0.0.1:{proxy.here}"
    keys = (weed.access_key, weed.secret_key)
    return S3ObjectStore(
        connect_s3(address, *keys, secure=False, region=REGION, retries=0, timeout_s=0.5), weed.bucket
    )


@pytest.fixture
def proxy(weed: Weed) -> Iterator[Proxy]:
    with proxied(weed) as proxy:
        yield proxy


@pytest.fixture
def beyond(proxy: Proxy, weed: Weed, object_store: S3ObjectStore) -> S3ObjectStore:
    """The object store behind the proxy; `object_store` is the same one, without it."""
    return behind(proxy, weed)


@pytest.mark.parametrize("size", [len(BODY), 9 * 2**20])
def test_an_upload_is_refused_or_whole(
    proxy: Proxy, beyond: S3ObjectStore, object_store: S3ObjectStore, tmp_path: Path, size: int
) -> None:
    """SeaweedFS does not compare the SHA-256 that a request is signed with; it does compare an MD5."""
    body = (BODY * (size // len(BODY) + 1))[:size]
    (tmp_path / "file").write_bytes(body)
    proxy.mode = Mode.FLIP
    for number in range(5):
        with suppress(StorageUnavailable):
            beyond.put(f"put-{number}", body)
        with suppress(StorageUnavailable):
            beyond.put_file(f"file-{number}", tmp_path / "file")
        for key in (f"put-{number}", f"file-{number}"):
            with suppress(ObjectNotFound):
                assert object_store.get(key) == body


class TakesTheCheckAway(Proxy):
    """Flips a bit of the body, and one in the name of the header with the body's MD5."""

    def _flipped(self, piece: bytes) -> bytes:
        return piece.replace(b"Content-MD5", b"Content-MD4").replace(b"a body", b"a cody")


def test_an_upload_whose_check_is_lost_on_the_way_is_refused(
    weed: Weed, object_store: S3ObjectStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.faults.campaign.proxy.Proxy", TakesTheCheckAway)
    with proxied(weed) as proxy:
        proxy.mode = Mode.FLIP
        with pytest.raises(StorageUnavailable):
            behind(proxy, weed).put("key", b"a body")
    with pytest.raises(ObjectNotFound):
        object_store.get("key")


def test_an_answer_that_makes_no_sense_is_an_outage(
    proxy: Proxy, beyond: S3ObjectStore, object_store: S3ObjectStore
) -> None:
    for number in range(30):
        object_store.put(f"jobs/{number}", b"a body")
    proxy.mode = Mode.FLIP
    for _ in range(25):  # Each flips other bits.
        for ask in (beyond.info, beyond.get, lambda key: list(beyond.list(key))):
            with suppress(StorageUnavailable, ObjectNotFound):
                ask("jobs/1")


class FlipsOnce(MemoryObjectStore):
    """The last byte of what is read first is another one."""

    has_flipped = False

    def get(self, key: str) -> bytes:
        body = super().get(key)
        if self.has_flipped:
            return body
        self.has_flipped = True
        return body[:-1] + bytes([body[-1] ^ 1])

    def open(
        self, key: str, start: int = 0, length: int | None = None, *, size: int | None = None
    ) -> AbstractContextManager[Iterator[bytes]]:
        return nullcontext(iter([self.get(key)]))


class Flips(MemoryObjectStore):
    """Another byte is another one at each reading."""

    num_read = 0

    def get(self, key: str) -> bytes:
        body = bytearray(super().get(key))
        self.num_read += 1
        body[self.num_read % len(body)] ^= 1
        return bytes(body)


def ended_with_a_line(job_store: PostgresJobStore, objects: ObjectStore) -> str:
    """The id of a job whose feeds lie in the object store."""
    job = held(job_store, queued_job())
    say(job_store, job, "a line")
    job_store.save(job.ended(JobStatus.FAILED, Reason.TRAINING_CRASHED, "", NOW))
    feeds.compact(store=job_store, objects=objects)
    return job.id


def test_a_part_of_a_feed_that_was_flipped_on_the_way_is_read_again(job_store: PostgresJobStore) -> None:
    objects = FlipsOnce()
    job = ended_with_a_line(job_store, objects)
    [line] = read_feed(job, "logs", store=job_store, objects=objects)
    assert objects.has_flipped
    assert line.data == {"text": "a line"}


def test_a_part_of_a_feed_is_not_read_with_other_bytes(job_store: PostgresJobStore) -> None:
    objects = Flips()
    job = ended_with_a_line(job_store, objects)
    with pytest.raises(StorageUnavailable, match="SHA-256"):
        read_feed(job, "logs", store=job_store, objects=objects)


def test_a_part_of_a_feed_that_is_damaged_at_rest_is_told_as_such(
    job_store: PostgresJobStore, object_store: S3ObjectStore
) -> None:
    job = ended_with_a_line(job_store, object_store)
    [found] = object_store.list(f"jobs/{job}/logs/")
    body = object_store.get(found.key)
    object_store.put(found.key, body[:-2] + b"!\n")
    [note] = read_feed(job, "logs", store=job_store, objects=object_store)
    assert (note.id, note.kind) == ("1", "note")
    assert note.data == {"text": "Entry 1 of this feed was damaged in the object store."}
    object_store.put(found.key, body)  # From a back-up.
    [line] = read_feed(job, "logs", store=job_store, objects=object_store)
    assert line.data == {"text": "a line"}


def test_a_checkpoint_that_is_whole_at_the_store_is_read_again(
    job_store: PostgresJobStore, tmp_path: Path
) -> None:
    objects = FlipsOnce()
    job = held(job_store, queued_job())
    claim = Claim(job.id, 1, job.token, job_store, objects)
    objects.put("checkpoint", BODY)
    facts = {"role": "checkpoint", "step": 5, "size": len(BODY), "sha256": hashlib.sha256(BODY).hexdigest()}
    saved, _ = claim.publish((artifact("checkpoint", key="checkpoint", **facts),), 1)
    assert write_task(saved, claim, "cpu", tmp_path) == []
    assert (tmp_path / "start.msgpack").read_bytes() == BODY
    assert job_store.get(job.id) == saved
