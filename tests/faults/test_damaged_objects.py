"""Objects that the real store has and cannot give, while it gives others: damaged, and no outage."""

import hashlib
import os
import random
import signal
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import httpx
import pytest

from api.app import create_app
from core.adapters.postgres.store import PostgresJobStore
from core.adapters.s3.connection import connect_s3
from core.adapters.s3.objects import S3ObjectStore
from core.errors import JobFailed, ObjectDamaged, ObjectNotFound, StorageUnavailable
from core.jobs import feeds
from core.jobs.attempts import Claim
from core.jobs.job import Job
from core.jobs.status import JobStatus
from core.reasons import Reason
from core.storage import keys
from core.uploads import library
from core.user_models.record import MODELS
from gaitway.service.embedded.weed import REGION, Weed
from tests.api.conftest import NOWHERE, serving
from tests.contract.recording import NOW, artifact, held, model, queued_job, say
from tests.extra import extra
from tests.faults.campaign.proxy import Proxy
from tests.faults.campaign.volumes import flip_byte
from tests.faults.test_flipped_bytes import proxied
from tests.feeds import read_feed
from tests.in_memory import MemoryJobQueue
from worker.supervision.starting_point import write_task

# Finding out that an object is damaged takes about ten seconds; a training goes on within these.
WITHIN_S = 15.0
MIB = 2**20


def body_of(size: int, seed: int = 0) -> bytes:
    return random.Random(seed).randbytes(size)


def damage(weed: Weed, body: bytes) -> None:
    assert flip_byte(weed._folder / "data", body) >= 1


def facts(role: str, body: bytes, step: int | None = None) -> dict[str, object]:
    return {"role": role, "step": step, "size": len(body), "sha256": hashlib.sha256(body).hexdigest()}


def with_checkpoints(store: PostgresJobStore, objects: S3ObjectStore, bodies: dict[int, bytes]) -> Claim:
    job = held(store, queued_job())
    claim = Claim(job.id, 1, job.token, store, objects)
    files = []
    for step, body in bodies.items():
        key = f"jobs/{job.id}/{step}"
        objects.put(key, body)
        files.append(artifact(f"checkpoint-{step}", key=key, **facts("checkpoint", body, step)))
    claim.publish(tuple(files), len(files))
    return claim


@pytest.mark.parametrize("size", [100, *extra(3 * MIB, 9 * MIB)])
def test_a_flipped_byte_in_the_volume_is_damage_within_seconds(
    weed: Weed, object_store: S3ObjectStore, size: int
) -> None:
    body = body_of(size)
    object_store.put("jobs/1/hurt", body)
    object_store.put("jobs/1/whole", body_of(size, 1))
    damage(weed, body)
    began = time.monotonic()
    with pytest.raises(ObjectDamaged, match="while it gives others"):
        object_store.get("jobs/1/hurt")
    assert time.monotonic() - began < WITHIN_S
    assert object_store.get("jobs/1/whole") == body_of(size, 1)
    # The next reader hears at once, and a new upload is read.
    began = time.monotonic()
    with pytest.raises(ObjectDamaged):
        object_store.get("jobs/1/hurt")
    assert time.monotonic() - began < 1
    object_store.put("jobs/1/hurt", body)
    assert object_store.get("jobs/1/hurt") == body


def test_a_store_that_says_nothing_at_all_is_an_outage(weed: Weed, object_store: S3ObjectStore) -> None:
    object_store.put("jobs/1/a", b"x")
    client = connect_s3(
        weed.endpoint, weed.access_key, weed.secret_key, secure=False, region=REGION, retries=0, timeout_s=1
    )
    assert weed.process.pid is not None
    os.kill(weed.process.pid, signal.SIGSTOP)
    # The signal is sent at once; the last of the process's threads stands still a moment later.
    os.waitid(os.P_PID, weed.process.pid, os.WSTOPPED | os.WNOWAIT)
    try:
        with pytest.raises(StorageUnavailable):
            S3ObjectStore(client, weed.bucket).get("jobs/1/a")
    finally:
        os.kill(weed.process.pid, signal.SIGCONT)
    assert object_store.get("jobs/1/a") == b"x"


