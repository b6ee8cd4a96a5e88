"""Writes data.json beside it: what version 0.1 itself left in Redis and in the object store.

    git archive 959d2bc | tar -x -C /tmp/v01
    PYTHONPATH=/tmp/v01 .venv/bin/python tests/unit/gaitway/version_01/make_fixture.py

Commit 959d2bc was the last one of version 0.1. Nothing here runs with any later one.
"""
# ruff: noqa: I001 # It does not know modules that are no longer here.

import base64
import json
import math
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from core.adapters.connect import connect_redis, connect_s3
from core.adapters.redis_jobs import RedisJobStore
from core.adapters.rq.queue import RQQueue
from core.adapters.s3.objects import S3ObjectStore
from core.environments.mjcf.inventory import Inventory
from core.jobs.attempts import Claim, claim_attempt, given_back
from core.jobs.cancellation import cancel
from core.jobs.durability import keep_record
from core.jobs.job import Job, utc_now
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.reasons import Reason
from core.jobs.store import Idempotency
from core.jobs.submission import submit
from core.user_models import library
from core.user_models.record import Description, ModelRecord
from core.storage import keys
from gaitway.service.embedded.valkey import Valkey
from gaitway.service.embedded.weed import Weed
from gaitway.service.embedded.weed_environment import REGION
from worker.protocol import Advanced, FileReady, Hello, Measured, Message, Noted, PhaseEnded, Started
from worker.supervision.outbox import Outbox

BEGAN = datetime(2026, 11, 1, 12, tzinfo=UTC)
LEASE = timedelta(hours=1)


class Service:
    """Version 0.1, and what happened in it."""

    def __init__(self, store: RedisJobStore, queue: RQQueue, objects: S3ObjectStore, spool: Path) -> None:
        self.store, self.queue, self.objects, self.spool = store, queue, objects, spool
        self.now = BEGAN
        self.ids: dict[str, str] = {}

    def submit(self, name: str, key: str | None = None, **fields: Any) -> Job:
        self.now += timedelta(minutes=10)
        spec = JOB_SPEC.validate_python(
            {"kind": "train", "environment": "inverted_pendulum", "name": name, **fields}
        )
        idempotency = None if key is None else Idempotency(key, f"fingerprint of {name}")
        job = submit(
            spec,
            store=self.store,
            queue=self.queue,
            objects=self.objects,
            now=self.now,
            idempotency=idempotency,
        )
        self.ids[name] = job.id
        return job

    def claim(self, job: Job) -> Claim:
        job = self.store.get(job.id)
        self.now += timedelta(minutes=1)
        claim = claim_attempt(
            job.id,
            job.next_attempt,
            "host:cpu",
            store=self.store,
            objects=self.objects,
            lease=LEASE,
            now=self.now,
        )
        assert claim is not None
        return claim

    @contextmanager
    def saying(self, claim: Claim, keep: int = 2) -> Iterator[Callable[[Message | str], None]]:
        outbox = Outbox(claim, self.spool, keep)
        yield outbox.put
        assert outbox.close(30)

    def file(self, name: str, body: bytes, **facts: Any) -> FileReady:
        (self.spool / name).write_bytes(body)
        return FileReady(name=name, path=name, **facts)

    def start(self, claim: Claim) -> None:
        with self.saying(claim) as say:
            say(Hello(pid=1234))
            say(Started(device="cpu", engine="native", details={"hyperparameters": {"num_envs": 64}}))
            say(PhaseEnded(name="compile", seconds=1.5))

    def checkpoint(self, claim: Claim, step: int) -> None:
        with self.saying(claim) as say:
            say(f"step {step}")
            say(Measured(step=step, values={"eval/episode_reward": step / 10, "training/loss": math.nan}))
            say(Advanced(step=step, total=1000, steps_per_second=50.0, eta_s=2.0, metrics={"reward": 1.0}))
            say(
                self.file(
                    f"checkpoint-{step}.msgpack",
                    f"checkpoint of step {step}".encode(),
                    role="checkpoint",
                    media_type="application/msgpack",
                    step=step,
                    metadata={"engine": "native"},
                )
            )


def succeed(service: Service) -> Job:
    job = service.submit("succeeded", labels={"team": "walkers"}, checkpoints={"keep": 2})
    claim = service.claim(job)
    service.start(claim)
    for step in (100, 200, 300):
        service.checkpoint(claim, step)
    with service.saying(claim) as say:
        say("a null \0, a snowman ☃ and a 🤖")
        say(Noted(text="Contacts were lost."))
        say(service.file("video.mp4", b"moving", role="video", media_type="video/mp4", step=300))
        say(
            service.file(
                "policy.msgpack", b"acting", role="policy", media_type="application/msgpack", step=300
            )
        )
    service.now += timedelta(minutes=5)
    claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "All 1,000 steps are done.", service.now)
    return job


