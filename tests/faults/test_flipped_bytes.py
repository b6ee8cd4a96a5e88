"""Bytes that are flipped on the way to the object store and back: seen, and asked for again."""

import hashlib
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext, suppress
from pathlib import Path

import pytest

from core.adapters.connect import connect_s3
from core.adapters.memory_objects import MemoryObjectStore
from core.adapters.postgres.jobs import PostgresJobStore
from core.adapters.s3_objects import S3ObjectStore
from core.errors import ObjectNotFound, StorageUnavailable
from core.jobs import feeds
from core.jobs.attempts import Holding
from core.jobs.status import JobStatus, Reason
from gaitway.embedded.processes import free_ports
from gaitway.embedded.weed import Weed
from gaitway.embedded.weed_environment import REGION
from tests.contract.recording import NOW, artifact, held, queued_job, say
from tests.faults.campaign.proxy import Mode, Proxies, Proxy
from worker.starting_point import write_task

BODY = bytes(range(256)) * 400


@pytest.fixture
def proxy(weed: Weed) -> Iterator[Proxy]:
    proxies = Proxies()
    [here] = free_ports(1)
    yield proxies.add("weed", here, int(weed.endpoint.rpartition(":")[2]))
    proxies.close()


@pytest.fixture
def beyond(proxy: Proxy, weed: Weed, object_store: S3ObjectStore) -> S3ObjectStore:
    """The object store behind the proxy; `object_store` is the same one, without it."""
    address = f"127.0.0.1:{proxy.here}"
    keys = (weed.access_key, weed.secret_key)
    return S3ObjectStore(
        connect_s3(address, *keys, secure=False, region=REGION, retries=0, timeout_s=0.5), weed.bucket
    )


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
        self, key: str, start: int = 0, length: int | None = None
    ) -> AbstractContextManager[Iterator[bytes]]:
        return nullcontext(iter([self.get(key)]))


def test_a_part_of_a_feed_is_not_read_with_other_bytes(job_store: PostgresJobStore) -> None:
    objects = FlipsOnce()
    job = held(job_store, queued_job())
    say(job_store, job, "a line")
    job_store.save(job.ended(JobStatus.FAILED, Reason.TRAINING_CRASHED, "", NOW))
    feeds.compact(store=job_store, objects=objects)
    with pytest.raises(StorageUnavailable, match="SHA-256"):
        feeds.read(job.id, "logs", store=job_store, objects=objects)
    [line] = feeds.read(job.id, "logs", store=job_store, objects=objects)
    assert line.data == {"text": "a line"}


def test_a_checkpoint_that_is_whole_at_the_store_is_read_again(
    job_store: PostgresJobStore, tmp_path: Path
) -> None:
    objects = FlipsOnce()
    job = held(job_store, queued_job())
    holding = Holding(job.id, 1, job.token, job_store, objects)
    objects.put("checkpoint", BODY)
    facts = {"role": "checkpoint", "step": 5, "size": len(BODY), "sha256": hashlib.sha256(BODY).hexdigest()}
    saved, _ = holding.publish((artifact("checkpoint", key="checkpoint", **facts),), 1)
    assert write_task(saved, holding, "cpu", tmp_path) == []
    assert (tmp_path / "start.msgpack").read_bytes() == BODY
    assert job_store.get(job.id) == saved