class Drips(Proxy):
    """Answers with large bodies come a few bytes at a time, for ever; others as they are."""

    async def _pass_on(self, source, sink, said, *, is_answer):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
        import asyncio

        while piece := await self._next(source):
            if is_answer and len(piece) > 32 * 1024:
                for at in range(len(piece)):
                    sink.write(piece[at : at + 1])
                    await sink.drain()
                    await asyncio.sleep(0.2)
            sink.write(piece)
            await sink.drain()


@pytest.fixture
def dripping(weed: Weed, monkeypatch: pytest.MonkeyPatch) -> Iterator[S3ObjectStore]:
    """The object store, whose large objects come a byte now and then."""
    monkeypatch.setattr("tests.faults.campaign.proxy.Proxy", Drips)
    with proxied(weed) as proxy:
        client = connect_s3(
            f"127.0.0.1:{proxy.here}", weed.access_key, weed.secret_key, secure=False, region=REGION
        )
        yield S3ObjectStore(client, weed.bucket)


@pytest.mark.extra
def test_an_object_that_is_served_slowly_for_ever_is_damaged(
    dripping: S3ObjectStore, object_store: S3ObjectStore
) -> None:
    object_store.put("jobs/1/slow", body_of(MIB))
    began = time.monotonic()
    with pytest.raises(ObjectDamaged):
        dripping.get("jobs/1/slow")
    assert time.monotonic() - began < WITHIN_S


def test_a_job_resumes_from_the_checkpoint_before_a_damaged_one(
    weed: Weed, job_store: PostgresJobStore, object_store: S3ObjectStore, tmp_path: Path
) -> None:
    bodies = {step: body_of(100_000, step) for step in (5, 10, 15)}
    claim = with_checkpoints(job_store, object_store, bodies)
    object_store.delete([f"jobs/{claim.job_id}/10"])
    damage(weed, bodies[15])
    began = time.monotonic()
    notes = write_task(job_store.get(claim.job_id), claim, "cpu", tmp_path)
    seconds = time.monotonic() - began
    print(f"A damaged newest checkpoint cost {seconds:.1f} s before the one before was there.")
    assert seconds < WITHIN_S
    assert (tmp_path / "start.msgpack").read_bytes() == bodies[5]
    assert notes == [
        "checkpoint-15 is damaged: the object store does not give its bytes, while it gives others.",
        "checkpoint-10 has gone from the object store.",
        "The run resumes from step 5.",
    ]
    assert [one.step for one in job_store.get(claim.job_id).artifacts] == [5]


def take_away(weed: Weed, objects: S3ObjectStore, key: str, body: bytes, how: str) -> None:
    match how:
        case "flipped":
            damage(weed, body)
        case "lost":
            objects.delete([key])
        case "shorter":
            objects.put(key, body[:-10])
        case "other bytes":
            objects.put(key, body[:-1] + bytes([body[-1] ^ 1]))
        case _:
            assert how == "slow"


WAYS = ["lost", "other bytes", *extra("flipped", "shorter", "slow")]


@pytest.mark.parametrize("how", WAYS)
@pytest.mark.parametrize("of", ["its own", *extra("another's, to resume", "another's, to act")])
def test_an_attempt_begins_with_the_checkpoint_before_in_seconds(
    weed: Weed,
    job_store: PostgresJobStore,
    object_store: S3ObjectStore,
    dripping: S3ObjectStore,
    tmp_path: Path,
    how: str,
    of: str,
) -> None:
    # The older one is small, so that it does not drip.
    bodies = {5: body_of(1000, 5), 10: body_of(100_000, 10)}
    claim = with_checkpoints(job_store, object_store, bodies)
    source = claim.job_id
    if of != "its own":
        wanted: dict[str, object] = {"resume_from": {"job": source}}
        if of == "another's, to act":
            wanted = {"kind": "rollout", "policy": {"kind": "checkpoint", "job": source}}
        job = held(job_store, queued_job(1, **wanted))
        claim = Claim(job.id, 1, job.token, job_store, object_store)
    take_away(weed, object_store, f"jobs/{source}/10", bodies[10], how)
    fresh = S3ObjectStore(object_store._client, object_store._bucket)
    claim = Claim(claim.job_id, 1, claim.token, job_store, dripping if how == "slow" else fresh)
    began = time.monotonic()
    notes = write_task(job_store.get(claim.job_id), claim, "cpu", tmp_path)
    assert time.monotonic() - began < WITHIN_S
    assert (tmp_path / "start.msgpack").read_bytes() == bodies[5]
    assert [note.split()[0] for note in notes] == ["checkpoint-10", "The" if of == "its own" else "Step"]