def run_twice(service: Service) -> None:
    """Two attempts; the second one has a checkpoint of its own, and has dropped one of the first."""
    job = service.submit("running", labels={"team": "walkers"}, checkpoints={"keep": 2})
    first = service.claim(job)
    service.start(first)
    service.checkpoint(first, 100)
    service.checkpoint(first, 200)
    service.now += timedelta(minutes=5)
    lost = given_back(
        service.store.get(job.id), Reason.WORKER_LOST, "Worker host:cpu was silent.", service.now
    )
    service.store.save(lost)
    keep_record(lost, service.objects)
    second = service.claim(job)
    service.start(second)
    service.checkpoint(second, 300)


def others(service: Service, succeeded: Job) -> None:
    service.submit("queued", key="a key", priority="high")
    service.submit(
        "rollout",
        kind="rollout",
        policy={"kind": "checkpoint", "job": succeeded.id, "step": 300},
        num_episodes=2,
    )
    job = service.submit("cancelled")
    cancel(job.id, store=service.store, queue=service.queue, objects=service.objects, now=service.now)
    job = service.submit("cancelling")
    service.start(service.claim(job))
    cancel(job.id, store=service.store, queue=service.queue, objects=service.objects, now=service.now)
    job = service.submit("failed")
    claim = service.claim(job)
    service.start(claim)
    claim.end(JobStatus.FAILED, Reason.DIVERGED, "The loss is not finite.", service.now)
    service.claim(service.submit("starting", max_attempts=1))


def models(objects: S3ObjectStore) -> dict[str, str]:
    """One of each status, as `core.user_models.library` of 0.1 kept them."""
    description = Description(
        inventory=inventory(),
        engines={"native": None, "mjx": "It has a tendon."},
        complete=True,
        physics_steps_per_second=12_000.0,
        settled_height=0.3,
        notes=["It falls over."],
    )
    made: dict[str, str] = {}
    for status, found in (
        ("ready", {"description": description}),
        ("validating", {}),
        ("refused", {"message": "It has no joints.", "refused_at": BEGAN}),
    ):
        body = f"<mujoco model='{status}'/>".encode()
        record = ModelRecord.model_validate(
            {
                "id": library.identity(body),
                "status": status,
                "media_type": "application/xml",
                "size": len(body),
                "created_at": BEGAN,
                **found,
            }
        )
        if status != "refused":
            objects.put(keys.model_source(record.id), body, media_type="application/xml")
        library.keep(record, objects)
        made[status] = record.id
    return made


def inventory() -> Inventory:
    """A box with a free joint."""
    return Inventory.model_validate(
        {
            "joints": [{"name": "root", "type": "free", "body": "box", "qpos_start": 0, "qvel_start": 0}],
            **{part: [] for part in ("actuators", "sensors", "geoms", "cameras", "keyframes")},
            "bodies": ["box"],
            "sizes": {"nq": 7, "nv": 6, "nu": 0, "na": 0, "nbody": 2, "ngeom": 1},
            "root": "box",
            "has_free_joint": True,
            "travels": True,
            "initial_height": 0.5,
            "mass_kg": 1.0,
            "timestep_s": 0.002,
        }
    )


def of_redis(client: Any) -> dict[str, Any]:
    """Each key's type and value; of one that expires, in how many milliseconds it did."""
    found: dict[str, Any] = {}
    for key in sorted(client.scan_iter(match="*")):
        kind = client.type(key).decode()
        found[key.decode()] = {
            "type": kind,
            "value": _value(client, key, kind),
            "expires_ms": client.pttl(key),
        }
    return found


def _value(client: Any, key: bytes, kind: str) -> Any:
    match kind:
        case "hash":
            return {name.decode(): value.decode() for name, value in client.hgetall(key).items()}
        case "stream":
            return [
                [at.decode(), {name.decode(): text.decode() for name, text in said.items()}]
                for at, said in client.xrange(key)
            ]
        case "zset":
            return [member.decode() for member in client.zrange(key, 0, -1)]
        case "set":
            return sorted(member.decode() for member in client.smembers(key))
        case "string":
            return client.get(key).decode()
        case _:
            raise ValueError(f"{key} is a {kind}")


def of_bucket(objects: S3ObjectStore) -> dict[str, str]:
    """Each object's bytes in base64."""
    found = [info.key for info in objects.list("")]
    return {key: base64.b64encode(objects.get(key)).decode() for key in found}


def main(arguments: Sequence[str]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        spool = Path(folder) / "spool"
        spool.mkdir()
        with Valkey(Path(folder) / "valkey") as valkey, Weed(Path(folder) / "weed") as weed:
            client = connect_redis(valkey.url)
            s3 = connect_s3(weed.endpoint, weed.access_key, weed.secret_key, secure=False, region=REGION)
            objects = S3ObjectStore(s3, weed.bucket)
            objects.delete_prefix("")
            service = Service(RedisJobStore(client), RQQueue(client), objects, spool)
            succeeded = succeed(service)
            run_twice(service)
            others(service, succeeded)
            made = models(objects)
            for key in client.scan_iter(match="rq:*"):
                client.delete(key)
            document = {
                "made": f"{utc_now():%Y-%m-%d}",
                "jobs": service.ids,
                "models": made,
                "redis": of_redis(client),
                "objects": of_bucket(objects),
            }
    target = Path(__file__).with_name("data.json")
    target.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    print(f"{target}: {target.stat().st_size:,} bytes")


if __name__ == "__main__":
    main(sys.argv[1:])
