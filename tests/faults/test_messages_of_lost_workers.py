"""What Redis holds of an attempt whose worker has gone for good."""

import redis

from core.adapters.postgres.store import PostgresJobStore
from core.adapters.rq.queue import RQQueue
from core.jobs.attempts import claim_attempt, new_secret
from core.jobs.reconciliation import Reconciler
from core.jobs.spec import JOB_SPEC
from core.jobs.submission import submit
from tests.contract.recording import LEASE, Database
from tests.in_memory import MemoryObjectStore


def test_the_message_goes_when_its_attempt_is_taken_back(
    job_store: PostgresJobStore, redis_client: redis.Redis, database: Database
) -> None:
    queue = RQQueue(redis_client)
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant"})
    job = submit(spec, store=job_store, queue=queue)
    assert redis_client.lpop("rq:queue:gaitway-any-normal") == f"{job.id}_1".encode()
    assert claim_attempt(
        job.id,
        1,
        "worker",
        store=job_store,
        objects=MemoryObjectStore(),
        lease=LEASE,
        secret=new_secret(),
    )
    reconciler = Reconciler(job_store, queue, LEASE)
    reconciler.run_once()
    database.change("UPDATE jobs SET lease_until = now() - interval '1 s'")
    database.change("UPDATE pulse SET beat_at = now(), quiet_until = now() - interval '1 s'")
    assert reconciler.run_once() >= 1
    assert redis_client.keys("rq:job:*") == [f"rq:job:{job.id}_2".encode()]