@pytest.mark.parametrize("how", WAYS)
def test_a_job_whose_model_cannot_be_read_says_what_to_do(
    weed: Weed,
    job_store: PostgresJobStore,
    object_store: S3ObjectStore,
    dripping: S3ObjectStore,
    tmp_path: Path,
    how: str,
) -> None:
    body = body_of(100_000, 6)
    digest = hashlib.sha256(body).hexdigest()
    job_store.models.add(model(f"sha256:{digest}"))
    key = keys.model_source(f"sha256:{digest}")
    object_store.put(key, body)
    environment = {"id": "mjcf", "options": {"model": f"sha256:{digest}"}}
    job = held(job_store, queued_job(environment=environment))
    take_away(weed, object_store, key, body, how)
    claim = Claim(job.id, 1, job.token, job_store, dripping if how == "slow" else object_store)
    began = time.monotonic()
    with pytest.raises(JobFailed, match="Delete it, and send it again") as failed:
        write_task(job_store.get(job.id), claim, "cpu", tmp_path)
    assert time.monotonic() - began < WITHIN_S
    assert failed.value.reason == Reason.BAD_MODEL
    began = time.monotonic()
    with pytest.raises(ObjectNotFound):  # As a validation and a preview read it.
        library.source(job_store.models.find(f"sha256:{digest}"), MODELS, claim.objects)
    assert time.monotonic() - began < WITHIN_S


@pytest.fixture
def api(job_store: PostgresJobStore, object_store: S3ObjectStore) -> Iterator[httpx.Client]:
    app = create_app(NOWHERE, store=job_store, queue=MemoryJobQueue(), objects=object_store)
    with serving(app) as port, httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=20) as http:
        yield http


def with_file(store: PostgresJobStore, objects: S3ObjectStore, body: bytes) -> Job:
    """An ended job with this video, and a feed that lies in the object store."""
    job = held(store, queued_job())
    say(store, job, "a line")
    key = f"jobs/{job.id}/video.mp4"
    objects.put(key, body)
    Claim(job.id, 1, job.token, store, objects).publish(
        (artifact("video.mp4", key=key, **facts("video", body)),), 1
    )
    store.save(store.get(job.id).ended(JobStatus.FAILED, Reason.TRAINING_CRASHED, "", NOW))
    feeds.compact(store=store, objects=objects)
    return store.get(job.id)


@pytest.mark.parametrize("size", [50_000, *extra(9 * MIB)])
def test_a_damaged_file_is_a_problem_of_its_own(
    weed: Weed, job_store: PostgresJobStore, object_store: S3ObjectStore, api: httpx.Client, size: int
) -> None:
    body = body_of(size, 3)
    job = with_file(job_store, object_store, body)
    damage(weed, body)
    for route in ("video", "artifacts/video.mp4"):
        answer = api.get(f"/jobs/{job.id}/{route}")
        assert answer.status_code == 404
        assert answer.json()["type"] == "/problems/object-damaged"
        assert "is damaged in the object store" in answer.json()["detail"]


@pytest.mark.parametrize("size", [50_000, 9 * MIB])
@pytest.mark.parametrize("how", ["shorter", "other bytes"])
def test_bytes_that_are_not_the_recorded_ones_are_never_a_whole_answer(
    job_store: PostgresJobStore, object_store: S3ObjectStore, api: httpx.Client, size: int, how: str
) -> None:
    body = body_of(size, 4)
    job = with_file(job_store, object_store, body)
    object_store.put(
        f"jobs/{job.id}/video.mp4", body[:-10] if how == "shorter" else body[:-1] + bytes([body[-1] ^ 1])
    )
    kinds = []
    for _ in range(2):
        try:
            answer = api.get(f"/jobs/{job.id}/video")
        except httpx.RemoteProtocolError:  # It broke off, as only the first of the large ones may.
            kinds.append("broken off")
            continue
        kinds.append(answer.json()["type"])
    assert kinds[1] == "/problems/object-damaged"
    if how == "shorter" or size < MIB:
        assert kinds[0] == "/problems/object-damaged"


@pytest.mark.parametrize(("role", "route"), [("checkpoint", "checkpoints/7"), ("policy", "policy")])
def test_a_checkpoint_or_a_policy_that_is_gone_is_a_problem_of_its_own(
    job_store: PostgresJobStore, object_store: S3ObjectStore, api: httpx.Client, role: str, route: str
) -> None:
    claim = with_checkpoints(job_store, object_store, {1: b"x"})
    file = artifact(f"{role}-7", key=f"jobs/{claim.job_id}/7", **facts(role, b"x", 7))
    claim.publish((file,), 5)
    answer = api.get(f"/jobs/{claim.job_id}/{route}")
    assert (answer.status_code, answer.json()["type"]) == (404, "/problems/object-not-found")


@pytest.mark.extra
@pytest.mark.parametrize("size", [50_000, 9 * MIB])
def test_a_file_that_is_served_slowly_for_ever_is_refused_in_seconds(
    job_store: PostgresJobStore, object_store: S3ObjectStore, dripping: S3ObjectStore, size: int
) -> None:
    job = with_file(job_store, object_store, body_of(size, 8))
    app = create_app(NOWHERE, store=job_store, queue=MemoryJobQueue(), objects=dripping)
    with serving(app) as port, httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=20) as http:
        began = time.monotonic()
        with suppress(httpx.RemoteProtocolError):  # A large one may have begun.
            assert http.get(f"/jobs/{job.id}/video").json()["type"] == "/problems/object-damaged"
        assert time.monotonic() - began < WITHIN_S
        assert http.get(f"/jobs/{job.id}/video").json()["type"] == "/problems/object-damaged"


def test_a_feed_with_a_lost_chunk_shows_the_rest_and_says_what_is_missing(
    job_store: PostgresJobStore, object_store: S3ObjectStore, api: httpx.Client
) -> None:
    job = with_file(job_store, object_store, b"x")
    [chunk] = object_store.list(f"jobs/{job.id}/events/")
    entries = len(object_store.get(chunk.key).splitlines())
    for found in [*object_store.list(f"jobs/{job.id}/events/"), *object_store.list(f"jobs/{job.id}/logs/")]:
        object_store.delete([found.key])
    said = api.get(f"/jobs/{job.id}/events?follow=false").text
    assert f"Entries 1 to {entries} of this feed were lost from the object store." in said
    assert "lost from the object store" in api.get(f"/jobs/{job.id}/logs").text
    assert api.get(f"/jobs/{job.id}/metrics").json()["rows"] == []
    assert api.get(f"/jobs/{job.id}/metrics?points=10").json()["rows"] == []


@pytest.mark.extra
def test_a_feed_with_a_damaged_chunk_shows_the_rest_within_seconds(
    weed: Weed, job_store: PostgresJobStore, object_store: S3ObjectStore, api: httpx.Client
) -> None:
    job = with_file(job_store, object_store, b"x")
    [chunk] = object_store.list(f"jobs/{job.id}/logs/")
    damage(weed, object_store.get(chunk.key))
    fresh = S3ObjectStore(object_store._client, object_store._bucket)
    began = time.monotonic()
    [note] = read_feed(job.id, "logs", store=job_store, objects=fresh)
    assert time.monotonic() - began < WITHIN_S
    assert note.data == {"text": "Entry 1 of this feed was damaged in the object store."}
    assert "status" in api.get(f"/jobs/{job.id}/events?follow=false").text


@pytest.mark.extra
def test_a_feed_whose_chunk_is_served_slowly_for_ever_shows_the_rest_within_seconds(
    job_store: PostgresJobStore, object_store: S3ObjectStore, dripping: S3ObjectStore
) -> None:
    job = held(job_store, queued_job())
    for number in range(40):
        say(job_store, job, f"{number} {body_of(4000, number).hex()}")
    job_store.save(job_store.get(job.id).ended(JobStatus.FAILED, Reason.TRAINING_CRASHED, "", NOW))
    feeds.compact(store=job_store, objects=object_store)
    began = time.monotonic()
    [note] = read_feed(job.id, "logs", store=job_store, objects=dripping)
    assert time.monotonic() - began < WITHIN_S
    assert note.data == {"text": "Entries 1 to 40 of this feed were damaged in the object store."}
